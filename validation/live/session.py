"""A plant and a controller that change while they run, step by step and without a clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from functools import partial, singledispatchmethod
from time import perf_counter_ns
from typing import Any

import numpy as np

from softdyn import InputError, SoftdynError, SoftModel, State, statics
from softdyn.controllers.controller import reset_controller
from softdyn.estimation import Observer
from softdyn.exceptions import OwnCodeError, one_line, own_code_errors
from softdyn.safety import Surroundings
from softdyn.tasks.task import Task
from softdyn.validation.live.dragged_targets import DraggedTargets
from softdyn.validation.live.ghost import Ghost
from softdyn.validation.live.menu import Make, make_law
from softdyn.validation.live.push import Hand, hand_stiffness
from softdyn.validation.loop.arguments import starting_pose
from softdyn.validation.loop.loop import ControlLoop
from softdyn.validation.loop.observation import make_observer
from softdyn.validation.loop.plants import known_rig, plant_of
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.loop.setups import setup_of
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.twin.plant_errors import multiplied
from softdyn.validation.twin.rig import Rig, RiggedPlant, rig_of
from softdyn.validation.twin.twin import SimulationError
from softdyn.view.live import messages
from softdyn.view.live.frames import Columns
from softdyn.view.live.messages import OPEN_LOOP, Limits, Message
from softdyn.view.scene import Figure

# of the robot's length: the pull by the mouse does not grow beyond this distance
LONGEST_PULL = 0.5


@dataclass
class PageState:
    """The state of a session on its page, besides frames.

    `notice` is the last error, `busy` the reason why the robot stands still at the moment;
    `planning`: the controller searches a way to the target in the background.
    """

    law: str
    mismatch: dict[str, Any] = field(default_factory=lambda: asdict(messages.Mismatch()))
    inputs: list[float] = field(default_factory=list)
    paused: bool = False
    speed: float = 1.0
    ghost: bool = False
    notice: str = ""
    busy: str = ""
    planning: bool = False


class ByHand:
    """A controller and its output: the inputs `u` (nu,) that a page sets."""

    def __init__(self, u: np.ndarray) -> None:
        self.u = u

    def __call__(self, state: State, reference: Any) -> ByHand:
        """The inputs, whatever the state."""
        return self


class Session:
    """A `ControlLoop` of a robot's twin behind its rig, changed by messages.

    A fault pauses the session, with the reason in `shown.notice`: the plant diverges, or the
    controller raises or returns no input. Another message can repair it.

    Parameters
    ----------
    model : SoftModel
        The robot.
    menu : Mapping of str to Callable
        Controllers by name, each made as ``make(model)`` when it is chosen.
    law : str
        The first controller, or `OPEN_LOOP`.
    period : float, optional
        Control period (s); by default the paper's, or 2 ms.
    target : ndarray, (3,), optional
        The first target (m); by default the tip at rest.
    rig, observer : Rig or str, Observer or str, optional
        As in `RunOptions`. The page's factors multiply the rig's, and its delay and noise replace
        the rig's unless they are 0. The ghost is the observer's estimate.
    tasks : sequence of Task
        Tasks of links' frames, one of them with a position; by default the tip's position.
    surroundings : Surroundings, optional
        Obstacles in the plant. Controllers keep clear of them if the menu makes such.

    Attributes
    ----------
    shown : PageState
        The state on the pages; `changed` is True when it has changed, until the caller resets it.
    loop : ControlLoop
        What is stepped.
    limits : Limits
        Limits of the messages.
    period : float
        Control period (s).
    pull : float
        Largest force of a pull by the mouse (N).
    trace : str
        The traceback of the last error in a user's own code, until the caller empties it.

    Raises
    ------
    InputError
        The first controller cannot be made, or a task cannot be dragged.
    """

    def __init__(
        self,
        model: SoftModel,
        menu: Mapping[str, Make],
        law: str,
        *,
        period: float | None = None,
        target: Any = None,
        rig: Rig | str | None = None,
        observer: Observer | str | None = None,
        tasks: Sequence[Task] = (),
        surroundings: Surroundings | None = None,
    ) -> None:
        self.model, self._menu, self.surroundings = model, dict(menu), surroundings
        self._wanted = rig_of(rig) or Rig(file=False)
        self.period = setup_of(model).period if period is None else period
        self._grid = TimeGrid.plan(self.period, self.period)
        size = Figure.of(model).size
        self._aim = DraggedTargets(model, tasks)
        self.limits = Limits.of(model, (*self._menu, OPEN_LOOP), size, self._aim.marks)
        self.columns = Columns(model, len(self._aim.row))
        try:
            self._rest = statics.rest(model).q
        except SoftdynError:
            self._rest, _ = starting_pose(model, None)
        self._stiffness = hand_stiffness(model)
        self.pull = LONGEST_PULL * size * self._stiffness
        self._mismatch = messages.Mismatch()
        self._hand: Hand | None = None
        self._ghost: Ghost | None = None
        self.trace = ""
        plant = self._built(self._mismatch, *self._at_rest())
        self.loop = ControlLoop(model, plant, None, make_observer(model, self._wanted, observer))
        # the page's differences are what a controller does not know
        self._known = known_rig(plant, self.loop.observation is None)
        self._zero, self._by_hand = self.loop.u, ByHand(self.loop.u)
        self.loop.take(self._by_hand)
        self.shown, self.changed = PageState(OPEN_LOOP, inputs=self._zero.tolist()), True
        self.shown.ghost = observer is not None
        self._state = model.state(*plant.state())
        if self.loop.observation is not None:
            self.loop.observation.reset()
        self._aim.begin(self._state, target)
        self._choose(law)

    @property
    def plant(self) -> RiggedPlant:
        """The twin behind its rig."""
        assert isinstance(self.loop.plant, RiggedPlant)
        return self.loop.plant

    @property
    def estimates(self) -> bool:
        """Whether the controller gets an observer's estimate."""
        return self.loop.observation is not None

    # -- messages ------------------------------------------------------------------------------

    def apply(self, message: Message) -> None:
        """Obey a message, completely or not at all.

        Raises
        ------
        InputError
            It cannot be obeyed; then nothing has changed.
        """
        before = copy(self.shown)
        self._do(message)
        self.changed |= self.shown != before

    @singledispatchmethod
    def _do(self, message: Any) -> None:
        name = messages.NAMES[type(message)]
        raise InputError("do", "a message that a running robot can obey", name)

    @_do.register
    def _(self, message: messages.SetTarget | messages.SetTargets) -> None:
        self._aim.move(message)

    @_do.register
    def _(self, message: messages.SetInputs) -> None:
        self._by_hand.u = message.u
        self.shown.inputs = message.u.tolist()

    @_do.register
    def _(self, message: messages.SetController) -> None:
        self._choose(message.name)

    @_do.register
    def _(self, message: messages.Mismatch) -> None:
        loop = self.loop
        loop.move_to(self._built(message, *self.plant.state(), self.t, loop.u))
        self._begin(loop.controller)
        self._mismatch = message
        self.shown.mismatch = asdict(message)

    @_do.register
    def _(self, message: messages.Push) -> None:
        held = self._hand
        if held is not None and held.link == message.link and (held.said_at == message.at).all():
            held.to = message.to
            return
        q, _ = self.plant.state()
        hand = Hand(self.model, q, message, self._stiffness, self.pull)
        self._release()
        self._hand = hand

    @_do.register
    def _(self, _message: messages.Release) -> None:
        self._release()

    @_do.register
    def _(self, message: messages.Pause) -> None:
        self.shown.paused = message.on
        if not message.on:
            self.shown.notice = ""

    @_do.register
    def _(self, _message: messages.SingleStep) -> None:
        self.shown.paused = True
        self.step()

    @_do.register
    def _(self, _message: messages.Reset) -> None:
        loop = self.loop
        loop.move_to(self._built(self._mismatch, *self._at_rest()))
        self._begin(loop.controller)
        self._release()
        if self._ghost is not None:
            self._ghost = self._new_ghost()
        if loop.observation is not None:
            loop.observation.reset()
        loop.u, loop.output = self._zero, None
        self._by_hand.u = self._zero
        self.shown.inputs = self._zero.tolist()
        self._state = self.model.state(*self.plant.state())
        self.shown.notice = ""

    @_do.register
    def _(self, message: messages.SetSpeed) -> None:
        self.shown.speed = message.factor

    @_do.register
    def _(self, message: messages.ShowGhost) -> None:
        self._ghost = self._new_ghost() if message.on and not self.estimates else None
        self.shown.ghost = message.on

    # -- time ----------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """Simulated time (s)."""
        return self.plant.twin.time

    def step(self) -> float:
        """Run one control period; return the time of its control step (µs)."""
        began = perf_counter_ns()
        try:
            with own_code_errors():
                self.loop.control(self.t, self._aim.reference)
        except OwnCodeError as error:
            self.trace = error.trace
            self._fault(f"{self.shown.law}: {error}")
            return 0.0
        except Exception as error:  # an answer that cannot be used
            self._fault(f"{self.shown.law}: {type(error).__name__}: {error}")
            return 0.0
        spent = (perf_counter_ns() - began) / 1e3
        law = self.loop.controller
        planning = getattr(getattr(law, "inner", law), "planning", False) is True
        self.changed |= planning != self.shown.planning
        self.shown.planning = planning
        self._advance()
        return spent

    def frame(self, **clock: float) -> np.ndarray:
        """The present state as a frame; `clock` has the figures of the clock."""
        hand, plant = self._hand, self.plant
        with suppress(InputError):  # a diverged plant is shown at its last finite state
            self._state = self.model.state(*plant.state())
        state = self._state
        values: dict[str, Any] = {
            "t": self.t, "q": self.model.coordinates(state.q), "y": state.y,
            "u": plant.acting, "targets": self._aim.row, "y_ref": self._aim.reference.y,
            "V": getattr(self.loop.output, "V", np.nan),
        }  # fmt: skip
        if hand is not None:
            values |= {"force": hand.force, "point": hand.point}
        ghost = self.loop.seen if self.estimates else self._ghost
        if ghost is not None and self.shown.ghost:
            gap = np.linalg.norm(ghost.y - state.y)
            values |= {"ghost": self.model.coordinates(ghost.q), "gap": gap}
        return self.columns.frame(**values, **clock)

    # -- inside --------------------------------------------------------------------------------

    def _advance(self) -> None:
        steps = self._grid.substeps
        try:
            if self._hand is not None:
                self._hand.pull(self.plant.twin)
            self.loop.advance(steps)
        except SimulationError as error:
            self._fault(f"the plant stopped: {error.reason}")
            return
        if self._ghost is not None:
            try:
                self._ghost.advance(self.loop.u, steps)
            except InputError:
                self._ghost, self.shown.ghost, self.changed = None, False, True
                self.shown.notice = "the model beside the plant diverged"

    def _fault(self, text: str) -> None:
        self.shown.paused, self.shown.notice, self.changed = True, one_line(text, 300), True

    def _at_rest(self) -> tuple[np.ndarray, np.ndarray]:
        return self._rest, np.zeros(self.model.nv)

    def _built(
        self,
        said: messages.Mismatch,
        q: np.ndarray,
        v: np.ndarray,
        t: float = 0.0,
        u: np.ndarray | None = None,
    ) -> RiggedPlant:
        """A new plant in a given state, whose input u has been held for long."""
        options = RunOptions(rig=_changed(self._wanted, said), surroundings=self.surroundings)
        plant = plant_of(self.model, options, self.period, self._grid.timestep)
        assert isinstance(plant, RiggedPlant)
        plant.real_time = True
        try:
            plant.start(q, v, t, u)
        except SimulationError as error:
            raise InputError("state", "one that MuJoCo can start from", error.reason) from None
        return plant

    def _choose(self, name: str) -> None:
        law = self._by_hand if name == OPEN_LOOP else self._made(name)
        self._begin(law)
        if name == OPEN_LOOP:
            self._by_hand.u = self.loop.u
            self.shown.inputs = self.loop.u.tolist()
        self.loop.take(law)
        self.loop.output = None
        self.shown.law, self.shown.notice, self.shown.planning = name, "", False

    def _made(self, name: str) -> Any:
        """A controller of the menu; ours compile their kernels here, before the first step."""
        making = partial(make_law, name, self._menu[name], self.model, **self._aim.arguments)
        law, ours = making()
        if ours:
            self._begin(law)
            law(self._state, self._aim.reference)
            law, _ = making()
        return law

    def _begin(self, law: Any) -> None:
        """Reset a controller, if it can be reset."""
        reset_controller(law, self.period, self._known)

    def _release(self) -> None:
        self._hand = None
        self.plant.twin.data.xfrc_applied[:] = 0.0

    def _new_ghost(self) -> Ghost:
        return Ghost(self.model, *self.plant.state(), self._grid.timestep)


def _changed(rig: Rig, said: messages.Mismatch) -> Rig:
    """The rig with the page's differences."""
    plant = replace(
        rig.plant,
        contacts=rig.plant.contacts or said.contacts,
        mass=multiplied(rig.plant.mass, said.mass),
        stiffness=multiplied(rig.plant.stiffness, said.stiffness),
        damping=multiplied(rig.plant.damping, said.damping),
    )
    signals = {name: getattr(said, name) for name in ("delay", "noise") if getattr(said, name) > 0}
    return replace(rig, plant=plant, **signals)
