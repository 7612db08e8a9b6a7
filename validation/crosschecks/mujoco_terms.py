"""Every term of the dynamics as MuJoCo computes it, in the model's order of joints.

The terms come from MuJoCo's pipeline alone. Forces under unit velocities and unit inputs give D and
B column by column. The parts of its passive forces give K and D, and `mj_jacDot` gives J̇.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence

import mujoco
import numpy as np

from softdyn.validation.mjcf.scene import Scene
from softdyn.validation.mjcf.servos import as_forces
from softdyn.validation.twin.chamber_areas import ChamberAreas
from softdyn.validation.twin.free_base import rk4_on_rotations
from softdyn.validation.twin.integrators import Integrator
from softdyn.validation.twin.memory import MotionMemory
from softdyn.validation.twin.own_forces import OwnForces
from softdyn.validation.twin.rotors import coupling_tendons, mass_matrix
from softdyn.validation.twin.settings import disabled
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin, check_warnings

FLAGS = mujoco.mjtDisableBit
SWITCHED_OFF = int(FLAGS.mjDSBL_GRAVITY | FLAGS.mjDSBL_SPRING | FLAGS.mjDSBL_DAMPER)


class MujocoTerms:
    """A twin stripped to its smooth dynamics: no limits, contacts, friction, input clamp or servos.

    Parameters
    ----------
    twin : Twin or Scene
        The source of the MuJoCo model, which is copied. Joints that only a scene has stand still,
        and actuators that no input drives do nothing.
    states : StateMap
        The convention map from the model's states to the twin's.
    drives : bool
        Whether servos and lags stay, which are else replaced by forces.

    Attributes
    ----------
    nu, nv : int
        Numbers of actuators and of degrees of freedom.
    shared : np.ndarray, (tendons,)
        Whether the twin has each tendon of the model; a scene may have motors on joints instead.
    steps_itself : bool
        Whether MuJoCo cannot compute q̈: for a robot with followers, and for a tendon whose
        armature couples branches (`softdyn.validation.twin.rotors`).
    mass : float
        Mass of all moving bodies (kg).
    """

    def __init__(self, twin: Twin | Scene, states: StateMap, *, drives: bool = False) -> None:
        self.states = states
        self._model = copy.copy(twin.model)
        self._body, self._point = twin.task
        self._inputs, self.shared = twin.inputs, twin.tendons >= 0
        self._tendons = twin.tendons[self.shared]
        self._slack = twin.slack
        driven = twin.inputs[self._model.actuator_ctrladr].any(axis=1)
        idle = np.setdiff1d(np.flatnonzero(~driven), self._slack)
        self._model.actuator_gainprm[idle] = self._model.actuator_biasprm[idle] = 0.0
        if not drives:
            as_forces(self._model, np.flatnonzero(driven))
        self._data = mujoco.MjData(self._model)
        # a file may switch off gravity, springs or dampers; these stay off
        off = disabled(limits=False, contacts=False, friction=False)
        off |= int(self._model.opt.disableflags) & SWITCHED_OFF
        off |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        self._model.opt.disableflags = off
        self._model.opt.enableflags = int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        self.nv, self.nu = len(states.dofs), self._inputs.shape[1]
        self.steps_itself = self.nv < self._model.nv or bool(coupling_tendons(self._model))
        paths = bool((self._model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE).any())
        self._damping_varies = paths and bool(self._model.tendon_damping.any())
        self.mass = float(self._model.body_mass[1:].sum())
        self._areas: ChamberAreas | None = None
        if isinstance(twin, Twin) and twin.areas is not None:
            self._areas = ChamberAreas(twin.robot, self._model)
        self._own: OwnForces | None = None  # given ones, which MuJoCo does not judge
        if twin.robot.forces or twin.robot.balls or self._areas is not None:
            rested = MotionMemory(self._model, twin.robot)
            self._own = OwnForces(
                twin.robot,
                self._model,
                self._data,
                states,
                twin.rest,
                rested,
                self._areas,
                central=True,
            )

    # -- at one state --------------------------------------------------------------------------

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Go to the model's state q (nq,), v (nv,)."""
        qpos, self._qvel = self.states.to_twin(q, v)
        self._v = np.array(v, float)
        self._map = self.states.velocity_map(qpos)
        self._rate = self.states.velocity_map_rate(qpos, self._qvel)
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = qpos
        if self._areas is not None:
            self._areas.update(self._data)
        mujoco.mj_fwdPosition(self._model, self._data)
        self._velocity(self._qvel)
        if self._own is not None:
            self._own.update()

    def _velocity(self, qvel: np.ndarray) -> None:
        self._data.qvel[:] = qvel
        mujoco.mj_fwdVelocity(self._model, self._data)

    def tip(self) -> np.ndarray:
        """Task frame in the world (3,), m."""
        turned = self._data.xmat[self._body].reshape(3, 3) @ self._point
        return self._data.xpos[self._body] + turned

    def J(self) -> np.ndarray:
        """Linear Jacobian of the tip (3, nv)."""
        return self._J() @ self._map

    def _J(self) -> np.ndarray:
        jacobian = np.zeros((3, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian, None, self.tip(), self._body)
        return jacobian

    def Jdot(self) -> np.ndarray:
        """Time derivative (3, nv) of J."""
        jacobian = np.zeros((3, self._model.nv))
        mujoco.mj_jacDot(self._model, self._data, jacobian, None, self.tip(), self._body)
        return jacobian @ self._map + self._J() @ self._rate

    def M(self) -> np.ndarray:
        """Mass matrix (nv, nv)."""
        return self._map.T @ self._M() @ self._map

    def _M(self) -> np.ndarray:
        return mass_matrix(self._model, self._data)

    def bias(self) -> np.ndarray:
        """C q̇ + g (nv,), with M times the twin's accelerations at constant v."""
        return self._map.T @ self._data.qfrc_bias + self._turning()

    def g(self) -> np.ndarray:
        """Gravity force (nv,): the bias at rest."""
        self._velocity(np.zeros(self._model.nv))
        gravity = self._map.T @ self._data.qfrc_bias
        self._velocity(self._qvel)
        return gravity

    def F(self) -> np.ndarray:
        """Forces of a fluid, of buoyancy and of ball joints (nv,)."""
        found = self._data.qfrc_fluid + self._data.qfrc_gravcomp
        if self._own is not None:
            found += self._own.of_balls(self._data.qpos, self._qvel)
        moved: np.ndarray = self._map.T @ found
        return moved

    def K(self) -> np.ndarray:
        """Spring forces (nv,) of joints and tendons, on the left-hand side."""
        springs = -self._map.T @ self._data.qfrc_spring
        if len(self._slack):
            arms, tension, rate, damping = self._taut()
            springs += self._map.T @ (arms.T @ (tension - damping * rate))
        return springs

    def _taut(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Moment arms, tension, ℓ̇ and damping of the slack tendons that are taut now."""
        model, data = self._model, self._data
        data.ctrl[:] = 0.0
        mujoco.mj_fwdActuation(model, data)
        taut = self._slack[data.actuator_force[self._slack] > 0]
        tendons = model.actuator_trnid[taut, 0]
        damping = -model.actuator_biasprm[taut, 2]
        return (
            -self._moments()[taut],
            data.actuator_force[taut],
            data.ten_velocity[tendons],
            damping,
        )

    def D(self) -> np.ndarray:
        """Damping matrix (nv, nv): minus the damper forces of unit velocities.

        Dampers that are not linear have the damping there that they have at the present rates.
        """
        model, data, kept = self._model, self._data, []
        for linear, poly, rate in (
            (model.dof_damping, model.dof_dampingpoly, data.qvel),
            (model.tendon_damping, model.tendon_dampingpoly, data.ten_velocity),
        ):
            kept += [(linear, linear.copy()), (poly, poly.copy())]
            linear += (poly[:, 0] + poly[:, 1] * np.abs(rate)) * np.abs(rate)
            poly[:] = 0.0
        damping = self._damping_along(self._map)
        for values, before in kept:
            values[:] = before
        if len(self._slack):
            arms, _, _, each = self._taut()
            arms = arms @ self._map
            damping += arms.T @ (each[:, None] * arms)
        return damping

    def _damping_along(self, columns: np.ndarray) -> np.ndarray:
        """Pᵀ D P (nv, nv) of velocities qvel = P v at the present position; P (MuJoCo's nv, nv)."""
        before, forces = self._data.qvel.copy(), []
        for column in columns.T:
            self._velocity(column)
            forces.append(-self._data.qfrc_damper)
        self._velocity(before)
        return columns.T @ np.array(forces).T

    def _damping_of_actuators(self, columns: np.ndarray) -> np.ndarray:
        """Pᵀ D P (nv, nv) of the actuators that damp and are within their bounds, after forward."""
        model, force = self._model, self._data.actuator_force
        low, high = model.actuator_forcerange.T
        acts = (model.actuator_biasprm[:, 2] != 0) & (force > low) & (force < high)
        arms = self._moments()[acts] @ columns
        damping: np.ndarray = arms.T @ (-model.actuator_biasprm[acts, 2:3] * arms)
        return damping

    def _moments(self) -> np.ndarray:
        """Moment arms (MuJoCo's nu, MuJoCo's nv) of the actuators."""
        model, data = self._model, self._data
        arms = np.zeros((model.nactuator, model.nv))
        mujoco.mju_sparse2dense(
            arms, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        return arms

    def B(self) -> np.ndarray:
        """Input matrix (nv, nu): the generalized forces of unit inputs."""
        matrix = np.zeros((self.nv, self.nu))
        self._data.ctrl[:] = 0.0
        mujoco.mj_fwdActuation(self._model, self._data)
        slack = self._data.qfrc_actuator.copy()
        for k in range(self.nu):
            self._data.ctrl[:] = self._inputs[:, k]
            mujoco.mj_fwdActuation(self._model, self._data)
            matrix[:, k] = self._map.T @ (self._data.qfrc_actuator - slack)
        self._data.ctrl[:] = 0.0
        return matrix

    def lengths(self) -> np.ndarray:
        """Lengths of the `shared` tendons."""
        return self._data.ten_length[self._tendons]

    def qdd(self, u: np.ndarray) -> np.ndarray:
        """Acceleration (nv,) under the input u (nu,).

        It is MuJoCo's own. If the twin `steps_itself`, it is solved from MuJoCo's projected forces
        and mass matrix.
        """
        self._data.ctrl[:] = self._inputs @ u
        mujoco.mj_forward(self._model, self._data)
        check_warnings(self._data)
        return self._accelerations()

    def _accelerations(self) -> np.ndarray:
        """q̈ (nv,) of MuJoCo's last forward computation."""
        if not self.steps_itself:
            return self._map.T @ (self._data.qacc - self._rate @ self._v)
        return np.linalg.solve(self.M(), self._map.T @ self._data.qfrc_smooth - self._turning())

    def _turning(self) -> np.ndarray:
        """Pᵀ M Ṗ v (nv,)."""
        return self._map.T @ (self._M() @ (self._rate @ self._v))

    def energy(self) -> float:
        """Kinetic and potential energy with that of all springs (J)."""
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        if self.steps_itself:  # by the whole M
            self._data.energy[1] = self._data.qvel @ self._M() @ self._data.qvel / 2
        constant, slope = self._model.actuator_biasprm[self._slack, :2].T
        lengths = self._data.ten_length[self._model.actuator_trnid[self._slack, 0]]
        pulls = np.maximum(constant - slope * lengths, 0.0)
        slack = float(np.sum(pulls**2 / np.where(slope < 0, -slope, 1.0))) / 2
        return float(self._data.energy.sum()) + slack

    # -- along time ----------------------------------------------------------------------------

    def start(self, q: np.ndarray, v: np.ndarray, integrator: str, step: float) -> None:
        """Prepare to `follow` a trajectory from the model's state with a scheme and a step (s)."""
        self._model.opt.integrator = Integrator(integrator).mujoco
        self._model.opt.timestep = step
        if self._own is not None:
            self._own.scheme = self._model.opt.integrator
        self._damping: np.ndarray | None = None
        self._step = self._tied_rk4 if integrator == "rk4" else self._tied_implicit
        self.set_state(q, v)

    def follow(
        self, inputs: Iterable[np.ndarray], holds: Sequence[int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Integrate each input (nu,) for its number of steps.

        MuJoCo integrates, unless the twin `steps_itself`. Then the robot is integrated here by the
        same schemes, with MuJoCo's forces, mass matrix and update of positions.

        Yields
        ------
        Coordinates (nv,), angles not wrapped, and velocities (nv,) after each hold, in the model's
        conventions.

        Raises
        ------
        SimulationError
            The state blew up.
        """
        data = self._data
        for u, steps in zip(inputs, holds, strict=True):
            data.ctrl[:] = self._inputs @ u
            if self.steps_itself:
                for _ in range(steps):
                    self._step(self._model.opt.timestep)
            elif self._own is not None:
                for _ in range(steps):
                    self._own.step()
            else:
                mujoco.mj_step(self._model, data, steps)
            check_warnings(data)
            yield self.states.coordinates(data.qpos), self.states.from_twin(data.qpos, data.qvel)[1]

    # Velocities of a robot with followers: w = v, except for a floating base, where w is MuJoCo's
    # velocity in the world's axes: qvel = E w with E constant, so that qacc = E ẇ and M̃ = Eᵀ M E,
    # f̃ = Eᵀ f.

    def _tied_forces(self, qpos: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mass matrix (nv, nv) and all forces (nv,) of a robot with followers."""
        data, E = self._data, self.states.ties
        data.qpos[:], data.qvel[:] = qpos, E @ w
        if self._own is not None:
            self._own.update()
        mujoco.mj_forward(self._model, data)
        check_warnings(data)
        return E.T @ self._M() @ E, E.T @ data.qfrc_smooth

    def _moved(self, qpos: np.ndarray, w: np.ndarray, h: float) -> np.ndarray:
        moved = qpos.copy()
        mujoco.mj_integratePos(self._model, moved, self.states.ties @ w, h)
        return moved

    def _tied_rk4(self, h: float) -> None:
        self._arrive(
            *rk4_on_rotations(
                self._data.qpos.copy(),
                self.states.signs * self._data.qvel[self.states.dofs],
                h,
                lambda qpos, w: np.linalg.solve(*self._tied_forces(qpos, w)),
                lambda qpos, moved: self._moved(qpos, moved, 1.0),
                slice(3, 6) if self.states.floating else slice(0),
            )
        )

    def _tied_implicit(self, h: float) -> None:
        qpos, w = self._data.qpos.copy(), self.states.signs * self._data.qvel[self.states.dofs]
        M, force = self._tied_forces(qpos, w)
        if self._damping is None or self._damping_varies:
            self._damping = self._damping_along(self.states.ties)
        damping = self._damping + self._damping_of_actuators(self.states.ties)
        if self._own is not None:
            damping = damping - self.states.ties.T @ self._own.rate_slopes() @ self.states.ties
        w = w + h * np.linalg.solve(M + h * damping, force)
        if self._model.na or self._model.actuator_delay.any():
            mujoco.mj_step(self._model, self._data)  # its activations, delays and clock
        self._arrive(self._moved(qpos, w, h), w)

    def _arrive(self, qpos: np.ndarray, w: np.ndarray) -> None:
        self._data.qpos[:], self._data.qvel[:] = qpos, self.states.ties @ w
