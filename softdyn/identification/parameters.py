"""The unknowns of a fit: numbers of a kind, and models with other values of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from softdyn.checks import array, did_you_mean, flag, instance, instances
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel, State, check_model
from softdyn.dynamics.tree import tree_of
from softdyn.exceptions import InputError
from softdyn.identification.markers.camera import CAMERA
from softdyn.identification.unknowns.kinds import (
    INPUT_LOSS,
    KINDS,
    SEEN,
    Around,
    Kind,
    MotionSample,
    Neighbour,
)

DIFFERENCE = 1e-4  # relative shift of an unknown, where derivatives are central differences


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
        factor = self.weights[self.weights != 0].tolist() not in ([], [1.0])
        if factor and not self.kind.about_zero:
            return "of the file's"
        if self.kind.maker is not None:
            return self.kind.maker.unit(self.label)
        if self.kind is SEEN:
            return "rad" if self.names[1].startswith("r") else "m"
        return self.kind.unit

    @property
    def lower(self) -> float:
        """The least value of θ; a number of a design keeps its sign if it is positive."""
        if self.kind.maker is None:
            return self.kind.lower
        return 0.0 if self.nominal > 0 else -np.inf

    @property
    def names(self) -> tuple[str, str]:
        """Its kind and its member, ``all`` for a common factor; both are in the label."""
        kind, _, member = self.label.partition(" ")
        return kind.rstrip(","), member

    @property
    def scale(self) -> float:
        """Size of θ, which makes deviations relative."""
        return 1.0 if self.kind.about_zero else abs(self.nominal) or 1.0

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

    If the file gives no joint a stiffness, a damping or an armature, each joint has an unknown one,
    or all have the same one.

    Parameters
    ----------
    model : SoftModel
        A model without mimic joints and floating base.
    kind : str
        A name of `KINDS`; with a dot and a member's name, such as ``force.drag.size``, that member
        alone, whether the file gives it or not.
    shared : bool
        Whether the unknown is one factor of all members' values in the file.

    Raises
    ------
    InputError
        For an unknown kind or member, or a kind without values in the file.
    """
    check_model(model)
    kind, _, member = kind.partition(".") if isinstance(kind, str) else (kind, "", "")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError("kind", f"one of {', '.join(KINDS)}", did_you_mean(str(kind), KINDS))
    shared = flag("shared", shared)
    known = KINDS[kind]
    nominal, names = np.asarray(known.nominal(model)), known.members(model)
    if member:
        if member not in names:
            expected = f"one of {', '.join(names) or 'none'}"
            raise InputError(f"{kind}.{member}", expected, did_you_mean(member, names))
        if shared:
            raise InputError(f"{kind}.{member}", "a kind, for one factor of all", "one member")
        k = [*names].index(member)
        return (_member(known, names, k, float(nominal[k])),)
    about_zero = known.about_zero or known is KINDS["rest"]
    none = known.from_none and not nominal.any()
    present = np.arange(len(names)) if about_zero or none else np.flatnonzero(nominal)
    if not present.size:
        raise InputError(kind, "a first guess in the robot's file", "none of it")
    if shared and (known is INPUT_LOSS or none):
        return (Parameter(known, f"{kind}, all", np.ones(len(names)), 0.0),)
    if shared and about_zero:
        raise InputError(kind, "each for itself, --free", "one factor for all")
    if shared:
        return (Parameter(known, f"{kind}, all", nominal.copy(), 1.0),)
    return tuple(_member(known, names, int(k), float(nominal[k])) for k in present)


def _member(kind: Kind, names: Sequence[str], k: int, nominal: float) -> Parameter:
    return Parameter(kind, f"{kind.name} {names[k]}", np.eye(len(names))[k], nominal)


def camera_unknowns(start: np.ndarray) -> tuple[Parameter, ...]:
    """The camera's six numbers, from a first guess (6,)."""
    start = array("start", start, (len(CAMERA),))
    return tuple(_member(SEEN, CAMERA, k, float(value)) for k, value in enumerate(start))


def choose_unknowns(
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
    engine, here = tree_of(sample.state.model).engine, None
    for k, beside, width in sample.around.neighbours:
        if tree_of(beside).engine is not engine:  # else only its markers differ
            here = sample.residual(sample.state.model) if here is None else here
            found[:, k] = (sample.residual(beside) - here) / width
    return found


def motion_columns(
    parameters: Sequence[Parameter], state: State, a: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """∂r/∂θ (n, P) of r = M a + h - B u at the nominal values, for controllers.

    Numbers of a design and radii of round bodies have central differences, the others closed forms.

    Parameters
    ----------
    parameters : sequence of Parameter
        The P parameters of the state's robot.
    state : State
    a, u : array_like, (n,), (m,)
        Acceleration and input.

    Raises
    ------
    InputError
        For friction, which is not part of h, and for a reduced model or one with mimic joints.
    """
    model = instance("state", state, State, "a State, from model.state(q, v)").model
    tree_of(model)
    unknowns = instances("parameters", parameters, Parameter, "a Parameter")
    a, u = array("a", a, (model.nv,)), array("u", u, (model.nu,))
    for one in unknowns:
        if one.kind is KINDS["friction"]:
            raise InputError("parameters", "parameters of the model's motion", one.label)
    sample, theta = MotionSample(state, a, u, Around(model)), [one.nominal for one in unknowns]
    found = columns_of(unknowns, sample, len(unknowns))
    for k, one in enumerate(unknowns):
        if not one.kind.differs:
            continue
        shift = DIFFERENCE * max(abs(theta[k]), DIFFERENCE * one.scale)
        step = shift * np.eye(len(theta))[k]
        above, below = (
            sample.residual(apply_values(model, unknowns, theta + s * step)) for s in (1, -1)
        )
        found[:, k] = (above - below) / (2 * shift)
    return found


def neighbours_of(
    model: SoftModel, unknowns: Sequence[Parameter], theta: np.ndarray
) -> tuple[Neighbour, ...]:
    """A model for each unknown from which the robot is made, for one-sided differences."""
    found = []
    for k, unknown in enumerate(unknowns):
        if unknown.kind.differs:
            shift = DIFFERENCE * max(abs(theta[k]), DIFFERENCE * unknown.scale)
            there = theta.copy()
            there[k] += shift
            beside = apply_values(model, unknowns, there)
            found.append(Neighbour(k, beside, shift))
    return tuple(found)


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


def apply_values(model: SoftModel, unknowns: Sequence[Parameter], theta: np.ndarray) -> SoftModel:
    """The model with θ in place of the file's values."""
    if not instances("unknowns", unknowns, Parameter, "a Parameter"):
        return check_model(model)
    values = member_values(model, unknowns, theta)
    kinds = {one.kind.name: one.kind for one in unknowns}
    makers = {kind.maker: name for name, kind in kinds.items() if kind.maker is not None}
    for maker, name in makers.items():
        model = maker.model_of(values.pop(name))
    if not values:
        return model
    robot = model.robot
    for name, members in values.items():
        robot = kinds[name].amended(robot, members)
    changed = build(robot)
    if "mass" in values:  # set in the engine, so that the file's text stays unchanged
        engine = tree_of(changed).engine
        for name, factor in values["mass"].items():
            body = engine.getJointId(name)
            inertia = engine.inertias[body]
            inertia.mass = factor * inertia.mass
            inertia.inertia = factor * inertia.inertia
            engine.inertias[body] = inertia
    return changed
