"""The kinds of parameters: each kind's columns in r = M q̈ + h - B u, and its setter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from softdyn.actuation.capstan import Capstan
from softdyn.description.robot import Robot, Wrap
from softdyn.dynamics.derivatives import mass_columns
from softdyn.dynamics.forces import number_names, with_number
from softdyn.dynamics.model import SoftModel, State, taut_gains
from softdyn.dynamics.tree import tree_of
from softdyn.identification.markers.camera import CAMERA
from softdyn.identification.unknowns.friction import friction_of
from softdyn.identification.unknowns.relaxation import (
    SHARE,
    TIME,
    shares,
    times,
    with_shares,
    with_stiffness,
    with_times,
)
from softdyn.identification.unknowns.sensor_errors import READ, biases, layout_of, with_biases

SHIFT = 1e-4  # of a coefficient of friction, for central differences
SHORTEST = 1e-3  # s, of a branch's time; a shorter one is a damper
DIFFERENCE = 1e-4  # relative shift of an unknown, where derivatives are differences


class Neighbour(NamedTuple):
    """A model at θ with unknown number `at` larger by `width`."""

    at: int
    model: SoftModel
    width: float


class Around(NamedTuple):
    """The model of the file, and models whose parameters differ from θ in one entry each.

    The differences between these models give the derivatives by θ.
    """

    file: SoftModel
    neighbours: tuple[Neighbour, ...] = ()


class MotionSample(NamedTuple):
    """A state with its acceleration and input, and the models around its own.

    `direction` (tendons,) is that in which each cable slid last, for an equilibrium.
    """

    state: State
    a: np.ndarray
    u: np.ndarray
    around: Around
    direction: np.ndarray | None = None

    def residual(self, model: SoftModel) -> np.ndarray:
        """r = M a + h - B u (n,) of another model at this motion."""
        state = model.state(self.state.q, self.state.v)
        result: np.ndarray = state.M @ self.a + state.h - state.B @ self.u
        if self.direction is not None and any(one.friction for one in model.robot.tendons):
            there = self._replace(state=state)
            result -= capstan_forces(there, Capstan(model))
        return result


class Maker(Protocol):
    """Makes a model from numbers that are not in a URDF, such as those of a design."""

    def model_of(self, values: Mapping[str, float]) -> SoftModel:
        """The model with other values, by member."""

    def unit(self, label: str) -> str:
        """Unit of a member."""


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
    maker : Maker, optional
        For a kind of numbers from which the robot is made; the members name these.
    about_zero : bool
        Whether the values are about zero, so that no deviation is relative to them.
    rebuilds : bool
        Whether derivatives by the values are differences to robots with other values. The `columns`
        are not used then.
    from_none : bool
        Whether all members are unknown if the file gives no value to any of them. The data must
        then give the first guess.
    """

    name: str
    unit: str
    members: Callable[[SoftModel], Sequence[str]]
    nominal: Callable[[SoftModel], np.ndarray]
    columns: Callable[[MotionSample], np.ndarray]
    amended: Callable[[Robot, dict[str, float]], Robot]
    lower: float = 0.0
    measures: str = ""
    maker: Maker | None = None
    about_zero: bool = False
    rebuilds: bool = False
    from_none: bool = False

    @property
    def differs(self) -> bool:
        """Whether derivatives are differences to other robots."""
        return self.rebuilds or self.maker is not None


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


def _wraps(robot: Robot) -> dict[str, Wrap]:
    """The round bodies by the name of their tendon and their number along it, from 1."""
    return {
        f"{tendon.name}.{k}": wrap
        for tendon in robot.tendons
        for k, wrap in enumerate(tendon.wraps, 1)
    }


def _with_radii(robot: Robot, values: dict[str, float]) -> Robot:
    """Set radii of round bodies; a side point stays on its side of the surface."""
    known, changed = _wraps(robot), {}
    for name in values.keys() & known.keys():
        wrap, radius = known[name], values[name]
        side = wrap.side
        if side is not None:
            off = (np.array(side) - wrap.xyz) * (radius / wrap.radius)
            side = tuple((wrap.xyz + off).tolist())
        changed[name] = replace(wrap, radius=radius, side=side)
    tendons = tuple(
        replace(
            tendon,
            wraps=tuple(
                changed.get(f"{tendon.name}.{k}", wrap) for k, wrap in enumerate(tendon.wraps, 1)
            ),
        )
        for tendon in robot.tendons
    )
    return replace(robot, tendons=tendons)


def _force_numbers(model: SoftModel) -> dict[str, float]:
    """The numbers of the forces of one's own, by NAME.FIELD."""
    return {
        f"{force.name}.{field}": float(getattr(force, field))
        for force in model.forces
        for field in number_names(force)
    }


def _with_force_numbers(robot: Robot, values: dict[str, float]) -> Robot:
    forces = [*robot.forces]
    for place, value in values.items():
        forces = with_number(forces, place, value)
    return replace(robot, forces=tuple(forces))


def _joints(model: SoftModel) -> Sequence[str]:
    return model.joint_names


def _tendons(model: SoftModel) -> Sequence[str]:
    return model.tendons.names


def _inputs(model: SoftModel) -> Sequence[str]:
    return [actuator.name for actuator in model.robot.actuators]


def _sensors(model: SoftModel) -> Sequence[str]:
    return [sensor.name for sensor in layout_of(model.robot).sensors]


def _coordinates(sample: MotionSample) -> np.ndarray:
    return sample.state.model.coordinates(sample.state.q)


def _rubbing(sample: MotionSample) -> np.ndarray:
    return np.diag(friction_of(sample.state.model).signs(sample.state.v))


def _stretch(sample: MotionSample) -> np.ndarray:
    return _coordinates(sample) - sample.state.model.rest


def _mass_columns(sample: MotionSample) -> np.ndarray:
    state = sample.state
    return mass_columns(sample.around.file, state.q, state.v, sample.a)


def _gear_columns(sample: MotionSample) -> np.ndarray:
    tree, u = tree_of(sample.state.model), sample.u
    if tree.areas is not None:
        u = u * tree.areas.growths(sample.state.lengths)
    return -(sample.state.moment_arms[tree.actuated] * u[:, None]).T


def _coefficients(robot: Robot) -> dict[str, float]:
    """The coefficients of areas that change, by the name of their input and their number."""
    return {
        f"{one.name}.{k}": value
        for one in robot.actuators
        for k, value in enumerate(one.area_growth, 1)
    }


def _growth_columns(sample: MotionSample) -> np.ndarray:
    tree, state = tree_of(sample.state.model), sample.state
    columns: list[np.ndarray] = []
    if tree.areas is not None:
        stretches = tree.areas.stretches(state.lengths)
        columns = [
            -tree.gear[k] * sample.u[k] * stretches[k] ** power
            * state.moment_arms[tree.actuated[k]]
            for k, one in enumerate(tree.robot.actuators)
            for power in range(1, 1 + len(one.area_growth))
        ]  # fmt: skip
    return np.array(columns).reshape(-1, tree.nv).T


def _with_growth(robot: Robot, values: dict[str, float]) -> Robot:
    known = _coefficients(robot) | values
    actuators = tuple(
        replace(one, area_growth=tuple(
            known[f"{one.name}.{k}"] for k in range(1, 1 + len(one.area_growth))
        ))
        for one in robot.actuators
    )  # fmt: skip
    return replace(robot, actuators=actuators)


def _tendon_spring(sample: MotionSample) -> np.ndarray:
    model, state = sample.state.model, sample.state
    stretch = (state.lengths - model.tendon_rest) * _taut(state)
    return (state.moment_arms * stretch[:, None]).T


def _tendon_damper(sample: MotionSample) -> np.ndarray:
    arms = sample.state.moment_arms
    rates = (arms @ sample.state.v) * _taut(sample.state)
    return (arms * rates[:, None]).T


def _free_lengths(sample: MotionSample) -> np.ndarray:
    model, state = sample.state.model, sample.state
    return -(state.moment_arms * (model.tendon_stiffness * _taut(state))[:, None]).T


def _taut(state: State) -> np.ndarray:
    """Whether (tendons,) each tendon's spring and damper act."""
    gain, damping = taut_gains(state.model, state.lengths, state.moment_arms @ state.v)
    return ~state.model.tendon_slack | (gain > 0) | (damping > 0)


def _capstan_columns(sample: MotionSample) -> np.ndarray:
    """Minus the derivatives of the friction's joint forces, as central differences."""
    model, tendons = sample.state.model, sample.state.model.robot.tendons
    found, mu = np.zeros((model.nv, len(tendons))), np.array([one.friction for one in tendons])
    if sample.direction is None:
        return found
    for k in range(len(mu)):
        shift = SHIFT * np.eye(len(mu))[k]
        ends = [capstan_forces(sample, Capstan(model, mu + s * shift)) for s in (1, -1)]
        found[:, k] = (ends[1] - ends[0]) / (2 * SHIFT)
    return found


def capstan_forces(sample: MotionSample, capstan: Capstan) -> np.ndarray:
    """Joint forces (n,) of cables that slid last in the sample's directions."""
    assert sample.direction is not None
    guides = capstan.at(sample.state)
    return guides.forces(sample.u, sample.direction[capstan.tendon])


def _loss_columns(sample: MotionSample) -> np.ndarray:
    model = sample.state.model
    if sample.direction is None:
        return np.zeros((model.nv, model.nu))
    by_u, capstan = sample.state.B, Capstan(model)
    if len(capstan.tendon):
        ways = sample.direction[capstan.tendon]
        by_u = by_u + capstan.derivatives(sample.state, sample.u, ways).u
    acts = (sample.u != 0) | (model.u_min < 0)  # a cable without tension has nothing to lose
    result: np.ndarray = by_u * acts * sample.direction[tree_of(model).actuated]
    return result


def _of_branches(
    name: str,
    unit: str,
    numbers: Callable[[Robot], dict[str, float]],
    amended: Callable[[Robot, dict[str, float]], Robot],
    lower: float,
) -> Kind:
    """Numbers of Maxwell branches, whose torques are no part of r at rest; see `trajectory`."""
    return Kind(
        name, unit, lambda model: list(numbers(model.robot)),
        lambda model: np.array(list(numbers(model.robot).values())),
        lambda sample: np.zeros((len(sample.a), len(numbers(sample.state.model.robot)))),
        amended, lower,
    )  # fmt: skip


CABLE_FRICTION = Kind(
    "cable_friction", "", _tendons,
    lambda model: np.array([one.friction for one in model.robot.tendons]),
    _capstan_columns, _in("tendons", "friction"),
)  # fmt: skip
"""The coefficient μ of a cable on its guides, for equilibria."""
INPUT_LOSS = Kind(
    "input_loss", "unit of u", _inputs, lambda model: np.zeros(model.nu),
    _loss_columns, lambda robot, values: robot, measures="input.", about_zero=True,
)  # fmt: skip
"""The part of an input that friction at its driven end takes, against the last motion."""
SENSOR_BIAS = Kind(
    "sensor_bias", "m, rad", lambda model: list(biases(model.robot)),
    lambda model: np.array(list(biases(model.robot).values())),
    lambda sample: np.zeros((len(sample.a), len(biases(sample.state.model.robot)))),
    with_biases, -np.inf, READ, about_zero=True,
)  # fmt: skip
"""The constant error of each reading."""
SENSOR_LATENCY = Kind(
    "sensor_latency", "s", _sensors,
    lambda model: np.array([sensor.latency for sensor in layout_of(model.robot).sensors]),
    lambda sample: np.zeros((len(sample.a), len(_sensors(sample.state.model)))),
    _in("sensors", "latency"), 0.0, "late.", about_zero=True,
)  # fmt: skip
"""The age of each sensor's readings when they arrive."""
SENSOR_ERRORS = SENSOR_BIAS, SENSOR_LATENCY

KINDS = {
    kind.name: kind
    for kind in (
        Kind("stiffness", "N m/rad, N/m", _joints, lambda model: model.stiffness,
             lambda sample: np.diag(_stretch(sample)), with_stiffness, from_none=True),
        Kind("damping", "N m s/rad, N s/m", _joints, lambda model: model.damping,
             lambda sample: np.diag(sample.state.v), _in("joints", "damping"), from_none=True),
        Kind("friction", "N m, N", _joints, lambda model: friction_of(model).size,
             _rubbing, _in("joints", "friction")),
        Kind("rest", "rad, m", _joints, lambda model: model.rest,
             lambda sample: -np.diag(sample.state.model.stiffness), _in("joints", "rest"), -np.inf),
        Kind("armature", "kg m^2, kg", _joints, lambda model: model.armature,
             lambda sample: np.diag(sample.a), _in("joints", "armature"), from_none=True),
        Kind("mass", "of the file's", _joints, lambda model: np.ones(model.nv),
             _mass_columns,
             lambda robot, values: robot),
        Kind("gear", "N per unit of u", _inputs, lambda model: tree_of(model).gear,
             _gear_columns, _in("actuators", "gear"), -np.inf),
        Kind("area_growth", "", lambda model: list(_coefficients(model.robot)),
             lambda model: np.array(list(_coefficients(model.robot).values())),
             _growth_columns, _with_growth, -np.inf, about_zero=True),
        Kind("tendon_stiffness", "N/m", _tendons, lambda model: model.tendon_stiffness,
             _tendon_spring, _in("tendons", "stiffness")),
        Kind("tendon_damping", "N s/m", _tendons, lambda model: model.tendon_damping,
             _tendon_damper, _in("tendons", "damping")),
        Kind("free_length", "m", _tendons, lambda model: model.tendon_rest,
             _free_lengths, _in("tendons", "rest"), -np.inf, about_zero=True),
        Kind("offset", "m", _tendons, lambda model: np.zeros(len(model.tendons.names)),
             lambda sample: np.zeros(sample.state.moment_arms.T.shape), lambda robot, values: robot,
             -np.inf, "length.", about_zero=True),
        Kind("wrap_radius", "m", lambda model: list(_wraps(model.robot)),
             lambda model: np.array([wrap.radius for wrap in _wraps(model.robot).values()]),
             lambda sample: np.zeros((len(sample.a), len(_wraps(sample.state.model.robot)))),
             _with_radii, rebuilds=True),
        Kind("force", "", lambda model: list(_force_numbers(model)),
             lambda model: np.array([*_force_numbers(model).values()]),
             lambda sample: np.zeros((len(sample.a), len(_force_numbers(sample.state.model)))),
             _with_force_numbers, -np.inf, rebuilds=True, from_none=True),
        _of_branches(SHARE, "of the instantaneous stiffness", shares, with_shares, 0.0),
        _of_branches(TIME, "s", times, with_times, SHORTEST),
        CABLE_FRICTION,
        INPUT_LOSS,
        SENSOR_BIAS,
        SENSOR_LATENCY,
    )
}  # fmt: skip
SEEN = Kind(
    "camera", "m, rad", lambda model: CAMERA, lambda model: np.zeros(len(CAMERA)),
    lambda sample: np.zeros((len(sample.a), len(CAMERA))), lambda robot, values: robot,
    -np.inf, "camera.", about_zero=True,
)  # fmt: skip
"""The camera's numbers; a fit starts from a first guess that is not in the robot's file."""
