"""Checks of a run's model, controller, reference and start."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel, State
from softdyn.checks import array, in_degrees
from softdyn.controllers.staged import best
from softdyn.dynamics.stops import Stops
from softdyn.statics.suspicious_values import fast_springs
from softdyn.validation.loop.experiment import Experiment

ReferenceLike = Experiment | Callable[[float], Reference]
YIELD = 1e-3  # of a joint's range: a run may begin where another one pressed a joint on its stop


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
        within = Stops.of(model).within(at)
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


def warn_of_fast_springs(model: SoftModel, state: State, timestep: float) -> None:
    """Warn of a spring whose oscillation is too fast for the plant step (s)."""
    said = fast_springs(model, state, timestep)
    if said is not None:
        warnings.warn(f"{model.robot.path}: {said}", stacklevel=3)


def name_of(controller: Any) -> str:
    """The controller's `name`, or that of its class."""
    named = (getattr(controller, attribute, None) for attribute in ("name", "__name__"))
    texts = (text for text in named if isinstance(text, str) and text)
    return next(texts, type(controller).__name__)
