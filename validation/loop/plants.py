"""What a loop moves: its contract, and the simulated plants."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.controllers.channels import LogChannel
from softdyn.controllers.controller import IDEAL, KnownRig
from softdyn.copies import Separate
from softdyn.safety import Surroundings
from softdyn.validation.loop.model_plant import model_plant
from softdyn.validation.loop.settings import MODEL, RunOptions
from softdyn.validation.twin.integrators import Integrator
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.rig import RiggedPlant, cable_friction, rig_of
from softdyn.validation.twin.state_map import MappedPlant, StateMap
from softdyn.validation.twin.touch import Touch
from softdyn.validation.twin.twin import Twin


@runtime_checkable
class Plant(Protocol):
    """What a loop moves: a simulated robot, or a real one behind its driver.

    In every control period a loop calls `state`, `sample`, `see` without an observer, and then,
    with the controller's input, `advance`.

    Attributes
    ----------
    channels : tuple of LogChannel
        The quantities that `sample` and `advance` give, by name. Readings are ``measured``. With
        ``q_seen`` and ``v_seen`` the loop records the state that the controller saw.
    settings : Mapping of str to Any
        The fields of a log that the plant states, such as ``contacts``.
    real_time : bool
        Whether time goes on during a control step. Otherwise the controller may wait for searches.
    alters_states : bool
        Whether `see` adds noise, bias or latency to q and v.
    sent : np.ndarray, (nu,)
        The last commands, as an observer takes them.

    Notes
    -----
    A plant may also have an attribute `known`, a `softdyn.controllers.controller.KnownRig`. A
    controller gets it when it is reset. Without it a controller takes lag and delay from the
    robot's file.
    """

    @property
    def channels(self) -> tuple[LogChannel, ...]: ...  # noqa: D102
    @property
    def settings(self) -> Mapping[str, Any]: ...  # noqa: D102
    @property
    def real_time(self) -> bool: ...  # noqa: D102
    @property
    def alters_states(self) -> bool: ...  # noqa: D102
    @property
    def sent(self) -> np.ndarray: ...  # noqa: D102

    def start(
        self, q: np.ndarray, v: np.ndarray, t: float = 0.0, u: np.ndarray | None = None
    ) -> None:
        """Begin in a state at a time (s), with the input u (nu,) long held."""

    def state(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The robot's q (nq,) and v (nv,); None where only an observer can know them."""

    def sample(self) -> Mapping[str, np.ndarray]:
        """What is recorded before the control step, by the channels' names."""

    def see(self, state: State) -> State:
        """The state that the controller sees instead of the robot's own."""

    def advance(self, u: np.ndarray, steps: int, seen: State) -> Mapping[str, np.ndarray]:
        """Hold the input u (nu,), computed at the state `seen`, for a number of plant steps.

        Raises
        ------
        SimulationError
            The run cannot go on.
        """


class IdealPlant(Separate):
    """A MuJoCo model without a rig: inputs act at once, and the controller sees the state itself.

    Parameters
    ----------
    engine : Twin or MappedPlant
        The MuJoCo model.
    states : StateMap
        Its states in the controller's model.
    contacts : bool
        Whether anything can touch.
    file : str, optional
        Name of a user's file that is the plant.
    known : KnownRig
        What a controller knows of its actuators and cables.
    around : Surroundings, optional
        The obstacles of a `Twin`, for their names.

    Attributes
    ----------
    engine
        As above. The others are those of `Plant`.
    """

    real_time = alters_states = False
    sent = np.zeros(0)

    def __init__(
        self,
        engine: Twin | MappedPlant,
        states: StateMap,
        contacts: bool,
        file: str | None = None,
        known: KnownRig = IDEAL,
        around: Surroundings | None = None,
    ) -> None:
        self.engine, self._states, self.known = engine, states, known
        self.touch = Touch.of(engine, around)
        self.channels = () if self.touch is None else (self.touch.channel,)
        self.settings = {"contacts": contacts, "plant": file}

    def start(
        self, q: np.ndarray, v: np.ndarray, t: float = 0.0, u: np.ndarray | None = None
    ) -> None:
        """Begin in a state.

        Raises
        ------
        InputError
            A link is deep inside a solid obstacle.
        """
        self.engine.set_state(*self._states.to_twin(q, v))
        if self.touch is not None:
            self.touch.check_start()

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """The robot's q (nq,) and v (nv,)."""
        return self._states.from_twin(self.engine.data.qpos, self.engine.data.qvel)

    def sample(self) -> dict[str, np.ndarray]:
        """The forces of solid obstacles, if there are any."""
        return {} if self.touch is None else self.touch.sample(refresh=True)

    def see(self, state: State) -> State:
        """The state itself."""
        return state

    def advance(self, u: np.ndarray, steps: int, seen: State) -> dict[str, np.ndarray]:
        """Integrate under a held input."""
        self.engine.advance(u, steps)
        return {}


def plant_of(model: SoftModel, options: RunOptions, period: float, timestep: float) -> Plant:
    """The plant that a run's options mean.

    Parameters
    ----------
    model : SoftModel
        The controller's model.
    options : RunOptions
        The options.
    period, timestep : float
        Control period and plant step (s).

    Raises
    ------
    InputError
        Options that exclude each other, a scene of another robot.
    """
    own, rig, around = options.plant, rig_of(options.rig), options.surroundings
    if isinstance(own, str) and own == MODEL:
        return model_plant(model, options, period, timestep)
    if isinstance(own, MappedPlant | Plant):
        others = {
            "rig": rig is not None,
            "contacts, friction": options.contacts or options.friction,
        }
        others["obstacles"] = around is not None
        for name, given in others.items():
            if given:
                expected = "none, because the plant is your own and states it"
                raise InputError(name, expected, "one")
        if isinstance(own, Plant):
            return own
        if unknown := getattr(own, "unknown", ()):
            said = ", ".join(unknown)
            warnings.warn(f"{own.path}: the model does not know of {said}", stacklevel=2)
        own.timestep = timestep
        known = getattr(own, "known", IDEAL)
        return IdealPlant(own, own.states, own.contacts, own.path.name, known)
    errors = own if isinstance(own, PlantErrors) else PlantErrors()
    twin: dict[str, Any] = {
        "contacts": options.contacts or errors.contacts,
        "friction": options.friction or errors.rubs,
        "timestep": timestep,
    }
    if around is not None:
        twin["obstacles"] = around.obstacles
    if options.integrator != Integrator.IMPLICITFAST:
        twin["integrator"] = options.integrator
    if rig is not None:
        if own is not None:
            if own is not errors or rig.plant != PlantErrors():
                raise InputError("rig", "none with a plant of your own", "both")
            rig = replace(rig, plant=errors)
        return RiggedPlant(rig, model, period, around=around, **twin)
    make = own if own is not None and own is not errors else errors.twin
    if not callable(make):
        expected = f'"{MODEL}", PlantErrors, a Scene(model, FILE), or what makes a Twin'
        raise InputError("plant", expected, own)
    engine = make(model.robot, **twin)
    known = KnownRig(friction=cable_friction(model.robot)) if twin["friction"] else IDEAL
    return IdealPlant(engine, StateMap(model, engine), twin["contacts"], known=known, around=around)


def known_rig(plant: Plant, sees: bool) -> KnownRig | None:
    """The part of a plant's rig that a controller knows; None where that is the robot's file.

    Parameters
    ----------
    plant : Plant
        The plant.
    sees : bool
        Whether the controller sees the plant's states, and no observer's. They may be late.
    """
    found: KnownRig | None = getattr(plant, "known", None)
    late = getattr(plant, "lateness", 0.0) if sees else 0.0
    return replace(found, delay=found.delay + late) if found is not None and late else found


def timestep_of(model: SoftModel, options: RunOptions) -> float | None:
    """The plant step (s) of a user's own scene; None for any other plant.

    Raises
    ------
    InputError
        A scene of another robot.
    """
    own = options.plant
    if not isinstance(own, MappedPlant):
        return None
    if own.robot.digest != model.robot.digest:
        raise InputError("plant", f"a scene for {model.name!r}", f"one for {own.robot.name!r}")
    return own.timestep
