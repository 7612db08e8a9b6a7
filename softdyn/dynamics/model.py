"""SoftModel: a Pinocchio model, the robot's compliance and its tendons, composed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from softdyn.compiled import COMPILES
from softdyn.description.inertia import MICROMETRE, Inertia
from softdyn.description.robot import Joint, Robot, moving_bodies
from softdyn.dynamics.kernels import Live, fixed_terms, spatial_terms
from softdyn.dynamics.state import State
from softdyn.dynamics.tendons import compile_tendons
from softdyn.exceptions import InputError, UrdfError

# A floating base in v: velocity of its origin and angular velocity, both in its own axes.
BASE = ("base_vx", "base_vy", "base_vz", "base_wx", "base_wy", "base_wz")
FREE = "floating base"  # Pinocchio's joint of it


class SoftModel:
    """The analytic dynamics of an annotated robot.

    It owns scratch memory: use one model per thread. States are independent of it.

    Parameters
    ----------
    robot : the parsed description; the engine reads the same file. One with mimic joints is for
        `softdyn.build`.
    bundled : name among the bundled robots, None for any other file.

    Raises
    ------
    InputError
        A robot with mimic joints, which are no degrees of freedom of their own.
    UrdfError
        When Pinocchio refuses the file, reads another robot in it than the strict parse did, or
        finds a singular mass matrix.
    """

    def __init__(self, robot: Robot, bundled: str | None = None) -> None:
        if robot.followers:
            raise InputError("robot", "no mimic joint: see softdyn.build", robot.path)
        self.robot = robot
        self.bundled = bundled
        self.name = robot.name
        self.pin_model = _build(robot)
        self._data = self.pin_model.createData()
        self._live = Live(self._data)
        model = self.pin_model
        self.nq, self.nv, self.nu = model.nq, model.nv, len(robot.actuators)
        bodies = range(1, model.njoints)
        base = BASE if robot.floating else ()
        self.joint_names = (*base, *model.names[1 + robot.floating :])
        self.q0 = _read_only(pin.neutral(model))
        self.u_min = _read_only([a.lower for a in robot.actuators])
        self.u_max = _read_only([a.upper for a in robot.actuators])

        # the base's six degrees of freedom have no spring, damper, armature or limit
        joints = dict.fromkeys(base, _free_joint(robot)) | {j.name: j for j in robot.joints}
        ordered = [joints[name] for name in self.joint_names]
        self.lower = _read_only([joint.lower for joint in ordered])
        self.upper = _read_only([joint.upper for joint in ordered])
        self.stiffness = _read_only([joint.stiffness for joint in ordered])
        self.rest = _read_only([joint.rest for joint in ordered])
        self.damping = _read_only([joint.damping for joint in ordered])
        self.armature = _read_only([joint.armature for joint in ordered])
        model.armature = self.armature.copy()

        # A continuous joint holds (cos, sin) in q, a floating base its position and a quaternion
        # (x, y, z, w), every other joint its coordinate.
        self._circular = np.array([joint.kind == "continuous" for joint in ordered])
        self._idx_q = np.array(
            [model.idx_qs[j] + k for j in bodies for k in range(model.nvs[j])], int
        )

        self._frame = model.getFrameId(robot.task, pin.FrameType.BODY)
        supports = np.zeros((self.nv, model.njoints), bool)
        for body in bodies:
            for j in model.supports[body]:
                supports[model.idx_vs[j] : model.idx_vs[j] + model.nvs[j], body] = True
        self._supports = supports
        self.tendons = compile_tendons(
            robot.tendons,
            {name: i for i, name in enumerate(self.joint_names)},
            self._anchor,
            supports,
        )
        index = {name: t for t, name in enumerate(self.tendons.names)}
        # B = Σ gear (∂ℓ/∂q)ᵀ over the actuators of each tendon
        self._gear = np.array([a.gear for a in robot.actuators])
        self._actuated = np.array([index[a.tendon] for a in robot.actuators], int)
        self.tendon_stiffness = _read_only([tendon.stiffness for tendon in robot.tendons])
        self.tendon_damping = _read_only([tendon.damping for tendon in robot.tendons])
        self._elastic = bool(self.tendon_stiffness.any())
        self._damped = bool(self.tendon_damping.any())
        self._joint_damping = _read_only(np.diag(self.damping))
        neutral = self._bodies(self.q0)
        lengths = self.tendons.lengths(self.coordinates(self.q0), *neutral)
        self.tendon_rest = _read_only(
            [
                length if tendon.rest is None else tendon.rest
                for tendon, length in zip(robot.tendons, lengths, strict=True)
            ]
        )
        self._fixed_arms = _read_only(self.tendons.coefficients)
        self._fixed_B = _read_only(self._input_matrix(self._fixed_arms))
        self._fixed_D = _read_only(self._damping_matrix(self._fixed_arms))
        self._pack()
        self._check_mass_matrix()

    def _pack(self) -> None:
        """Gather what the State's kernel reads, in as few arrays as possible."""
        live, tendons = self._live, self.tendons
        tip, offset = self._anchor(self.robot.task, np.zeros(3))
        model = self.pin_model
        bodies = [j for j in range(1, model.njoints) for _ in range(model.nvs[j])]
        # after a joint's first degree of freedom its others add to the same body
        before = [model.parents[j] if j not in bodies[:k] else j for k, j in enumerate(bodies)]
        beyond = [model.idx_vs[j] + self._data.nvSubtree[j] for j in bodies]
        tree = np.column_stack((self._supports[:, tip], bodies, before, beyond)).astype(int)
        joints = np.column_stack((self.stiffness, self.rest, self.damping, self.armature))
        cables = np.column_stack(
            (tendons.offset, self.tendon_stiffness, self.tendon_rest, self.tendon_damping)
        )
        self._kept: tuple[Any, ...] = (
            live.bias, live.S, live.momenta, live.centre, live.rotations, live.translations,
            tip, offset, tree, model.gravity.linear.copy(), joints, cables, tendons.coefficients,
        )  # fmt: skip
        self._terms: Callable[..., None] = fixed_terms
        self._rows = self.nv + 10
        if tendons.spatial:
            self._kept += (*tendons.packed(), self._actuated, self._gear)
            self._terms, self._rows = spatial_terms, self._rows + len(cables) + self.nu
        self._assemble = self._by_kernel if COMPILES else self._in_numpy

    def __reduce__(self) -> tuple[Any, ...]:
        # a copy's views would be of no engine's memory: built anew, from the same file
        return type(self), (self.robot, self.bundled)

    # -- state ---------------------------------------------------------------------------------

    def state(self, q: np.ndarray, v: np.ndarray) -> State:
        """Every term of the dynamics at (q, v).

        Parameters
        ----------
        q : (nq,) configuration (rad, m; (cos, sin) of a continuous joint).
        v : (nv,) velocity.

        Raises
        ------
        InputError
            Wrong shape or a number that is not finite.
        """
        q, v = self._vector("q", q, self.nq), self._vector("v", v, self.nv)
        pin.nonLinearEffects(self.pin_model, self._data, q, v)
        return self._assemble(q, v)

    def _by_kernel(self, q: np.ndarray, v: np.ndarray) -> State:
        """The rest of a State, by a kernel from what Pinocchio leaves in its memory."""
        pin.computeCentroidalMap(self.pin_model, self._data, q)
        n, nt = self.nv, len(self.tendons.names)
        rows, few = np.empty((self._rows, n)), np.empty(6 + nt)
        coordinates = q if self.nq == n else self.coordinates(q)
        self._terms(rows, few, v, coordinates, *self._kept)
        for array in (q, v, rows, few):
            array.flags.writeable = False
        arms, B, D = self._fixed_arms, self._fixed_B, self._fixed_D
        if self.tendons.spatial:
            arms, B = rows[n + 10 : n + 10 + nt], rows[n + 10 + nt :].T
            if self._damped:
                D = self._damping_matrix(arms)
                D.flags.writeable = False
        return State.trusted(
            self, q, v, rows[:n], rows[n + 6], rows[n + 7], D, B, rows[n + 8],
            rows[n : n + 3], rows[n + 3 : n + 6], few[:3], few[3:6], few[6:], arms,
            g=rows[n + 9],
        )  # fmt: skip

    def _in_numpy(self, q: np.ndarray, v: np.ndarray) -> State:
        """The same through Pinocchio's accessors and NumPy, with nothing compiled."""
        data, live = self._data, self._live
        M = pin.crba(self.pin_model, data, q, pin.Convention.WORLD).reshape(self.nv, self.nv)
        pin.computeJointJacobiansTimeVariation(self.pin_model, data, q, v)
        J = self._frame_jacobian(pin.getFrameJacobian)
        Jdot = self._frame_jacobian(pin.getFrameJacobianTimeVariation)
        y = np.array(pin.updateFramePlacement(self.pin_model, data, self._frame).translation)
        coordinates = self.coordinates(q)
        if self.tendons.spatial:
            arms, moving = self.tendons.moment_arms(live.S.T, live.rotations, live.translations)
            B, D = self._input_matrix(arms), self._damping_matrix(arms)
        else:
            arms, B, D, moving = self._fixed_arms, self._fixed_B, self._fixed_D, np.zeros(1)
        lengths = self.tendons.coefficients @ coordinates + self.tendons.offset + moving
        K = self.stiffness * (coordinates - self.rest)
        if self._elastic:
            K += arms.T @ (self.tendon_stiffness * (lengths - self.tendon_rest))
        bias = data.nle.copy()
        h = bias + D @ v + K
        arrays = (q, v, M, bias, K, D, B, h, J, Jdot, y, J @ v, lengths, arms)
        for array in arrays:
            array.flags.writeable = False
        return State.trusted(self, *arrays)

    def coriolis(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Coriolis matrix C (n, n) with Ṁ - 2C skew-symmetric."""
        q, v = self._vector("q", q, self.nq), self._vector("v", v, self.nv)
        C = pin.computeCoriolisMatrix(self.pin_model, self._data, q, v)
        return _read_only(np.reshape(C, (self.nv, self.nv)))

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Gravity force g (n,), the gradient of `gravity_energy`."""
        q = self._vector("q", q, self.nq)
        pin.computeCentroidalMap(self.pin_model, self._data, q)
        return _read_only(-self._live.momenta[:, :3] @ self.pin_model.gravity.linear)

    # -- dynamics ------------------------------------------------------------------------------

    def forward_dynamics(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Acceleration q̈ (nv,) under the input u (nu,), by the articulated-body algorithm."""
        q, v = self._vector("q", q, self.nq), self._vector("v", v, self.nv)
        u = self._vector("u", u, self.nu)
        if self.tendons.spatial:
            arms = self.tendon_moment_arms(q)
            B, D = self._input_matrix(arms), self._damping_matrix(arms)
        else:
            arms, B, D = self._fixed_arms, self._fixed_B, self._fixed_D
        tau = B @ u - D @ v - self._spring_force(q, arms)
        return np.array(pin.aba(self.pin_model, self._data, q, v, tau))

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """½ q̇ᵀ M q̇ (J), armature included."""
        q, v = self._vector("q", q, self.nq), self._vector("v", v, self.nv)
        M = np.reshape(pin.crba(self.pin_model, self._data, q), (self.nv, self.nv))
        return float(v @ M @ v) / 2

    def gravity_energy(self, q: np.ndarray) -> float:
        """Potential energy of gravity (J), zero at the world's origin."""
        q = self._vector("q", q, self.nq)
        return float(pin.computePotentialEnergy(self.pin_model, self._data, q))

    def elastic_energy(self, q: np.ndarray) -> float:
        """Energy of joint springs and elastic tendons (J)."""
        q = self._vector("q", q, self.nq)
        stretch = self.coordinates(q) - self.rest
        slack = self.tendon_lengths(q) - self.tendon_rest
        return float(self.stiffness @ stretch**2 + self.tendon_stiffness @ slack**2) / 2

    def potential_energy(self, q: np.ndarray) -> float:
        """Gravity and elastic energy together (J)."""
        return self.gravity_energy(q) + self.elastic_energy(q)

    # -- tendons -------------------------------------------------------------------------------

    def tendon_lengths(self, q: np.ndarray) -> np.ndarray:
        """Lengths (tendons,) of all tendons, in the file's order."""
        q = self._vector("q", q, self.nq)
        return self.tendons.lengths(self.coordinates(q), *self._bodies(q))

    def tendon_moment_arms(self, q: np.ndarray) -> np.ndarray:
        """Moment arms ∂ℓ/∂q (tendons, nv)."""
        q = self._vector("q", q, self.nq)
        jacobian = self._joint_jacobian(q)
        return self.tendons.moment_arms(jacobian, *self._placements())[0]

    def tendon_hessians(self, q: np.ndarray) -> np.ndarray:
        """Gradients of the moment arms ∂²ℓ/∂q² (tendons, nv, nv)."""
        q = self._vector("q", q, self.nq)
        jacobian = self._joint_jacobian(q)
        return self.tendons.hessian(jacobian, *self._placements())

    def tangent_stiffness(self, q: np.ndarray) -> np.ndarray:
        """∂K/∂q (nv, nv): joint springs, and k (a aᵀ + (ℓ - rest) ∂a/∂q) of each elastic tendon."""
        arms, force = self.tendon_moment_arms(q), self._tension(q)
        return (
            np.diag(self.stiffness)
            + arms.T @ (self.tendon_stiffness[:, None] * arms)
            + np.tensordot(force, self.tendon_hessians(q), 1)
        )

    # -- configurations ------------------------------------------------------------------------

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Joint coordinates (nv,): q itself but for continuous joints, in (-π, π].

        Those of a floating base are its position and its rotation vector.
        """
        if self.nq == self.nv:
            return np.asarray(q, float)
        values = np.asarray(q, float)[self._idx_q]
        if self.robot.floating:
            values[3:6] = pin.log3(pin.Quaternion(np.asarray(q, float)[3:7]).matrix())
        sines = self._idx_q[self._circular] + 1
        values[self._circular] = np.arctan2(q[sines], values[self._circular])
        return values

    def configuration(self, coordinates: np.ndarray) -> np.ndarray:
        """Configuration q (nq,) of joint coordinates (nv,): the inverse of `coordinates`."""
        values = self._vector("coordinates", coordinates, self.nv)
        q = np.empty(self.nq)
        q[self._idx_q] = np.where(self._circular, np.cos(values), values)
        q[self._idx_q[self._circular] + 1] = np.sin(values[self._circular])
        if self.robot.floating:
            q[3:7] = pin.Quaternion(pin.exp3(values[3:6])).coeffs()
        return q

    def integrate(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """q ⊕ dv (nq,): the configuration after the displacement dv (nv,)."""
        q, dv = self._vector("q", q, self.nq), self._vector("dv", dv, self.nv)
        return np.array(pin.integrate(self.pin_model, q, dv))

    # -- inside --------------------------------------------------------------------------------

    def _vector(self, name: str, value: np.ndarray, size: int) -> np.ndarray:
        """A fresh finite (size,) copy of an argument."""
        try:
            if not isinstance(value, np.ndarray):
                value = np.asarray(value)
            if value.dtype.kind not in "fiub":  # text and dates would become numbers
                raise TypeError
            array = np.array(value, float)
        except (TypeError, ValueError, OverflowError):
            raise InputError(name, f"{size} numbers", value) from None
        if array.shape != (size,):
            raise InputError(name, f"shape ({size},)", f"shape {array.shape}")
        # one dot product instead of a temporary: it overflows only where the slow test decides
        if not math.isfinite(array.dot(array)) and not np.isfinite(array).all():
            raise InputError(name, "finite numbers", array)
        return array

    def _anchor(self, link: str, xyz: np.ndarray) -> tuple[int, np.ndarray]:
        """Moving body that carries a point of a link, and the point in the body's frame."""
        model = self.pin_model
        frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
        return frame.parentJoint, frame.placement.act(np.array(xyz))

    def _placements(self) -> tuple[np.ndarray, np.ndarray]:
        """Live views: rotations (bodies, 3, 3), translations (bodies, 3) of the last kinematics."""
        return self._live.rotations, self._live.translations

    def _bodies(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pin.forwardKinematics(self.pin_model, self._data, q)
        return self._placements()

    def _joint_jacobian(self, q: np.ndarray) -> np.ndarray:
        jacobian = pin.computeJointJacobians(self.pin_model, self._data, q)
        return np.reshape(jacobian, (6, self.nv))

    def _frame_jacobian(self, get: Callable[..., np.ndarray]) -> np.ndarray:
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        columns = get(self.pin_model, self._data, self._frame, axes)
        return np.array(np.reshape(columns, (6, self.nv))[:3], order="C")

    def _input_matrix(self, arms: np.ndarray) -> np.ndarray:
        return (self._gear[:, None] * arms[self._actuated]).T

    def _damping_matrix(self, arms: np.ndarray) -> np.ndarray:
        if not self._damped:
            return self._joint_damping
        return self._joint_damping + arms.T @ (self.tendon_damping[:, None] * arms)

    def _tension(self, q: np.ndarray) -> np.ndarray:
        return self.tendon_stiffness * (self.tendon_lengths(q) - self.tendon_rest)

    def _spring_force(self, q: np.ndarray, arms: np.ndarray) -> np.ndarray:
        force = self.stiffness * (self.coordinates(q) - self.rest)
        return force + arms.T @ self._tension(q) if self._elastic else force

    def _check_mass_matrix(self) -> None:
        M = self.state(self.q0, np.zeros(self.nv)).M
        scale = np.sqrt(np.maximum(np.diag(M), 0.0))  # a moment may be zero but for rounding
        if (scale > 0).all():
            values, modes = np.linalg.eigh(M / np.outer(scale, scale))
            if values[0] >= 1e-14:
                return
            weakest = int(np.argmax(np.abs(modes[:, 0])))
        else:
            weakest = int(np.argmin(np.diag(M)))
        raise UrdfError(
            self.robot.path,
            "<robot>",
            "a positive definite mass matrix at q = 0",
            f"a singular one; joint {self.joint_names[weakest]!r} meets the least inertia",
        )


def _read_only(values: object) -> np.ndarray:
    array = np.array(values, float)
    array.flags.writeable = False
    return array


def _free_joint(robot: Robot) -> Joint:
    """The joint that a floating base hangs on: no file has it."""
    return Joint(FREE, "floating", "", robot.root, np.eye(3), np.zeros(3), np.zeros(3))


def _build(robot: Robot) -> pin.Model:
    """Pinocchio's model of the file, checked against the strict parse."""
    try:
        if robot.floating:
            model = pin.buildModelFromXML(robot.xml, pin.JointModelFreeFlyer(), FREE)
        else:
            model = pin.buildModelFromXML(robot.xml)
    except (ValueError, RuntimeError) as error:
        raise UrdfError(robot.path, "<robot>", "a URDF that Pinocchio reads", error) from None
    moving = {joint.name: joint for joint in robot.moving_joints}
    if robot.floating:
        moving = {FREE: _free_joint(robot)} | moving
    if not moving:
        raise UrdfError(robot.path, "<robot>", "at least one joint that moves", "none")
    bodies = moving_bodies(robot)
    freedoms = len(moving) + (5 if robot.floating else 0)
    if set(model.names[1:]) != set(moving) or model.nv != freedoms:
        raise UrdfError(robot.path, "<robot>", f"joints {sorted(moving)}", list(model.names[1:]))
    for joint, inertia in zip(model.names[1:], model.inertias[1:], strict=True):
        link = moving[joint].child
        _check_inertia(robot, link, inertia, bodies[link])
    return model


def _check_inertia(robot: Robot, link: str, read: pin.Inertia, body: Inertia) -> None:
    """Compare a moving body as Pinocchio has read it with the strict parse's, up to rounding."""
    size = max(1.0, float(np.abs(body.com).max()))
    slack = 1e-9 * np.abs(body.tensor).max() + MICROMETRE**2 * body.mass
    compared: list[tuple[str, str, Any, Any, float]] = [
        ("mass", "kg", body.mass, read.mass, max(1e-9 * body.mass, 1e-12)),
        ("inertia", "kg m^2", body.tensor, read.inertia, slack),
    ]
    if body.mass > 0:  # nothing has no centre
        compared.insert(1, ("centre of mass", "m", body.com, read.lever, 1e-9 * size))
    for what, unit, expected, got, tolerance in compared:
        if not np.abs(np.subtract(got, expected)).max() <= tolerance:
            texts = (" ".join(f"{x:g}" for x in np.ravel(values)) for values in (expected, got))
            raise UrdfError(
                robot.path,
                f'<link name="{link}">',
                f"{what} {next(texts)} {unit}, its fixed links included",
                f"{next(texts)} {unit} in Pinocchio",
            )
