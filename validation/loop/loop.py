"""The loop: plant → state → observer → controller → plant, one control period at a time."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from time import perf_counter_ns
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.controllers.channels import LogChannel
from softdyn.controllers.controller import guard_of, waiting
from softdyn.copies import Separate
from softdyn.estimation import Observer
from softdyn.validation.loop.observation import Observation
from softdyn.validation.loop.plants import Plant


class ControlLoop(Separate):
    """A controller, a plant, and maybe an observer between them.

    In a period, `read` gives the plant's state to `model.state`, `decide` asks the controller for
    an answer to the state that it sees, `admit` makes the input of it, and `advance` holds this.
    `control` does the first three, `step` all four. `take` and `move_to` exchange the controller
    and the plant between two periods.

    Parameters
    ----------
    model : SoftModel
        The controller's model.
    plant : Plant
        The plant.
    controller : Callable[[State, Reference], ControllerOutput]
        The controller.
    observer : Observer, optional
        It estimates the state that the controller sees, from the plant's readings.

    Attributes
    ----------
    model, plant, controller, observation
        As above.
    guard : InputGuard
        It checks and clips the controller's answers.
    state : State or None
        The plant's state at the last `read`; None where it is not finite.
    seen : State or None
        The state that the controller saw.
    values : dict of str to ndarray
        What the plant and the observer recorded in this period, by the names of `channels`.
    output : Any
        The controller's answer.
    u : ndarray, (nu,)
        The input.
    nanoseconds : int
        Time of the control step: the state or its estimate, and the controller.

    Raises
    ------
    InputError
        An observer without the readings that it needs.
    """

    def __init__(
        self, model: SoftModel, plant: Plant, controller: Any, observer: Observer | None = None
    ) -> None:
        self.model, self.plant = model, plant
        self.observation = None if observer is None else Observation(observer, model, plant)
        self.take(controller)
        self.state: State | None = None
        self.seen: State | None = None
        self.values: dict[str, np.ndarray] = {}
        self.output: Any = None
        self.u, self.nanoseconds = model.relaxed, 0

    @property
    def channels(self) -> tuple[LogChannel, ...]:
        """The quantities that the plant and the observer record."""
        return self.plant.channels + (() if self.observation is None else self.observation.channels)

    def take(self, controller: Any) -> None:
        """Let another controller act from now on."""
        self.controller, self.guard = controller, guard_of(controller, self.model)

    def move_to(self, plant: Plant) -> None:
        """Let another plant move from now on.

        Raises
        ------
        InputError
            It lacks the readings that the observer needs.
        """
        if self.observation is not None:
            self.observation = Observation(self.observation.observer, self.model, plant)
        self.plant, self.seen = plant, None

    def read(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """The plant's q (nq,) and v (nv,) at t (s), which need not be finite."""
        self.seen, self.values, self.state = None, {}, None
        found = self.plant.state()
        if found is None:  # of a real robot only an observer knows them
            if self.observation is None:
                raise InputError("observer", "one, because the plant has no state", "none")
            self.state = self.see(t)
            return self.state.q, self.state.v
        q, v = found
        if np.isfinite(q @ q + v @ v):
            began = perf_counter_ns()
            self.state = self.model.state(q, v)
            self.nanoseconds = perf_counter_ns() - began
        return q, v

    def see(self, t: float) -> State:
        """The state that the controller sees at t (s), by the observer if there is one."""
        if self.seen is not None:
            return self.seen
        self.values = dict(self.plant.sample())
        if self.observation is None:
            assert self.state is not None
            self.seen = self.plant.see(self.state)
            return self.seen
        self.seen = self.observation(t, self.values["measured"], self.plant.sent)
        self.values |= self.observation.values
        self.nanoseconds = self.observation.nanoseconds
        return self.seen

    def decide(self, t: float, target: Any) -> Any:
        """The controller's answer to the state that it sees at t (s)."""
        seen = self.see(t)
        with nullcontext() if self.plant.real_time else waiting(self.controller):
            began = perf_counter_ns()
            self.output = self.controller(seen, target)
            self.nanoseconds += perf_counter_ns() - began
        return self.output

    def admit(self) -> np.ndarray:
        """The input (nu,) of the last answer, within its bounds.

        Raises
        ------
        InputError
            The answer has no finite input of this size.
        """
        u = getattr(self.output, "u", self.output)  # the answer may be a plain array
        if isinstance(u, np.ma.MaskedArray):
            raise InputError("its u", "an array", "a masked one")
        self.u = self.guard.admit(u)
        return self.u

    def advance(self, steps: int) -> Mapping[str, np.ndarray]:
        """Hold the last input for a number of plant steps; what the plant recorded.

        Raises
        ------
        SimulationError
            The run cannot go on.
        """
        assert self.seen is not None
        return self.plant.advance(self.u, steps, self.seen)

    def control(self, t: float, target: Any) -> np.ndarray:
        """The input (nu,) of the period that begins at t (s).

        Raises
        ------
        InputError
            The plant's state is not finite, or the answer is no input.
        """
        self.read(t)
        if self.state is None:
            raise InputError("the plant's state", "finite numbers", "others")
        self.decide(t, target)
        return self.admit()

    def step(self, t: float, target: Any, steps: int) -> None:
        """Run one control period from t (s): `control`, then `advance`."""
        self.control(t, target)
        self.advance(steps)
