"""The arguments of a run, in one object, and checks of them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel
from softdyn.checks import array, flag, in_degrees, number
from softdyn.controllers.staged import best
from softdyn.estimation import Observer
from softdyn.safety import Surroundings
from softdyn.statics.suspicious_values import fast_springs
from softdyn.toml_table import TomlTable
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.rig import Rig
from softdyn.validation.twin.settings import Integrator, integrator_of

ReferenceLike = Experiment | Callable[[float], Reference]
YIELD = 1e-3  # of a joint's range: a run may begin where another one pressed a joint on its stop


@dataclass(frozen=True, kw_only=True, eq=False)
class RunOptions:
    """The arguments of a run besides its model, its controller and its reference.

    Attributes
    ----------
    duration, period : float, optional
        Length of the run, to the nearest plant step, and control period (s); the experiment's by
        default, 10 s and 2 ms without one. Where the period does not divide the duration, the last
        hold is shorter.
    timestep : float, optional
        Plant step (s), which must divide the period; by default the largest ≤ 0.5 ms. ``inf`` is
        one step per period.
    integrator : Integrator or str
        The twin's scheme.
    q0, v0 : np.ndarray, (nq,), (nv,), optional
        Initial state, within the joint limits; by default at rest in the configuration within the
        limits that is nearest to q = 0.
    contacts : bool
        Whether the plant's links can touch.
    friction : bool
        Whether the plant has the file's dry friction of joints, and of cables on their guides.
    plant : PlantErrors, MappedPlant, Plant or Callable[..., Twin], optional
        By default the twin. Otherwise the twin with some errors; a user's MJCF as a
        `softdyn.validation.Scene`, whose own contacts and friction hold, and its step if that
        divides the period; a `softdyn.validation.loop.plants.Plant`; or what makes the twin, called
        as `Twin` with the robot, timestep, contacts and friction.
    rig : Rig or str, optional
        The rig between controller and plant: None for an ideal one, ``"file"`` for that of the
        robot's file, or a `Rig`.
    observer : Observer or str, optional
        It estimates the state that the controller gets, from the rig's sensors: an
        `softdyn.estimation.Ekf`, an object of your own with ``step(t, measurements, u)``, or the
        words of `observation.make_observer`. The State has the estimate's `covariance`
        (2 nv, 2 nv), if there is one.
    surroundings : Surroundings, optional
        Obstacles around the robot: in the twin, and their reserve in the log. A controller keeps
        clear of them by its own `barriers`.
    name : str, optional
        Name of the controller in the log; its `name` or its class by default.
    """

    duration: float | None = None
    period: float | None = None
    timestep: float | None = None
    integrator: Integrator | str = Integrator.IMPLICITFAST
    q0: Any = None
    v0: Any = None
    contacts: bool = False
    friction: bool = False
    plant: Any = None
    rig: Rig | str | None = None
    observer: Observer | str | None = None
    surroundings: Surroundings | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str | None):
            raise InputError("name", "text", repr(self.name))
        for key in ("duration", "period", "timestep"):
            if getattr(self, key) is not None:
                number(key, getattr(self, key), above=0.0, finite=key != "timestep")
        for key in ("contacts", "friction"):
            flag(key, getattr(self, key))
        integrator_of(self.integrator)

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> RunOptions:
        """The options from a table, such as a TOML file's, or from the keywords of a call.

        A table of `plant` becomes a `PlantErrors`, one of `rig` or `surroundings` that object.

        Raises
        ------
        InputError
            An unknown option; the error names the one that may be meant. Also for a value that its
            object refuses.
        """
        values = TomlTable(given, "options").rest([field.name for field in fields(cls)])
        makers: dict[str, Callable[[Any], Any]]
        makers = {"plant": _plant_errors, "rig": Rig.of, "surroundings": Surroundings.of}
        for name, make in makers.items():
            if isinstance(values.get(name), Mapping):
                values[name] = make(values[name])
        return cls(**values)


def _plant_errors(table: Mapping[str, Any]) -> PlantErrors:
    return TomlTable(table, "plant").make(PlantErrors)


def check_robot(model: SoftModel, experiment: Experiment) -> None:
    """Refuse an experiment of another bundled robot, because it is scaled to that robot."""
    if model.bundled is not None and model.bundled != experiment.robot:
        raise InputError(
            "experiment", f"one for {model.bundled!r}", f"one for {experiment.robot!r}"
        )


def checked(reference: Any) -> Callable[[float], Reference]:
    """`reference` as a function whose values are checked to be a `Reference`; tried at t = 0."""
    if not callable(reference):
        expected = "an Experiment, or a callable t -> Reference such as SetPoint(y)"
        raise InputError("reference", expected, repr(reference))
    desired = partial(_desired, reference)
    desired(0.0)
    return desired


class _Nowhere(Reference):
    """The reference of a rollout: NaN, because there is none."""

    def __post_init__(self) -> None:
        pass


_NOWHERE = _Nowhere(*np.full((3, 3), np.nan))


def nowhere(_: float) -> Reference:
    """The reference of a rollout at any time."""
    return _NOWHERE


def _desired(reference: Any, t: float) -> Reference:
    value = reference(t)
    if isinstance(value, Reference):
        return value
    try:
        return Reference(value.y, value.ydot, value.yddot)
    except AttributeError:
        raise InputError("reference", "a Reference(y, ydot, yddot)", repr(value)) from None


def check_controller(controller: Any) -> None:
    """Refuse a controller that cannot be called with a state and a reference."""
    expected = "a callable (state, reference) -> command"
    if isinstance(controller, type) or controller is best:
        name, kind = controller.__name__, "class" if isinstance(controller, type) else "function"
        raise InputError("controller", f"{expected}, as {name}(model)", f"the {kind} {name} itself")
    if not callable(controller):
        raise InputError("controller", expected, repr(controller))


def starting_pose(model: SoftModel, q0: Any) -> tuple[np.ndarray, str]:
    """The configuration (nq,) at which a run begins, and a text about joints that were moved.

    By default it is the nearest one to q = 0 within the joint limits. The text is empty if that is
    q = 0.

    Raises
    ------
    InputError
        A given configuration of another shape, not finite, or beyond a limit by more than
        `YIELD`, because a stop would throw the robot back.
    """
    if q0 is None:
        at = model.coordinates(model.q0)
        within = np.clip(at, model.lower, model.upper)
        moved = [
            f"{name} at {limit:g}"
            for name, zero, limit in zip(model.joint_names, at, within, strict=True)
            if zero != limit
        ]
        if not moved:
            return model.q0, ""
        return model.integrate(model.q0, within - at), (
            f"at the limits nearest to 0, which is beyond them: {', '.join(moved)}"
        )
    q = array("q0", q0, (model.nq,))
    limits = zip(model.joint_names, model.coordinates(q), model.lower, model.upper, strict=True)
    for name, value, lower, upper in limits:
        room = YIELD * (upper - lower) if math.isfinite(upper - lower) else 0.0
        if lower - room <= value <= upper + room:
            continue
        hint = ": degrees?" if _turns(model, name) and in_degrees(value, lower, upper) else ""
        expected = f"joint {name!r} within its limits, {lower:g} to {upper:g}"
        raise InputError("q0", expected, f"{value:g}{hint}")
    return q, ""


def _turns(model: SoftModel, name: str) -> bool:
    """Whether a joint is a revolute one."""
    return any(j.name == name and j.kind == "revolute" for j in model.robot.moving_joints)


def warn_of_fast_springs(model: SoftModel, M: np.ndarray, timestep: float) -> None:
    """Warn of a spring whose oscillation is too fast for the plant step (s)."""
    said = fast_springs(model, M, timestep)
    if said is not None:
        warnings.warn(f"{model.robot.path}: {said}", stacklevel=3)


def name_of(controller: Any) -> str:
    """The controller's `name`, or that of its class."""
    named = (getattr(controller, attribute, None) for attribute in ("name", "__name__"))
    texts = (text for text in named if isinstance(text, str) and text)
    return next(texts, type(controller).__name__)
