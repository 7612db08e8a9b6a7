"""A model's sensors: readings without errors, and their analytic Jacobians by q, q̇ and u.

R is the orientation of a sensor's frame, p its origin, J_p and J_ω the Jacobians of p in the
world's axes and of the angular velocity in the sensor's frame. A displacement dq turns the frame
from R to R exp(J_ω dq). With gravity's acceleration γ the accelerometer reads Rᵀ (p̈ - γ), and

    ∂(Rᵀ γ)/∂q = (Rᵀ γ) × J_ω.

p̈ depends on q̈(q, q̇, u). Its derivatives at constant q̈ are Pinocchio's, and those of q̈ come from
`softdyn.dynamics.derivatives.acceleration_derivatives`.

A tension is -Σ gear u over the tendon's actuators, and k (ℓ - rest) + d ℓ̇. The second part is zero
while a tendon is slack.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.checks import did_you_mean, vector
from softdyn.description.rig import Sensor, SensorKind
from softdyn.dynamics.derivatives import Derivatives, acceleration_derivatives, tendon_curvature
from softdyn.dynamics.engine import BASE
from softdyn.dynamics.model import SoftModel, State, check_model, check_state, taut_gains
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.dynamics.tree import TreeModel
from softdyn.exceptions import InputError
from softdyn.sensing.measurement import Components, Measurement

LOCAL = pin.ReferenceFrame.LOCAL
SUFFIXES = {1: ("",), 3: (".x", ".y", ".z"), 6: (".x", ".y", ".z", ".rx", ".ry", ".rz")}
ON_LINKS = (SensorKind.POSITION, SensorKind.POSE, SensorKind.GYRO, SensorKind.ACCELEROMETER)


class Place(NamedTuple):
    """A sensor's place in a tree.

    Attributes
    ----------
    number : int
        Its tendon, the degree of freedom of its joint, or the moving body that carries it.
    frame : pinocchio.SE3
        Its frame in this body's.
    """

    number: int
    frame: pin.SE3


class SensorRows(NamedTuple):
    """One sensor's part of the results, zero until a reader fills it.

    Attributes
    ----------
    values : ndarray, (size,)
        The readings.
    by_q, by_v, by_u : ndarray, (size, nv), (size, nv), (size, nu)
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

    Raises
    ------
    InputError
        For a sensor of a tendon, link or joint that the robot does not have.
    """

    def __init__(self, model: SoftModel, sensors: tuple[Sensor, ...] | None = None) -> None:
        self.model = check_model(model)
        sensors = model.robot.sensors if sensors is None else sensors
        tree, _ = underlying_tree(model)
        names: list[str] = []
        turned, wrapped = [], []
        self._parts: list[tuple[Callable[[Moment, Place, SensorRows], None], Place, slice]] = []
        for sensor in sensors:
            place, first = place_of(tree, sensor), len(names)
            names += [sensor.name + suffix for suffix in SUFFIXES[sensor.kind.size]]
            self._parts.append((READERS[sensor.kind], place, slice(first, len(names))))
            if sensor.kind is SensorKind.POSE:
                turned.append(first + 3)
            if sensor.kind is SensorKind.JOINT and tree.chart.continuous[place.number]:
                wrapped.append(first)
        self.components = Components(tuple(names), tuple(turned), tuple(wrapped))
        kinds = [sensor.kind for sensor in sensors]
        self._accelerates = SensorKind.ACCELEROMETER in kinds

    def measure(self, state: State, u: np.ndarray) -> Measurement:
        """The readings without errors, and their derivatives: see `SoftModel.measure`."""
        model = self.model
        n = model.nv
        check_state(model, state)
        moment = Moment(model, state, vector("u", u, model.nu), self._accelerates)
        size = len(self.components.names)
        values, jacobian, by_u = np.zeros(size), np.zeros((size, 2 * n)), np.zeros((size, model.nu))
        by_q, by_v = jacobian[:, :n], jacobian[:, n:]
        for read, place, rows in self._parts:
            read(moment, place, SensorRows(values[rows], by_q[rows], by_v[rows], by_u[rows]))
        return Measurement(values, jacobian, by_u, self.components)


@dataclass(frozen=True, eq=False)
class Moment:
    """The terms at one state that several sensors share, each computed at most once.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    state : State
        The robot's state.
    u : ndarray, (nu,)
        Input.
    accelerates : bool
        Whether a sensor needs q̈.
    """

    model: SoftModel
    state: State
    u: np.ndarray
    accelerates: bool

    @cached_property
    def tree(self) -> TreeModel:
        """The tree that computes the model's terms."""
        return underlying_tree(self.model)[0]

    @cached_property
    def q(self) -> np.ndarray:
        """The tree's configuration."""
        model, q = self.model, self.state.q
        return model.expand(q) if isinstance(model, Projection) else q

    def projected(self, rows: np.ndarray) -> np.ndarray:
        """Derivatives (k, nv) from those by the tree's velocities or displacements."""
        return rows @ self.model.S if isinstance(self.model, Projection) else rows

    @cached_property
    def arm_rates(self) -> np.ndarray:
        """Rates (tendons, nv) of the moment arms."""
        none = np.zeros(len(self.state.lengths))
        return tendon_curvature(self.model, self.state.q, none, self.state.v)[1]

    @cached_property
    def elasticity(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stiffness and damping of the taut tendons, and the springs' and dampers' tensions."""
        state, model = self.state, self.model
        rates = state.moment_arms @ state.v
        gain, damping = taut_gains(model, state.lengths, rates)
        return gain, damping, gain * (state.lengths - model.tendon_rest) + damping * rates

    @cached_property
    def acceleration(self) -> Derivatives:
        """q̈ and its derivatives."""
        return acceleration_derivatives(self.model, self.state.q, self.state.v, self.u)

    @cached_property
    def data(self) -> pin.Data:
        """Pinocchio's results of the kinematics, with q̈ for the accelerometers.

        Before the sensors on links are read, the engine may only be used for the same q.
        """
        tree, v = self.tree, self.state.v
        a = self.acceleration.value if self.accelerates else np.zeros(self.model.nv)
        if isinstance(self.model, Projection):
            v, a = self.model.S @ v, self.model.S @ a
        engine, q = tree.pin_model, tree.about_base(self.q)
        pin.computeForwardKinematicsDerivatives(engine, tree.pin_data, q, v, a)
        return tree.pin_data


def _length(at: Moment, place: Place, rows: SensorRows) -> None:
    rows.values[:] = at.state.lengths[place.number]
    rows.by_q[:] = at.state.moment_arms[place.number]


def _tension(at: Moment, place: Place, rows: SensorRows) -> None:
    t, tree = place.number, at.tree
    gain, damping, tension = at.elasticity
    pulls = np.where(tree.actuated == t, -tree.gear, 0.0)
    arms = at.state.moment_arms[t]
    rows.values[:] = tension[t] + pulls @ at.u
    rows.by_q[:] = gain[t] * arms
    if damping[t]:
        rows.by_q[:] += damping[t] * at.arm_rates[t]
    rows.by_v[:] = damping[t] * arms
    rows.by_u[:] = pulls


def _joint(at: Moment, place: Place, rows: SensorRows) -> None:
    rows.values[:] = at.tree.coordinates(at.q)[place.number]
    rows.by_q[:] = at.projected(np.eye(1, at.tree.nv, place.number))


def _position(at: Moment, place: Place, rows: SensorRows) -> None:
    _placed(at, place, SensorRows(rows.values[:3], rows.by_q[:3], rows.by_v, rows.by_u))


def _pose(at: Moment, place: Place, rows: SensorRows) -> None:
    frame, turning = _placed(
        at, place, SensorRows(rows.values[:3], rows.by_q[:3], rows.by_v, rows.by_u)
    )
    rows.values[3:] = pin.log3(frame.rotation)
    rows.by_q[3:] = at.projected(turning)


def _placed(at: Moment, place: Place, rows: SensorRows) -> tuple[pin.SE3, np.ndarray]:
    """Fill in the position; the frame, and its angular Jacobian in its own axes."""
    data, engine = at.data, at.tree.pin_model
    frame = data.oMi[place.number] * place.frame
    jacobian = pin.getFrameJacobian(engine, data, place.number, place.frame, LOCAL)
    jacobian = np.reshape(jacobian, (6, at.tree.nv))
    rows.values[:] = frame.translation
    if at.tree.chart.floating:
        rows.values[:] += at.q[:3]
    rows.by_q[:] = at.projected(frame.rotation @ jacobian[:3])
    return frame, jacobian[3:]


def _gyro(at: Moment, place: Place, rows: SensorRows) -> None:
    data, engine = at.data, at.tree.pin_model
    rows.values[:] = pin.getFrameVelocity(engine, data, place.number, place.frame, LOCAL).angular
    by = pin.getFrameVelocityDerivatives(engine, data, place.number, place.frame, LOCAL)
    by_q, by_v = (np.reshape(block, (6, at.tree.nv))[3:] for block in by)
    rows.by_q[:], rows.by_v[:] = at.projected(by_q), at.projected(by_v)


def _accelerometer(at: Moment, place: Place, rows: SensorRows) -> None:
    data, engine = at.data, at.tree.pin_model
    where = engine, data, place.number, place.frame, LOCAL
    rotation = data.oMi[place.number].rotation @ place.frame.rotation
    gravity = rotation.T @ engine.gravity.linear
    rows.values[:] = pin.getFrameClassicalAcceleration(*where).linear - gravity
    blocks = pin.getPointClassicAccelerationDerivatives(*where)[1:]
    by_q, by_v, by_a = (np.reshape(block, (3, at.tree.nv)) for block in blocks)
    turning = np.reshape(pin.getFrameJacobian(*where), (6, at.tree.nv))[3:]
    by_a, found = at.projected(by_a), at.acceleration
    rows.by_q[:] = at.projected(by_q - pin.skew(gravity) @ turning) + by_a @ found.q
    rows.by_v[:] = at.projected(by_v) + by_a @ found.v
    rows.by_u[:] = by_a @ found.u


READERS = {
    SensorKind.LENGTH: _length,
    SensorKind.TENSION: _tension,
    SensorKind.POSITION: _position,
    SensorKind.POSE: _pose,
    SensorKind.GYRO: _gyro,
    SensorKind.ACCELEROMETER: _accelerometer,
    SensorKind.JOINT: _joint,
}


def place_of(tree: TreeModel, sensor: Sensor) -> Place:
    """The tendon, the degree of freedom or the body of a sensor.

    Raises
    ------
    InputError
        If the robot does not have it.
    """
    robot = tree.robot
    if sensor.kind in ON_LINKS:
        _known(sensor, sensor.link, "link", [link.name for link in robot.links])
        frame = tree.pin_model.frames[tree.pin_model.getFrameId(sensor.link, pin.FrameType.BODY)]
        own = pin.SE3(sensor.origin.rotation, sensor.origin.translation)
        return Place(frame.parentJoint, frame.placement * own)
    if sensor.kind is SensorKind.JOINT:
        base = len(BASE) if robot.floating else 0  # a joint may have the name of one of these
        names = tree.joint_names[base:]
        return Place(base + _known(sensor, sensor.joint, "joint that moves", names), pin.SE3(1))
    names = tree.tendons.names
    return Place(_known(sensor, sensor.tendon, "tendon", names), pin.SE3(1))


def _known(sensor: Sensor, name: str, what: str, names: Sequence[str]) -> int:
    if name not in names:
        raise InputError(
            f"sensor {sensor.name!r}", f"a {what} of the robot", did_you_mean(name, names)
        )
    return names.index(name)
