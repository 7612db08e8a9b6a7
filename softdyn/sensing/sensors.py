"""A model's sensors: readings without errors, and their analytic Jacobians by q, q̇ and u.

R is the orientation of a sensor's frame, p its origin, J_p and J_ω the Jacobians of p in the
world's axes and of the angular velocity in the sensor's frame. A displacement dq turns the frame
from R to R exp(J_ω dq). With gravity's acceleration γ the accelerometer reads Rᵀ (p̈ - γ), and

    ∂(Rᵀ γ)/∂q = (Rᵀ γ) × J_ω.

p̈ depends on q̈(q, q̇, u). Its derivatives at constant q̈ are Pinocchio's, and those of q̈ come from
`softdyn.dynamics.derivatives.acceleration_derivatives`.

A tension is -Σ gear u over the tendon's actuators, and k (ℓ - rest) + d ℓ̇. The second part is zero
while a tendon is slack.

A bend is the angle atan2(y, x) of the second link's axis w = (x, y, z) in the sensor's frame. With
the difference ω of both links' angular velocities in this frame ẇ = ω × w, and so its rate is

    ω_z - z (x ω_x + y ω_y) / (x² + y²).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.checks import did_you_mean, vector
from softdyn.description.readings import ReadingLayout
from softdyn.description.rig import Sensor, SensorKind
from softdyn.dynamics.derivatives import Derivatives, acceleration_derivatives
from softdyn.dynamics.engine import BASE
from softdyn.dynamics.model import (
    SoftModel,
    State,
    check_model,
    check_state,
    taut_gains,
    taut_slopes,
)
from softdyn.dynamics.points import BodyPoint, PointMotion
from softdyn.dynamics.projection import Projection, project, underlying_tree
from softdyn.dynamics.tendons import TendonGeometry
from softdyn.dynamics.tree import TreeModel
from softdyn.dynamics.winches import Winches
from softdyn.exceptions import InputError
from softdyn.sensing.measurement import Components, Measurement

LOCAL = pin.ReferenceFrame.LOCAL
STEP = 1e-5  # rad, m; of the differences of Jacobians
ACROSS = 1e-12  # least x² + y² of a bend; with less the axis stands across the plane of the bend


class Place(NamedTuple):
    """A sensor's place in a tree.

    Attributes
    ----------
    number : int
        Its tendon, the degree of freedom of its joint, or the moving body that carries it.
    frame : pinocchio.SE3
        Its frame in this body's.
    point : BodyPoint or None
        The origin of this frame, if the sensor is on a link.
    to : Place or None
        The frame with the same turn on the second link, if there is one.
    """

    number: int
    frame: pin.SE3 = pin.SE3(1)
    point: BodyPoint | None = None
    to: Place | None = None


class SensorReadings(NamedTuple):
    """The readings of all sensors, zero until each sensor's reader fills in its rows.

    Attributes
    ----------
    values : ndarray, (k,)
        The readings.
    by_q, by_v, by_u : ndarray, (k, nv), (k, nv), (k, nu)
        Their derivatives.
    """

    values: np.ndarray
    by_q: np.ndarray
    by_v: np.ndarray
    by_u: np.ndarray


class Sensors:
    """The sensors of a model, in the file's order, ready for evaluation.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    sensors : tuple of Sensor, optional
        Sensors that replace those of the robot.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    components : Components
        Names and kinds of the readings.
    feels_inputs : bool
        Whether a reading depends on the inputs: a tension or an acceleration.

    Raises
    ------
    InputError
        For a sensor of a tendon, link or joint that the robot does not have.
    """

    def __init__(self, model: SoftModel, sensors: tuple[Sensor, ...] | None = None) -> None:
        self.model = check_model(model)
        sensors = model.robot.sensors if sensors is None else sensors
        tree, self._S = underlying_tree(model)
        self._tree = tree
        layout = ReadingLayout(tuple(sensors))
        self._parts = [
            (READERS[sensor.kind], place_of(tree, sensor), rows)
            for sensor, rows in zip(layout.sensors, layout.slices, strict=True)
        ]
        angles = tuple(
            rows.start
            for sensor, (_, place, rows) in zip(sensors, self._parts, strict=True)
            if sensor.kind.form.turns or (sensor.joint and tree.chart.continuous[place.number])
        )
        self.components = Components(layout.names, layout.rotations, angles)
        self._curves = [CURVATURES.get(sensor.kind) for sensor in sensors]
        self._accelerates = any(sensor.kind is SensorKind.ACCELEROMETER for sensor in sensors)
        self.feels_inputs = any(sensor.kind.form.feels_inputs for sensor in sensors)

    def measure(self, state: State, u: np.ndarray) -> Measurement:
        """The readings without errors, and their derivatives: see `SoftModel.measure`."""
        model = self.model
        check_state(model, state)
        at = self._moment(state.q, state.v, vector("u", u, model.nu), state)
        return Measurement(*self._read(at), self.components)

    def predict(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, winches: Winches | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The readings (k,) at q (nq,), v (nv,) and u (nu,), and their Jacobian (k, 2 nv).

        With `winches` u are their commands, so that the inputs change with q and v. It needs no
        `State`, and does not check its arguments.
        """
        at = self._moment(q, v, u)
        if winches is None:
            return self._read(at)[:2]
        lengths, arms = at.cables
        motors = winches.inputs(lengths, arms @ v, u)
        at.u = motors.u
        values, jacobian, by_u = self._read(at)
        n, pulled, slow = self.model.nv, arms[winches.tendon], motors.by_rate[:, None]
        jacobian[:, :n] += by_u @ (motors.by_length[:, None] * pulled)
        if slow.any():
            jacobian[:, :n] += by_u @ (slow * at.arm_rates[winches.tendon])
            jacobian[:, n:] += by_u @ (slow * pulled)
        return values, jacobian

    def _moment(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, state: State | None = None
    ) -> Moment:
        model = self.model
        tree_q = model.expand(q) if isinstance(model, Projection) else q
        return Moment(model, self._tree, self._S, q, tree_q, v, u, self._accelerates, state)

    def _read(self, at: Moment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        n, m, size = self.model.nv, self.model.nu, len(self.components.names)
        values, jacobian, by_u = np.zeros(size), np.zeros((size, 2 * n)), np.zeros((size, m))
        found = SensorReadings(values, jacobian[:, :n], jacobian[:, n:], by_u)
        for read, place, rows in self._parts:
            read(at, place, rows, found)
        return values, jacobian, by_u

    def hessians(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, winches: Winches | None = None
    ) -> np.ndarray:
        """The second derivatives (k, nv, nv) of `predict` by q, symmetric.

        They are analytic if all sensors read lengths, positions and joints, else differences.
        """
        n = self.model.nv
        curves = [curve for curve in self._curves if curve is not None]
        if len(curves) == len(self._parts):
            at = self._moment(q, v, u)
            found = np.zeros((len(self.components.names), n, n))
            for curve, (_, place, rows) in zip(curves, self._parts, strict=True):
                curve(at, place, found[rows])
        else:
            ends = [
                [
                    self.predict(self.model.integrate(q, x), v, u, winches)[1][:, :n]
                    for x in (step, -step)
                ]
                for step in STEP * np.eye(n)
            ]
            found = np.stack([ahead - behind for ahead, behind in ends], axis=2) / (2 * STEP)
        return 0.5 * (found + found.transpose(0, 2, 1))  # turns of a floating base do not commute


def measure(model: SoftModel, state: State, u: np.ndarray) -> Measurement:
    """The readings of a model's own sensors without errors: see `SoftModel.measure`."""
    known = vars(check_model(model))
    if "_sensors" not in known:
        known["_sensors"] = Sensors(model)
    sensors: Sensors = known["_sensors"]
    return sensors.measure(state, u)


@dataclass(eq=False)  # frozen, its creation would take as long as a reading
class Moment:
    """The terms at one state that several sensors share, each computed at most once.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    tree, S : TreeModel, ndarray or None
        The tree that computes its terms: see `softdyn.dynamics.projection.underlying_tree`.
    q, tree_q : ndarray, (nq,), (tree.nq,)
        Configurations of the model and of the tree.
    v, u : ndarray, (nv,), (nu,)
        Velocity and input.
    accelerates : bool
        Whether a sensor needs q̈.
    state : State, optional
        The State of (q, v), if there is one.
    """

    model: SoftModel
    tree: TreeModel
    S: np.ndarray | None
    q: np.ndarray
    tree_q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    accelerates: bool
    state: State | None = None

    def projected(self, rows: np.ndarray) -> np.ndarray:
        """Derivatives (k, nv) from those by the tree's velocities or displacements."""
        return rows if self.S is None else rows @ self.S

    @cached_property
    def kinematics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Views of the engine's results: it may only be used for the same q meanwhile."""
        return self.tree.kinematics(self.tree_q)

    @cached_property
    def geometry(self) -> TendonGeometry:
        """The tree's tendons, from the `kinematics`."""
        return self.tree.tendons.at(self.tree.chart.of(self.tree_q), *self.kinematics)

    @cached_property
    def cables(self) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (tendons,) and moment arms (tendons, nv)."""
        if self.state is not None:
            return self.state.lengths, self.state.moment_arms
        return self.geometry.lengths, self.projected(self.geometry.moment_arms)

    @cached_property
    def arm_rates(self) -> np.ndarray:
        """Rates (tendons, nv) of the moment arms."""
        none = np.zeros(len(self.tree.tendons.names))
        v = self.v if self.S is None else self.S @ self.v
        return self.projected(self.geometry.curvature(none, v)[1])

    @cached_property
    def elasticity(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """∂T/∂ℓ and ∂T/∂ℓ̇ of the springs' and dampers' tensions T, and T (tendons,)."""
        model, (lengths, arms) = self.model, self.cables
        rates = arms @ self.v
        gain, damping = taut_gains(model, lengths, rates)
        tension = gain * (lengths - model.tendon_rest) + damping * rates
        return *taut_slopes(model, lengths, rates), tension

    @cached_property
    def acceleration(self) -> Derivatives:
        """q̈ and its derivatives."""
        return acceleration_derivatives(self.model, self.q, self.v, self.u)

    @cached_property
    def data(self) -> pin.Data:
        """Pinocchio's results of velocities and accelerations, for gyros and accelerometers."""
        tree, v = self.tree, self.v
        a = self.acceleration.value if self.accelerates else np.zeros(self.model.nv)
        if self.S is not None:
            v, a = self.S @ v, self.S @ a
        engine, q = tree.engine, tree.about_base(self.tree_q)
        pin.computeForwardKinematicsDerivatives(engine, tree.pin_data, q, v, a)
        return tree.pin_data


Reader = Callable[[Moment, Place, slice, SensorReadings], None]


def _length(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    lengths, arms = at.cables
    out.values[rows], out.by_q[rows] = lengths[place.number], arms[place.number]


def _tension(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    t, tree = place.number, at.tree
    gain, damping, tension = at.elasticity
    lengths, arms = at.cables[0], at.cables[1][t]
    pulls = np.where(tree.actuated == t, -tree.gears_at(lengths), 0.0)
    out.values[rows] = tension[t] + pulls @ at.u
    out.by_q[rows] = gain[t] * arms
    if tree.areas is not None:
        slopes = np.where(tree.actuated == t, tree.areas.slopes(lengths), 0.0)
        out.by_q[rows] -= (slopes @ at.u) * arms
    if damping[t]:
        out.by_q[rows] += damping[t] * at.arm_rates[t]
    out.by_v[rows] = damping[t] * arms
    out.by_u[rows] = pulls


def _pressure(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    chambers = np.array([actuator.is_chamber for actuator in at.tree.robot.actuators])
    chosen = np.where(at.tree.actuated == place.number, chambers, 0.0)
    out.values[rows], out.by_u[rows] = chosen @ at.u, chosen


def _joint(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    out.values[rows] = at.tree.coordinates(at.tree_q)[place.number]
    out.by_q[rows] = at.projected(np.eye(1, at.tree.nv, place.number))


def _position(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    motion, three = _moved(at, place), slice(rows.start, rows.start + 3)
    out.values[three], out.by_q[three] = motion.y, at.projected(motion.J)
    if at.tree.chart.floating:
        out.values[three] += at.tree_q[:3]


def _pose(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    _position(at, place, rows, out)
    rotation, turn = (
        at.kinematics[1][place.number] @ place.frame.rotation,
        slice(rows.stop - 3, rows.stop),
    )
    out.values[turn] = pin.log3(rotation)
    out.by_q[turn] = at.projected(rotation.T @ _moved(at, place).turning)


def _moved(at: Moment, place: Place) -> PointMotion:
    assert place.point is not None
    return place.point.at(*at.kinematics)


def _bend(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    assert place.to is not None
    own, other = (at.kinematics[1][one.number] @ one.frame.rotation for one in (place, place.to))
    x, y, z = own.T @ other[:, 0]
    turn = own.T @ (_moved(at, place.to).turning - _moved(at, place).turning)
    aside = z / max(x * x + y * y, ACROSS)
    out.values[rows] = math.atan2(y, x)
    out.by_q[rows] = at.projected(turn[2] - aside * (x * turn[0] + y * turn[1]))


def _gyro(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    data, engine = at.data, at.tree.engine
    out.values[rows] = pin.getFrameVelocity(engine, data, place.number, place.frame, LOCAL).angular
    by = pin.getFrameVelocityDerivatives(engine, data, place.number, place.frame, LOCAL)
    by_q, by_v = (np.reshape(block, (6, at.tree.nv))[3:] for block in by)
    out.by_q[rows], out.by_v[rows] = at.projected(by_q), at.projected(by_v)


def _accelerometer(at: Moment, place: Place, rows: slice, out: SensorReadings) -> None:
    data, engine = at.data, at.tree.engine
    where = engine, data, place.number, place.frame, LOCAL
    rotation = data.oMi[place.number].rotation @ place.frame.rotation
    gravity = rotation.T @ engine.gravity.linear
    out.values[rows] = pin.getFrameClassicalAcceleration(*where).linear - gravity
    blocks = pin.getPointClassicAccelerationDerivatives(*where)[1:]
    by_q, by_v, by_a = (np.reshape(block, (3, at.tree.nv)) for block in blocks)
    turning = np.reshape(pin.getFrameJacobian(*where), (6, at.tree.nv))[3:]
    by_a, found = at.projected(by_a), at.acceleration
    out.by_q[rows] = at.projected(by_q - pin.skew(gravity) @ turning) + by_a @ found.q
    out.by_v[rows] = at.projected(by_v) + by_a @ found.v
    out.by_u[rows] = by_a @ found.u


READERS = {
    SensorKind.LENGTH: _length,
    SensorKind.TENSION: _tension,
    SensorKind.POSITION: _position,
    SensorKind.POSE: _pose,
    SensorKind.GYRO: _gyro,
    SensorKind.ACCELEROMETER: _accelerometer,
    SensorKind.JOINT: _joint,
    SensorKind.BEND: _bend,
    SensorKind.PRESSURE: _pressure,
}


def _length_curvature(at: Moment, place: Place, hessians: np.ndarray) -> None:
    tree = at.tree
    chosen = (np.arange(len(tree.tendons.names)) == place.number).astype(float)
    bend, _ = at.geometry.curvature(chosen, np.zeros(tree.nv))
    hessians[0] = project(at.S, bend)


def _position_curvature(at: Moment, place: Place, hessians: np.ndarray) -> None:
    assert place.point is not None
    motion = _moved(at, place)
    for x, axis in enumerate(np.eye(3)):
        hessians[x] = project(at.S, place.point.curvature(motion, axis))


def _straight(at: Moment, place: Place, hessians: np.ndarray) -> None:
    """A joint's reading is linear."""


CURVATURES: dict[SensorKind, Callable[[Moment, Place, np.ndarray], None]] = {
    SensorKind.LENGTH: _length_curvature,
    SensorKind.POSITION: _position_curvature,
    SensorKind.JOINT: _straight,
}


def place_of(tree: TreeModel, sensor: Sensor) -> Place:
    """The tendon, the degree of freedom or the body of a sensor.

    Raises
    ------
    InputError
        If the robot does not have it.
    """
    robot = tree.robot
    part = sensor.kind.form.place[0]
    if part == "link":
        own = pin.SE3(sensor.origin.rotation, sensor.origin.translation)
        place, *others = (
            _on_link(tree, sensor, link, own) for link in (sensor.link, sensor.to) if link
        )
        return place._replace(to=others[0]) if others else place
    if part == "joint":
        base = len(BASE) if robot.floating else 0  # a joint may have the name of one of these
        names = tree.joint_names[base:]
        return Place(base + _known(sensor, sensor.joint, "joint that moves", names))
    names = tree.tendons.names
    return Place(_known(sensor, sensor.tendon, "tendon", names))


def _on_link(tree: TreeModel, sensor: Sensor, link: str, own: pin.SE3) -> Place:
    """The place of a frame `own` on a link."""
    _known(sensor, link, "link", [one.name for one in tree.robot.links])
    frame = tree.engine.frames[tree.engine.getFrameId(link, pin.FrameType.BODY)]
    at = frame.placement * own
    return Place(frame.parentJoint, at, BodyPoint(tree.engine, frame.parentJoint, at.translation))


def _known(sensor: Sensor, name: str, what: str, names: Sequence[str]) -> int:
    if name not in names:
        raise InputError(
            f"sensor {sensor.name!r}", f"a {what} of the robot", did_you_mean(name, names)
        )
    return names.index(name)
