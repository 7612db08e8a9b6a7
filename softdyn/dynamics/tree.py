"""TreeModel: Pinocchio's model of a tree with the robot's compliance and tendons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.checks import did_you_mean, read_only, vector
from softdyn.compiled import COMPILES
from softdyn.description.robot import Robot
from softdyn.dynamics import kernels
from softdyn.dynamics.areas import areas_of
from softdyn.dynamics.balls import BallSprings
from softdyn.dynamics.buoyancy import Buoyancy
from softdyn.dynamics.coordinates import Coordinates
from softdyn.dynamics.curves import curves_of
from softdyn.dynamics.engine import (
    BASE,
    ThreadScratch,
    build_engine,
    free_joint,
    joint_tree,
    moved_bodies,
)
from softdyn.dynamics.fluid import FluidDrag
from softdyn.dynamics.forces import (
    check_forces,
    copied_forces,
    energy_of,
    total_derivatives,
    total_energy,
    total_force,
)
from softdyn.dynamics.model import (
    SoftModel,
    State,
    StateBatch,
    check_batch,
    taut_gains,
    taut_slopes,
)
from softdyn.dynamics.points import BodyPoint
from softdyn.dynamics.tendons import TendonGeometry, compile_tendons
from softdyn.exceptions import InputError


class PassiveForces(NamedTuple):
    """Springs, dampers and elastic tendons at one state.

    Attributes
    ----------
    K, D : ndarray, (n,), (n, n)
        As those of a State.
    gain, damping : ndarray, (tendons,)
        Derivatives of each tendon's pull by its length and rate, zero for a slack one.
    tension : ndarray, (tendons,)
        The pull of each tendon by both (N).
    stiffness : ndarray, (n,)
        Derivative of each joint spring's force.
    by_v : ndarray, (n, n)
        ∂(D q̇)/∂q̇, which is D where the dampers are linear.
    """

    K: np.ndarray
    D: np.ndarray
    gain: np.ndarray
    damping: np.ndarray
    tension: np.ndarray
    stiffness: np.ndarray
    by_v: np.ndarray


class TreeModel(SoftModel):
    """The model of a robot without mimic joints.

    Parameters
    ----------
    robot : Robot
        The parsed description, without mimic joints. `softdyn.build` accepts mimic joints too.
    bundled : str, optional
        Name among the bundled robots, None for any other file.

    Attributes
    ----------
    engine : pinocchio.Model
        The engine's model of the same file. States and all other terms come from it, and from
        numbers that were copied from it, so that it must not change.
    pin_data : pinocchio.Data
        Its scratch memory in the calling thread.
    unforced : TreeModel
        The same model without forces of one's own; forces are called with it.
    gear : ndarray, (m,)
        Force of each input along its tendon for u = 1; at the stretch 1 if it changes.
    rotors : bool
        Whether a tendon has an armature.
    areas : Areas or None
        The gears where a chamber's area changes with its stretch.
    actuated : ndarray of int, (m,)
        The tendon of each input.

    Raises
    ------
    InputError
        For a robot with mimic joints, which are no degrees of freedom of their own.
    UrdfError
        If Pinocchio refuses the file or reads another robot than the strict parse.
    """

    def __init__(self, robot: Robot, bundled: str | None = None) -> None:
        if robot.followers:
            raise InputError("robot", "no mimic joint: see softdyn.build", robot.path)
        self.robot, self.bundled, self.name = robot, bundled, robot.name
        model = self.engine = build_engine(robot)
        self.nq, self.nv, self.nu = model.nq, model.nv, len(robot.actuators)
        base = BASE if robot.floating else ()
        self.joint_names = (*base, *model.names[1 + robot.floating :])
        self.q0 = read_only(pin.neutral(model))
        self.u_min = read_only([actuator.lower for actuator in robot.actuators])
        self.u_max = read_only([actuator.upper for actuator in robot.actuators])

        # The base's six degrees of freedom have no spring, damper, armature or limit, even if a
        # joint of the file has the name of one of them.
        joints = {joint.name: joint for joint in robot.joints}
        ordered = [free_joint(robot)] * len(base)
        ordered += [joints[name] for name in self.joint_names[len(base) :]]
        self.lower, self.upper, self.stiffness, self.rest, self.damping, self.armature = (
            read_only([getattr(joint, field) for joint in ordered])
            for field in ("lower", "upper", "stiffness", "rest", "damping", "armature")
        )
        self.joint_curves = curves_of(ordered)
        model.armature = self.armature.copy()
        self._scratch = ThreadScratch(model)

        bodies = joint_tree(model)[:, 0].tolist()
        first = [model.idx_qs[j] + k - model.idx_vs[j] for k, j in enumerate(bodies)]
        continuous = np.array([joint.kind == "continuous" for joint in ordered])
        self.chart = Coordinates(self.nq, np.array(first), continuous, robot.floating)
        self._turns = self.nq != self.nv  # some numbers of q are tied to each other
        self._frame = model.getFrameId(robot.task, pin.FrameType.BODY)
        moves = moved_bodies(model)
        index = {name: k for k, name in enumerate(self.joint_names)}
        self.tendons = compile_tendons(robot.tendons, index, self.anchor, moves)
        self.tendon_stiffness = read_only([tendon.stiffness for tendon in robot.tendons])
        self.tendon_damping = read_only([tendon.damping for tendon in robot.tendons])
        self.tendon_slack = np.array([tendon.slack for tendon in robot.tendons], bool)
        self.tendon_slack.flags.writeable = False
        at_zero = self.tendon_lengths(self.q0)
        self.tendon_rest = read_only(
            [
                length if tendon.rest is None else tendon.rest
                for tendon, length in zip(robot.tendons, at_zero, strict=True)
            ]
        )
        # B = Σ gear (∂ℓ/∂q)ᵀ over the actuators of each tendon
        self.gear = read_only([actuator.gear for actuator in robot.actuators])
        self.areas = areas_of(robot)
        self.actuated = np.array(
            [self.tendons.names.index(actuator.tendon) for actuator in robot.actuators], int
        )
        self._fixed_arms = read_only(self.tendons.coefficients)
        self._fixed_B = read_only((self.gear[:, None] * self._fixed_arms[self.actuated]).T)
        self._fixed_D = read_only(self._damping_matrix(self._fixed_arms, self.tendon_damping))
        self._pack(moves)
        self._points: dict[tuple[str | float, ...], BodyPoint] = {}
        self._take_forces()

    def _take_forces(self) -> None:
        """Let the robot's own forces act; they see this model without them."""
        self._assemble = self._by_kernel if COMPILES else self._in_numpy
        robot, self._forces = self.robot, check_forces(self.robot.forces)
        if robot.fluid:
            drag = FluidDrag(self.engine, robot.fluid, self.chart.floating)
            self._forces = (*self._forces, drag)
        if robot.buoyant:
            lifted = [
                (body, link.gravcomp * link.mass, place)
                for link in robot.buoyant
                for body, place in [self.anchor(link.name, link.origin.translation)]
                if body
            ]
            self._forces = (*self._forces, Buoyancy(self.engine, lifted))
        if robot.balls:
            self._forces = (*self._forces, BallSprings(robot, self.joint_names))
        free = replace(robot.dry, forces=()) if self._forces else robot
        self.unforced = self if free is self.robot else self._sharing(free)

    def _sharing(self, robot: Robot) -> TreeModel:
        """The model of this robot with other forces; it shares the engine and all numbers."""
        other = object.__new__(type(self))
        vars(other).update(vars(self), robot=robot)
        vars(other).pop("pin_model", None)  # a user's own copy
        other._take_forces()
        return other

    def _pack(self, moves: np.ndarray) -> None:
        """Pack the arguments of the State's kernel in as few arrays as possible."""
        model, tendons = self.engine, self.tendons
        tip, offset = self.anchor(self.robot.task, np.zeros(3))
        bodies, before = joint_tree(model).T.tolist()
        beyond = [model.idx_vs[j] + self.pin_data.nvSubtree[j] for j in bodies]
        constants = kernels.Constants(
            tip=tip,
            tip_offset=offset,
            tree=np.column_stack((moves[:, tip], bodies, before, beyond)).astype(int),
            gravity=model.gravity.linear.copy(),
            joints=np.column_stack((self.stiffness, self.rest, self.damping, self.armature)),
            tendons=np.column_stack(
                (
                    self.tendon_stiffness,
                    self.tendon_rest,
                    self.tendon_damping,
                    self.tendon_slack,
                )
            ),
            actuated=self.actuated,
            gear=self.gear.copy(),
        )
        self._constants: tuple[Any, ...] = tuple(constants)
        self._wraps = bool(tendons.wraps)
        if not self._wraps:
            self._constants += (tendons.offset, tendons.coefficients, *tendons.segments)
        # whether moment arms or B depend on q
        count, self._spatial = len(tendons.names), tendons.spatial or self.areas is not None
        self._joint_rows = self.nv + kernels.JOINT_TERMS + count + self.nu, self.nv
        self._tip_and_lengths = 6 + count
        self.rotors = bool(self.tendon_armature.any())
        self._curved = self.joint_curves is not None or self.tendon_curves is not None
        self._beyond_kernel = self._curved or self.rotors or self.areas is not None
        self._damped = tendons.spatial and bool(self.tendon_damping.any()) and not self._curved
        self._slackens = bool(self.tendon_slack.any()) and not self._curved

    # -- state ---------------------------------------------------------------------------------

    def _read(self, q: np.ndarray) -> np.ndarray:
        """A configuration as a new array (nq,), checked."""
        q = vector("q", q, self.nq)
        if self._turns:
            self.chart.check(q, self.joint_names)
        return q

    def state(self, q: np.ndarray, v: np.ndarray) -> State:
        """Every term of the dynamics at (q, v)."""
        q, v = vector("q", q, self.nq), vector("v", v, self.nv)
        if self._turns:
            self.chart.check(q, self.joint_names)
        scratch = self._scratch
        here = self.about_base(q) if self.chart.floating else q
        pin.nonLinearEffects(self.engine, scratch.data, here, v)
        scratch.latest = q
        return self._assemble(q, here, v, scratch)

    def states(self, Q: np.ndarray, V: np.ndarray) -> StateBatch:
        """The States of k configurations and velocities, equal to those of `state` to the bit."""
        own = self._beyond_kernel or bool(self._forces)
        if self.tendons.wraps or own or not COMPILES:
            return SoftModel.states(self, Q, V)
        Q, V = check_batch(self, Q, V)
        Q.flags.writeable = V.flags.writeable = True  # else Numba compiles the kernel once more
        k, scratch = len(Q), self._scratch
        model, data, args = self.engine, scratch.data, self._arguments(scratch)
        coordinates = Q
        if self._turns:
            for q in Q:
                self.chart.check(q, self.joint_names)
            coordinates = np.array([self.chart.of(q) for q in Q]).reshape(k, self.nv)
        here = Q
        if self.chart.floating:
            here = Q.copy()
            here[:, :3] = 0.0
        joint_rows, tips = np.empty((k, *self._joint_rows)), np.empty((k, self._tip_and_lengths))
        scratch.latest = None
        for q, v, at, rows, tip in zip(here, V, coordinates, joint_rows, tips, strict=True):
            pin.nonLinearEffects(model, data, q, v)
            pin.computeCentroidalMap(model, data, q)
            if not scratch.in_view:
                scratch.memory.copy_from(data)
            kernels.segments_and_state(rows, tip, v, at, *args)
        if self.chart.floating:
            tips[:, :3] += Q[:, :3]
        n, count, rows = self.nv, len(self.tendons.names), joint_rows.swapaxes(0, 1)
        M, J, Jdot = (joint_rows[:, a:b] for a, b in ((0, n), (n, n + 3), (n + 3, n + 6)))
        bias, K, h, g = rows[n + 6 : n + kernels.JOINT_TERMS]
        lengths, arms, B = tips[:, 6:], self._fixed_arms, self._fixed_B
        if self._spatial:
            first = n + kernels.JOINT_TERMS
            arms = joint_rows[:, first : first + count]
            B = joint_rows[:, first + count :].swapaxes(1, 2)
        arms, B = (np.broadcast_to(one, (k, *one.shape[-2:])) for one in (arms, B))
        D = np.broadcast_to(self._fixed_D, (k, n, n))
        if self._slackens or self._damped:
            damping = self.tendon_damping
            D = np.empty((k, n, n))
            for i in range(k):  # one by one, for the order of the additions
                if self._slackens:
                    damping = taut_gains(self, lengths[i], arms[i] @ V[i])[1]
                D[i] = self._damping_matrix(arms[i], damping)
        terms = {
            "q": Q, "v": V, "M": M, "bias": bias, "K": K, "D": D, "B": B, "h": h, "g": g, "J": J,
            "Jdot": Jdot, "y": tips[:, :3], "ydot": tips[:, 3:6], "lengths": lengths,
            "moment_arms": arms,
        }  # fmt: skip
        for value in terms.values():
            value.flags.writeable = False
        return StateBatch(self, terms)

    def _arguments(self, scratch: ThreadScratch) -> tuple[Any, ...]:
        """The kernel's arguments after the coordinates: views of the scratch, and constants."""
        if not scratch.arguments:
            scratch.arguments = (*scratch.memory, *self._constants)
        return scratch.arguments

    def _by_kernel(
        self, q: np.ndarray, here: np.ndarray, v: np.ndarray, scratch: ThreadScratch
    ) -> State:
        """The rest of a State by a kernel, from Pinocchio's results in its memory."""
        pin.computeCentroidalMap(self.engine, scratch.data, here)
        if not scratch.in_view:
            scratch.memory.copy_from(scratch.data)
        joint_rows, tip_and_lengths = np.empty(self._joint_rows), np.empty(self._tip_and_lengths)
        coordinates = q if self.nq == self.nv else self.chart.of(q)
        arguments = scratch.arguments or self._arguments(scratch)
        if self._wraps:  # there is no kernel for courses around round bodies
            geometry = self._geometry(coordinates)
            kernels.tip_terms(tip_and_lengths)[2][:] = geometry.lengths
            kernels.tendon_terms(joint_rows, len(geometry.lengths))[0][:] = geometry.moment_arms
            kernels.state_terms(joint_rows, tip_and_lengths, v, coordinates, *arguments)
        else:
            kernels.segments_and_state(joint_rows, tip_and_lengths, v, coordinates, *arguments)
        if here is not q:
            tip_and_lengths[:3] += q[:3]
        arms, B, D, F = self._fixed_arms, self._fixed_B, self._fixed_D, None
        if self._beyond_kernel:
            if self.rotors:
                self._turn_rotors(joint_rows, v)
            if self._curved:
                D = read_only(self._bend_springs(joint_rows, tip_and_lengths, coordinates, v))
        if self._forces:
            F = self.forces_at(q, v)
            kernels.joint_terms(joint_rows)[5][:] -= F
        for filled in (q, v, joint_rows, tip_and_lengths):
            filled.flags.writeable = False
        M, J, Jdot, bias, K, h, g = kernels.joint_terms(joint_rows)
        y, ydot, lengths = kernels.tip_terms(tip_and_lengths)
        if self._spatial:
            arms, inputs = kernels.tendon_terms(joint_rows, len(lengths))
            B = inputs.T
            if self.areas is not None:  # the kernel knows constant gears alone
                B = self._input_matrix(arms, lengths)
                B.flags.writeable = False
        if self._slackens:
            D = read_only(self._damping_matrix(arms, taut_gains(self, lengths, arms @ v)[1]))
        elif self._damped:
            D = read_only(self._damping_matrix(arms, self.tendon_damping))
        state = State.trusted(
            model=self, q=q, v=v, M=M, bias=bias, K=K, D=D, B=B, h=h, g=g, J=J, Jdot=Jdot,
            y=y, ydot=ydot, lengths=lengths, moment_arms=arms,
        )  # fmt: skip
        if F is not None:
            vars(state)["F"] = F
        return state

    def _turn_rotors(self, joint_rows: np.ndarray, v: np.ndarray) -> None:
        """Add the tendons' armatures to M, the bias and h, since the kernel knows none."""
        M, _, _, bias, _, h, _ = kernels.joint_terms(joint_rows)
        arms = self._fixed_arms
        if self._spatial:
            arms, _ = kernels.tendon_terms(joint_rows, len(self.tendons.names))
        more, drift = self.rotor_terms(arms, v)
        M += more
        bias += drift
        h += drift

    def _bend_springs(
        self,
        joint_rows: np.ndarray,
        tip_and_lengths: np.ndarray,
        coordinates: np.ndarray,
        v: np.ndarray,
    ) -> np.ndarray:
        """Write K and h anew, since the kernel knows linear springs and dampers alone; return D."""
        _, _, _, bias, K, h, _ = kernels.joint_terms(joint_rows)
        lengths, arms = kernels.tip_terms(tip_and_lengths)[2], self._fixed_arms
        if self._spatial:
            arms, _ = kernels.tendon_terms(joint_rows, len(lengths))
        K[:], D, *_ = self.passive_forces(coordinates, lengths, arms, v)
        h[:] = bias + D @ v + K
        return D

    def _in_numpy(
        self, q: np.ndarray, here: np.ndarray, v: np.ndarray, scratch: ThreadScratch
    ) -> State:
        """The same through Pinocchio's accessors and NumPy, without compiled kernels."""
        model, data = self.engine, scratch.data
        M = pin.crba(model, data, here, pin.Convention.WORLD).reshape(self.nv, self.nv)
        pin.computeJointJacobiansTimeVariation(model, data, here, v)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J, Jdot = (
            np.reshape(get(model, data, self._frame, axes), (6, self.nv))[:3]
            for get in (pin.getFrameJacobian, pin.getFrameJacobianTimeVariation)
        )
        y = pin.updateFramePlacement(model, data, self._frame).translation
        if here is not q:
            y = y + q[:3]
        coordinates = self.chart.of(q)
        geometry, arms, B = self._geometry(coordinates), self._fixed_arms, self._fixed_B
        lengths = geometry.lengths
        if self._spatial:
            arms = geometry.moment_arms
            B = self._input_matrix(arms, lengths)
        K, D, *_ = self.passive_forces(coordinates, lengths, arms, v)
        bias = data.nle
        if self.rotors:
            more, drift = self.rotor_terms(arms, v)
            M, bias = M + more, bias + drift
        terms = {
            "q": q, "v": v, "M": M, "bias": bias, "K": K, "D": D, "h": bias + D @ v + K,
            "J": J, "Jdot": Jdot, "y": y, "ydot": J @ v, "lengths": lengths, "moment_arms": arms,
        }  # fmt: skip
        kept = {name: read_only(np.ascontiguousarray(value)) for name, value in terms.items()}
        if self._forces:
            kept["F"] = self.forces_at(q, v)
            kept["h"] = read_only(kept["h"] - kept["F"])
        B.flags.writeable = False  # no copy: B keeps its memory order
        return State.trusted(model=self, B=B, **kept)

    def coriolis(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Coriolis matrix C (n, n) with Ṁ - 2C skew-symmetric."""
        q, v = self._read(q), vector("v", v, self.nv)
        C = pin.computeCoriolisMatrix(self.engine, self.pin_data, self.about_base(q), v)
        C = np.reshape(C, (self.nv, self.nv))
        if self.rotors:
            momenta = self.tendon_armature[:, None] * self.tendon_geometry(q).moment_arms
            C = C + momenta.T @ self.tendons.arm_rates(v, *self.last_kinematics())[0]
        return read_only(C)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Gravity force g (n,), the gradient of `gravity_energy`."""
        q = self.about_base(self._read(q))
        momenta = pin.computeCentroidalMap(self.engine, self.pin_data, q)
        linear = np.reshape(momenta, (6, self.nv))[:3]
        return read_only(-self.engine.gravity.linear @ linear)

    # -- dynamics ------------------------------------------------------------------------------

    def forward_dynamics(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Acceleration q̈ (n,) under the input u (m,), by the articulated-body algorithm.

        The armature of a tendon couples joints, which that algorithm does not know. With one, the
        linear system M q̈ = B u - h is solved.
        """
        u = vector("u", u, self.nu)
        if self.rotors:
            state = self.state(q, v)
            return np.linalg.solve(state.M, state.B @ u - state.h)
        if self._spatial:  # the State's kernel has lengths and arms in a fifth of the time
            state = self.state(q, v)
            q, v, B, K, D = state.q, state.v, state.B, state.K, state.D
        else:
            q, v, B = self._read(q), vector("v", v, self.nv), self._fixed_B
            at = self.chart.of(q)
            K, D, *_ = self.passive_forces(at, self._geometry(at).lengths, self._fixed_arms, v)
        tau = B @ u - D @ v - K
        if self._forces:
            tau += self.forces_at(q, v)
        return np.array(pin.aba(self.engine, self.pin_data, self.about_base(q), v, tau))

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """½ q̇ᵀ M q̇ (J), armature included."""
        q, v = self.about_base(self._read(q)), vector("v", v, self.nv)
        M = np.reshape(pin.crba(self.engine, self.pin_data, q), (self.nv, self.nv))
        energy = float(v @ M @ v)
        if self.rotors:
            rates = self.tendon_geometry(q).moment_arms @ v
            energy += float(self.tendon_armature @ rates**2)
        return energy / 2

    def gravity_energy(self, q: np.ndarray) -> float:
        """Potential energy of gravity (J), zero at the world's origin."""
        q = self._read(q)
        here = self.about_base(q)
        energy = float(pin.computePotentialEnergy(self.engine, self.pin_data, here))
        if here is not q:
            weight = pin.computeTotalMass(self.engine) * self.engine.gravity.linear
            energy -= float(weight @ q[:3])
        return energy

    def elastic_energy(self, q: np.ndarray) -> float:
        """Energy of joint springs and elastic tendons (J)."""
        q = self._read(q)
        stretch = self.chart.of(q) - self.rest
        lengths = self.tendon_lengths(q)
        gain, _ = taut_gains(self, lengths, np.zeros(len(lengths)))
        gain = np.where(self.tendon_slack, gain, self.tendon_stiffness)  # the linear part
        longer = lengths - self.tendon_rest
        energy = float(self.stiffness @ stretch**2 + gain @ longer**2) / 2
        for curves, s in ((self.joint_curves, stretch), (self.tendon_curves, longer)):
            if curves is not None:
                energy += curves.energy(s)
        return energy

    # -- forces of one's own -------------------------------------------------------------------

    def with_forces(self, *forces: Any) -> TreeModel:
        """A new model of the robot, on which further forces act; it shares the engine."""
        both = check_forces((*self.forces, *copied_forces(forces)))
        return self._sharing(replace(self.robot, forces=both))

    def forces_at(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """F (n,), the sum of one's own forces (N m, N), as in `State.F`."""
        q, v = self._read(q), vector("v", v, self.nv)
        return read_only(total_force(self._forces, self.unforced, q, v))

    def force_derivatives(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n) of one's own forces."""
        q, v = self._read(q), vector("v", v, self.nv)
        return total_derivatives(self._forces, self.unforced, q, v)

    @property
    def conserves(self) -> bool:
        """Whether each force of one's own has a potential."""
        energies = (energy_of(force, self.unforced, self.q0) for force in self._forces)
        return all(energy is not None for energy in energies)

    def forces_energy(self, q: np.ndarray) -> float:
        """Energy of those forces of one's own that have a potential (J)."""
        return total_energy(self._forces, self.unforced, self._read(q))

    # -- tendons -------------------------------------------------------------------------------

    def tendon_lengths(self, q: np.ndarray) -> np.ndarray:
        """Lengths (tendons,) of all tendons, in the file's order."""
        return self.tendon_geometry(self._read(q)).lengths

    def tendon_moment_arms(self, q: np.ndarray) -> np.ndarray:
        """Moment arms ∂ℓ/∂q (tendons, n)."""
        return np.array(self.tendon_geometry(self._read(q)).moment_arms)

    def tendon_hessians(self, q: np.ndarray) -> np.ndarray:
        """Gradients of the moment arms ∂²ℓ/∂q² (tendons, n, n)."""
        return self.tendon_geometry(self._read(q)).hessians()

    def tendon_geometry(self, q: np.ndarray) -> TendonGeometry:
        """The tendons at q (nq,), on views of the engine: use it before another configuration."""
        return self.tendons.at(self.chart.of(q), *self.kinematics(q))

    def _geometry(self, coordinates: np.ndarray) -> TendonGeometry:
        """The tendons in the engine's last kinematics."""
        return self.tendons.at(coordinates, *self.last_kinematics())

    def rotor_terms(self, arms: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The parts of the tendons' armatures in M (n, n) and in C q̇ (n,).

        Parameters
        ----------
        arms : ndarray, (tendons, n)
            The moment arms in the engine's last kinematics.
        v : ndarray, (n,)
            Velocity.
        """
        scaled = np.sqrt(self.tendon_armature)[:, None] * arms
        M: np.ndarray = scaled.T @ scaled  # symmetric to the bit
        if not self._spatial:
            return M, np.zeros(self.nv)
        rates, _ = self.tendons.arm_rates(v, *self.last_kinematics())
        return M, (self.tendon_armature * (rates @ v)) @ arms

    # -- configurations ------------------------------------------------------------------------

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Joint coordinates (n,): the numbers of q, but an angle in (-π, π] if continuous."""
        return self.chart.of(np.asarray(q, float))

    def configuration(self, coordinates: np.ndarray) -> np.ndarray:
        """Configuration q (nq,) of joint coordinates (n,): the inverse of `coordinates`."""
        return self.chart.configuration(vector("coordinates", coordinates, self.nv))

    def link_poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Pose (4, 4) in the world of every link."""
        model, data = self.engine, self.pin_data
        pin.framesForwardKinematics(model, data, self._read(q))
        return {
            link.name: data.oMf[model.getFrameId(link.name, pin.FrameType.BODY)].homogeneous
            for link in self.robot.links
        }

    def link_jacobian(self, q: np.ndarray, link: str) -> np.ndarray:
        """Jacobian (6, n) of a link's frame, in the world's axes at the frame's origin."""
        motion = self.link_point(link).at(*self.kinematics_of(self._read(q)))
        return np.vstack((motion.J, motion.turning))

    def link_point(self, link: str, xyz: Sequence[float] = (0.0, 0.0, 0.0)) -> BodyPoint:
        """A point of a link, its origin by default, for evaluation with the `kinematics`.

        Raises
        ------
        InputError
            For a link that the robot does not have.
        """
        if (link, *xyz) not in self._points:
            names = [one.name for one in self.robot.links]
            if link not in names:
                raise InputError("link", f"one of {', '.join(names)}", did_you_mean(link, names))
            point = BodyPoint(self.engine, *self.anchor(link, np.array(xyz)))
            self._points[link, *xyz] = point
        return self._points[link, *xyz]

    def kinematics_of(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The `kinematics`; nothing is computed for the numbers of the last State or call."""
        scratch = self._scratch
        if scratch.latest is None or not np.array_equal(scratch.latest, q):
            pin.computeJointJacobians(self.engine, scratch.data, self.about_base(q))
            scratch.latest = np.array(q)
        return self.last_kinematics()

    def integrate(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """q ⊕ dv (nq,): the configuration after the displacement dv (n,)."""
        q, dv = self._read(q), vector("dv", dv, self.nv)
        return np.array(pin.integrate(self.engine, q, dv))

    # -- the engine ----------------------------------------------------------------------------

    @cached_property
    def pin_model(self) -> pin.Model:
        """A copy of the engine's model, for a user's own algorithms; no change to it is felt."""
        return self.engine.copy()

    @property
    def pin_data(self) -> pin.Data:
        """Pinocchio's scratch memory in the calling thread; its user may overwrite it."""
        self._scratch.latest = None
        return self._scratch.data

    def about_base(self, q: np.ndarray) -> np.ndarray:
        """q (nq,) with a floating base moved to the world's origin, for all work in the engine.

        The base's place changes positions only, but a distant base costs digits: Jacobian columns
        about an origin 1000 km away lose eight.
        """
        if not self.chart.floating:
            return q
        here = np.array(q, float)
        here[:3] = 0.0
        return here

    def placements(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (bodies, 3, 3), translations (bodies, 3) of the engine's last kinematics.

        Their origin is that of a floating base, if there is one: see `about_base`.
        """
        memory = self._scratch.results()
        return memory.rotations, memory.translations

    def kinematics(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Joint Jacobian columns, as rows (n, 6), and the `placements`, all views of the engine.

        For the q of the last State nothing is computed.
        """
        if self._scratch.latest is not q:
            pin.computeJointJacobians(self.engine, self.pin_data, self.about_base(q))
        return self.last_kinematics()

    def last_kinematics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The `kinematics` of the engine's last algorithm, which had the joints' Jacobians."""
        memory = self._scratch.results()
        return memory.S, memory.rotations, memory.translations

    def anchor(self, link: str, xyz: np.ndarray) -> tuple[int, np.ndarray]:
        """The moving body that carries a point of a link, and the point in the body's frame."""
        model = self.engine
        frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
        return frame.parentJoint, frame.placement.act(np.array(xyz))

    def gears_at(self, lengths: np.ndarray) -> np.ndarray:
        """Force (m,) of each input along its tendon for u = 1, at tendon lengths (tendons,)."""
        return self.gear if self.areas is None else self.areas.gears(lengths)

    def _input_matrix(self, arms: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        return (self.gears_at(lengths)[:, None] * arms[self.actuated]).T

    def _damping_matrix(self, arms: np.ndarray, tendon_damping: np.ndarray) -> np.ndarray:
        return np.diag(self.damping) + arms.T @ (tendon_damping[:, None] * arms)

    def passive_forces(
        self, coordinates: np.ndarray, lengths: np.ndarray, arms: np.ndarray, v: np.ndarray
    ) -> PassiveForces:
        """Springs, dampers and elastic tendons, for a State and for `ForceBalance`.

        Parameters
        ----------
        coordinates, v : ndarray, (n,)
            Joint coordinates and velocities.
        lengths, arms : ndarray, (tendons,), (tendons, n)
            The tendons' lengths and moment arms there.
        """
        gain, damping, D = self.tendon_stiffness, self.tendon_damping, self._fixed_D
        stretch = coordinates - self.rest
        K = self.stiffness * stretch
        if not self.stretches and not self._curved:
            return PassiveForces(K, D, gain, damping, gain, self.stiffness, D)
        rates = arms @ v
        if self._slackens or self._curved:
            gain, damping = taut_gains(self, lengths, rates)
        if self._slackens or self._curved or self.tendons.spatial:
            D = self._damping_matrix(arms, damping)
        pull = gain * (lengths - self.tendon_rest)
        K, tension = K + arms.T @ pull, pull + damping * rates
        if not self._curved:
            return PassiveForces(K, D, gain, damping, tension, self.stiffness, D)
        gain, damping = taut_slopes(self, lengths, rates)
        by_v, stiffness = self._damping_matrix(arms, damping), self.stiffness
        if self.joint_curves is not None:
            more, resisting = self.joint_curves.secants(stretch, v)
            K += more * stretch
            D.flat[:: self.nv + 1] += resisting
            more, resisting = self.joint_curves.tangents(stretch, v)
            stiffness = stiffness + more
            by_v.flat[:: self.nv + 1] += resisting
        return PassiveForces(K, D, gain, damping, tension, stiffness, by_v)


def tree_of(model: SoftModel) -> TreeModel:
    """Return `model` as a `TreeModel`, for code that needs the engine.

    Raises
    ------
    InputError
        For a robot with mimic joints or a reduced one, because its model is a projection.
    """
    if not isinstance(model, TreeModel):
        raise InputError("model", "a robot without mimic joints, not reduced", model.name)
    return model
