"""The kinds of parameters: each kind's columns in r = M q̈ + h - B u, and its setter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from softdyn.checks import array, did_you_mean, flag, instances
from softdyn.description.robot import Robot
from softdyn.dynamics.derivatives import mass_columns
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel, State, check_model, taut_gains
from softdyn.dynamics.tree import tree_of
from softdyn.exceptions import InputError
from softdyn.identification.friction import friction_of


class MotionSample(NamedTuple):
    """A state with its acceleration and input, and the model with the file's inertias."""

    state: State
    a: np.ndarray
    u: np.ndarray
    file: SoftModel


@dataclass(frozen=True)
class Kind:
    """A kind of parameter, such as stiffness; a member is one joint's, tendon's or input's.

    Attributes
    ----------
    name, unit : str
        Texts for the user.
    members : callable
        SoftModel → names of the members.
    nominal : callable
        SoftModel → their values in the file (members,).
    columns : callable
        MotionSample → ∂r/∂value (n, members), r = M a + h - B u.
    amended : callable
        (Robot, {name: value}) → the robot with these values; masses are set in the engine.
    lower : float
        The least possible value.
    measures : str
        For a kind that is only added to outputs: their name up to the member's name.
    """

    name: str
    unit: str
    members: Callable[[SoftModel], Sequence[str]]
    nominal: Callable[[SoftModel], np.ndarray]
    columns: Callable[[MotionSample], np.ndarray]
    amended: Callable[[Robot, dict[str, float]], Robot]
    lower: float = 0.0
    measures: str = ""


def _in(field: str, attribute: str) -> Callable[[Robot, dict[str, float]], Robot]:
    """A setter of one attribute of the robot's joints, tendons or actuators."""

    def amended(robot: Robot, values: dict[str, float]) -> Robot:
        parts: tuple[Any, ...] = getattr(robot, field)
        changed = tuple(
            replace(part, **{attribute: values[part.name]}) if part.name in values else part
            for part in parts
        )
        found: Robot = replace(robot, **{field: changed})  # type: ignore[arg-type]
        return found

    return amended


def _joints(model: SoftModel) -> Sequence[str]:
    return model.joint_names


def _tendons(model: SoftModel) -> Sequence[str]:
    return model.tendons.names


def _inputs(model: SoftModel) -> Sequence[str]:
    return [actuator.name for actuator in model.robot.actuators]


def _coordinates(sample: MotionSample) -> np.ndarray:
    return sample.state.model.coordinates(sample.state.q)


def _rubbing(sample: MotionSample) -> np.ndarray:
    return np.diag(friction_of(sample.state.model).signs(sample.state.v))


def _stretch(sample: MotionSample) -> np.ndarray:
    return _coordinates(sample) - sample.state.model.rest


def _mass_columns(sample: MotionSample) -> np.ndarray:
    state = sample.state
    return mass_columns(sample.file, state.q, state.v, sample.a)


def _gear_columns(sample: MotionSample) -> np.ndarray:
    tree = tree_of(sample.state.model)
    return -(sample.state.moment_arms[tree.actuated] * sample.u[:, None]).T


def _tendon_spring(sample: MotionSample) -> np.ndarray:
    model, state = sample.state.model, sample.state
    stretch = (state.lengths - model.tendon_rest) * _taut(state)
    return (state.moment_arms * stretch[:, None]).T


def _tendon_damper(sample: MotionSample) -> np.ndarray:
    arms = sample.state.moment_arms
    rates = (arms @ sample.state.v) * _taut(sample.state)
    return (arms * rates[:, None]).T


def _taut(state: State) -> np.ndarray:
    """Whether (tendons,) each tendon's spring and damper act."""
    gain, damping = taut_gains(state.model, state.lengths, state.moment_arms @ state.v)
    return ~state.model.tendon_slack | (gain > 0) | (damping > 0)


KINDS = {
    kind.name: kind
    for kind in (
        Kind("stiffness", "N m/rad, N/m", _joints, lambda model: model.stiffness,
             lambda sample: np.diag(_stretch(sample)), _in("joints", "stiffness")),
        Kind("damping", "N m s/rad, N s/m", _joints, lambda model: model.damping,
             lambda sample: np.diag(sample.state.v), _in("joints", "damping")),
        Kind("friction", "N m, N", _joints, lambda model: friction_of(model).size,
             _rubbing, _in("joints", "friction")),
        Kind("rest", "rad, m", _joints, lambda model: model.rest,
             lambda sample: -np.diag(sample.state.model.stiffness), _in("joints", "rest"), -np.inf),
        Kind("armature", "kg m^2, kg", _joints, lambda model: model.armature,
             lambda sample: np.diag(sample.a), _in("joints", "armature")),
        Kind("mass", "of the file's", _joints, lambda model: np.ones(model.nv),
             _mass_columns,
             lambda robot, values: robot),
        Kind("gear", "N per unit of u", _inputs, lambda model: tree_of(model).gear,
             _gear_columns, _in("actuators", "gear"), -np.inf),
        Kind("tendon_stiffness", "N/m", _tendons, lambda model: model.tendon_stiffness,
             _tendon_spring, _in("tendons", "stiffness")),
        Kind("tendon_damping", "N s/m", _tendons, lambda model: model.tendon_damping,
             _tendon_damper, _in("tendons", "damping")),
        Kind("offset", "m", _tendons, lambda model: np.zeros(len(model.tendons.names)),
             lambda sample: np.zeros(sample.state.moment_arms.T.shape), lambda robot, values: robot,
             -np.inf, "length."),
    )
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Parameter:
    """One unknown number θ; members with a non-zero weight have the value `weights` · θ.

    Attributes
    ----------
    kind : Kind
    label : str
        Text for the user: ``stiffness joint1``, ``damping, all``.
    weights : ndarray, (members,)
        1 for one member; or the file's values of all members, and θ is then a factor.
    nominal : float
        θ in the file.
    """

    kind: Kind
    label: str
    weights: np.ndarray
    nominal: float

    @property
    def unit(self) -> str:
        """Unit of θ."""
        return "of the file's" if np.count_nonzero(self.weights) > 1 else self.kind.unit

    def shift(self, model: SoftModel, outputs: Sequence[str]) -> np.ndarray:
        """∂output/∂θ (outputs,) at a given motion: 1 if θ is the offset of that measurement."""
        shift = np.zeros(len(outputs))
        if self.kind.measures:
            names = [self.kind.measures + name for name in self.kind.members(model)]
            weight = dict(zip(names, self.weights, strict=True))
            shift += [weight.get(name, 0.0) for name in outputs]
        return shift


def parameters(model: SoftModel, kind: str, *, shared: bool = False) -> tuple[Parameter, ...]:
    """The unknowns of one kind: one for each member that the file gives, or one factor for all.

    Parameters
    ----------
    model : SoftModel
        A model without mimic joints and floating base.
    kind : str
        A name of `KINDS`.
    shared : bool
        Whether the unknown is one factor of all members' values in the file.

    Raises
    ------
    InputError
        For an unknown kind, or one without values in the file.
    """
    check_model(model)
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError("kind", f"one of {', '.join(KINDS)}", did_you_mean(str(kind), KINDS))
    shared = flag("shared", shared)
    known = KINDS[kind]
    nominal, names = np.asarray(known.nominal(model)), known.members(model)
    about_zero = known in (KINDS["rest"], KINDS["offset"])
    present = np.arange(len(names)) if about_zero else np.flatnonzero(nominal)
    if not present.size:
        raise InputError(kind, "a first guess in the robot's file", "none of it")
    if shared and about_zero:
        raise InputError(kind, "each for itself, --free", "one factor for all")
    if shared:
        return (Parameter(known, f"{kind}, all", nominal.copy(), 1.0),)
    units = np.eye(len(names))
    return tuple(
        Parameter(known, f"{kind} {names[int(k)]}", units[k], float(nominal[k])) for k in present
    )


def unknowns_of(
    model: SoftModel, free: Sequence[str] = (), shared: Sequence[str] = ()
) -> tuple[Parameter, ...]:
    """The unknowns of several kinds; by default stiffness and damping of each joint.

    Parameters
    ----------
    model : SoftModel
        As for `parameters`.
    free, shared : sequence of str
        Kinds with one unknown for each member, and kinds with one factor for all.

    Raises
    ------
    InputError
        As in `parameters`, and for a kind that is named twice.
    """
    free = instances("free", free, str, "a kind")
    shared = instances("shared", shared, str, "a kind")
    if not free and not shared:
        free = ("stiffness", "damping")
    found = [parameters(model, kind) for kind in free]
    found += [parameters(model, kind, shared=True) for kind in shared]
    several = tuple(one for some in found for one in some)
    distinct(several)
    return several


def distinct(unknowns: Sequence[Parameter]) -> None:
    """Refuse a member in two unknowns, because only their product would be identifiable."""
    for name, group in groupby(
        sorted(unknowns, key=lambda one: one.kind.name), lambda one: one.kind.name
    ):
        same = list(group)
        if (np.sum([one.weights != 0 for one in same], axis=0) > 1).any():
            labels = ", ".join(dict.fromkeys(one.label for one in same))
            raise InputError(
                name, "each member in one unknown, --free or --shared", f"twice: {labels}"
            )


def columns_of(unknowns: Sequence[Parameter], sample: MotionSample, count: int) -> np.ndarray:
    """∂r/∂z (n, count): the unknowns' columns, then zeros."""
    found = np.zeros((len(sample.a), count))
    at = 0
    for _, group in groupby(unknowns, lambda parameter: parameter.kind.name):
        same = list(group)
        weights = np.stack([parameter.weights for parameter in same], 1)
        found[:, at : at + len(same)] = same[0].kind.columns(sample) @ weights
        at += len(same)
    return found


def member_values(
    model: SoftModel, unknowns: Sequence[Parameter], theta: np.ndarray
) -> dict[str, dict[str, float]]:
    """Values from θ, by kind and member; members without an unknown are left out."""
    found: dict[str, dict[str, float]] = {}
    check_model(model)
    unknowns = instances("unknowns", unknowns, Parameter, "a Parameter")
    theta = array("theta", theta, (len(unknowns),), finite=False)
    for parameter, value in zip(unknowns, theta, strict=True):
        names = parameter.kind.members(model)
        members = found.setdefault(parameter.kind.name, {})
        for k in np.flatnonzero(parameter.weights):
            members[names[int(k)]] = float(parameter.weights[k] * value)
    return found


def with_values(model: SoftModel, unknowns: Sequence[Parameter], theta: np.ndarray) -> SoftModel:
    """The model with θ in place of the file's values."""
    if not instances("unknowns", unknowns, Parameter, "a Parameter"):
        return check_model(model)
    values = member_values(model, unknowns, theta)
    robot = model.robot
    for name, members in values.items():
        robot = KINDS[name].amended(robot, members)
    changed = build(robot)
    if "mass" in values:  # set in the engine, so that the file's text stays unchanged
        engine = tree_of(changed).pin_model
        for name, factor in values["mass"].items():
            body = engine.getJointId(name)
            inertia = engine.inertias[body]
            inertia.mass = factor * inertia.mass
            inertia.inertia = factor * inertia.inertia
            engine.inertias[body] = inertia
    return changed
