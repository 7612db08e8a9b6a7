"""Forces of a user's own in the twin, and the springs of ball joints on hinges.

MuJoCo has no such force. The twin calls the same object as the model does, with the model of its
own robot, so that the force is given and not checked. Springs of ball joints are its own: see
`softdyn.validation.twin.balls`. At each step it takes F and ∂F/∂q̇ into
MuJoCo's own linear system. MuJoCo's implicit schemes solve

    A a = f,    A = M - h ∂f/∂q̇,

for the acceleration a of the step, with all forces f and the slopes of MuJoCo's own. The force adds
F to f, and h ∂F/∂q̇ a: then (A - h ∂F/∂q̇) a = f, the linearly implicit step, of order 1. An
explicit drag of 0.1 N m s on the finger would explode, because h λmax(M⁻¹ D) is 10 and more. With
Runge-Kutta F is evaluated at each of the four stages.

The stiffness -∂F/∂q = K is explicit. A mode of mass m and damping d is stable if
h² k < 4 m + 2 h d. So the largest eigenvalue of h² (4 M + 2 h D)⁻¹ K has to be below 1, and
M + h D positive definite, where D has the damping of everything. Runge-Kutta needs h λ < 2.78.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from softdyn.dynamics.forces import STEP
from softdyn.dynamics.mimic import build
from softdyn.exceptions import InputError
from softdyn.validation.twin.balls import TwinBalls
from softdyn.validation.twin.free_base import rk4_on_rotations
from softdyn.validation.twin.integrators import Integrator

if TYPE_CHECKING:
    from softdyn.description.robot import Robot
    from softdyn.validation.twin.chamber_areas import ChamberAreas
    from softdyn.validation.twin.memory import MotionMemory
    from softdyn.validation.twin.state_map import StateMap

RK4_REACH = 2.78  # h λ of a decay; of an oscillation 2.82
CHECKED = 0.05  # s between two checks of the step
HALVINGS = 20  # of a step that is too long; a shorter one is no answer


class OwnForces:
    """The forces of a user's own on a MuJoCo model, and its ball joints.

    Parameters
    ----------
    robot : Robot
        The description, with the forces.
    model, data : mujoco.MjModel, mujoco.MjData
        Its MuJoCo model, and the state that moves.
    states : StateMap
        The map from the model's states to MuJoCo's.
    rest : np.ndarray, (MuJoCo's nq,)
        qpos at q = 0.
    memory : MotionMemory
        The torques of branches and hysteresis.
    areas : ChamberAreas, optional
        Areas of chambers, which change with the forces.
    central : bool
        Whether ∂F/∂q̇ of a force without `derivatives` has central differences, as the model's own
        steps have. By default they are one-sided, which takes half the calls. The step has order 1
        with both, and their difference, about 1e-6 of the slope, is no more than one of damping.

    Attributes
    ----------
    scheme : int
        MuJoCo's integrator.

    Raises
    ------
    InputError
        Runge-Kutta with motors that have a state of their own.
    """

    def __init__(
        self, robot: Robot, model: mujoco.MjModel, data: mujoco.MjData, states: StateMap,
        rest: np.ndarray, memory: MotionMemory, areas: ChamberAreas | None = None,
        *, central: bool = False,
    ) -> None:  # fmt: skip
        self._memory, self._areas, self._central = memory, areas, central
        self._model, self._data, self._states = model, data, states
        # MuJoCo itself has the fluid
        self._scratch, self._robot = mujoco.MjData(model), build(robot.dry)
        self._balls = TwinBalls(robot.balls, model, rest)
        self._ball_names = [ball.name for ball in robot.balls]
        self.scheme = model.opt.integrator
        self.forget()
        self._slopes = all(hasattr(force, "derivatives") for force in robot.forces)
        if self.staged and (model.na or model.actuator_delay.any()):
            what = "relaxation" if memory else "areas that change"
            what = "forces of one's own" if robot.forces else what
            expected = f"implicitfast with {what} and motors that lag"
            raise InputError("integrator", expected, "rk4")

    @property
    def staged(self) -> bool:
        """Whether a step has four stages, which move the torques of the branches too."""
        return bool(self.scheme == Integrator.RK4.mujoco)

    def forget(self) -> None:
        """The next `check_step` checks."""
        self._checked = np.inf

    def update(self) -> None:
        """Let F of the present state act."""
        if self._areas is not None:
            self._areas.update(self._data)
        self._data.qfrc_applied[:] = self._applied(self._data.qpos, self._data.qvel)

    def _applied(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """F (MuJoCo's nv,); that of followers acts on their leaders."""
        found = self.of_balls(qpos, qvel)
        if self._robot.forces:
            force = self._robot.forces_at(*self._states.from_twin(qpos, qvel))
            found += self._turned(qpos) @ force
        return found + self._memory.force() if self._memory else found

    def of_balls(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """The force of the ball joints alone (MuJoCo's nv,)."""
        return self._balls.force(qpos, qvel)

    def _turned(self, qpos: np.ndarray) -> np.ndarray:
        """P (MuJoCo's nv, nv) without the rows of followers: it maps forces to MuJoCo's."""
        found, dofs = np.zeros_like(self._states.ties), self._states.dofs
        found[dofs] = self._states.velocity_map(qpos)[dofs]
        return found

    def rate_slopes(self) -> np.ndarray:
        """∂F/∂q̇ (MuJoCo's nv, MuJoCo's nv) at the present state."""
        data = self._data
        damping = self._balls.damping()
        if not self._robot.forces:
            return -damping
        q, v = self._states.from_twin(data.qpos, data.qvel)
        if self._slopes:
            _, by_v = self._robot.force_derivatives(q, v)
        else:
            moves, width = STEP * np.eye(len(v)), 2 * STEP if self._central else STEP
            here = None if self._central else self._robot.forces_at(q, v)
            by_v = np.empty((len(v), len(v)))
            for k, move in enumerate(moves):
                behind = self._robot.forces_at(q, v - move) if here is None else here
                by_v[:, k] = (self._robot.forces_at(q, v + move) - behind) / width
        P = self._turned(data.qpos)
        found: np.ndarray = P @ by_v @ P.T - damping
        return found

    def step(self) -> None:
        """One step of the present state under the controls in `data`, as ``mj_step``."""
        model, data = self._model, self._data
        mujoco.mj_checkPos(model, data)
        mujoco.mj_checkVel(model, data)
        if data.warning.number.any():  # a state at which no force can be asked for
            return
        if self.staged:
            self._fourth_order()
            return
        self.update()
        mujoco.mj_forward(model, data)
        mujoco.mj_checkAcc(model, data)
        A, slopes = self._matrix(), self.rate_slopes()
        force = data.qfrc_smooth + data.qfrc_constraint
        h = model.opt.timestep
        a = np.linalg.solve(A - h * slopes, force)
        data.qfrc_smooth[:] += h * slopes @ a
        data.qacc[:] = a  # Euler's scheme without any damping takes it
        self._integrate(data)

    def _integrate(self, data: mujoco.MjData) -> None:
        euler = self.scheme == Integrator.EULER.mujoco
        (mujoco.mj_Euler if euler else mujoco.mj_implicit)(self._model, data)

    def _matrix(self) -> np.ndarray:
        """A (MuJoCo's nv, MuJoCo's nv), after ``mj_forward``."""
        model, data, scratch, n = self._model, self._data, self._scratch, self._model.nv
        found = np.zeros((n, n))
        mujoco.mj_fullM(model, data, found)
        h = model.opt.timestep
        if self.scheme == Integrator.EULER.mujoco:
            return found + h * np.diag(model.dof_damping)
        mujoco.mj_copyData(scratch, model, data)
        mujoco.mj_implicit(model, scratch)  # it leaves its ∂f/∂q̇ behind
        slopes = np.zeros((n, n))
        mujoco.mju_sparse2dense(
            slopes, scratch.qDeriv, model.D_rownnz, model.D_rowadr, model.D_colind
        )
        return found - h * slopes

    def _fourth_order(self) -> None:
        model, data, memory, n = self._model, self._data, self._memory, self._model.nv

        def slope(qpos: np.ndarray, rates: np.ndarray) -> np.ndarray:
            data.qpos[:], data.qvel[:], memory.torque[:] = qpos, rates[:n], rates[n:]
            mujoco.mj_checkPos(model, data)
            mujoco.mj_checkVel(model, data)
            if data.warning.number.any():
                return np.zeros(len(rates))
            self.update()
            mujoco.mj_forward(model, data)
            mujoco.mj_checkAcc(model, data)
            return np.append(data.qacc, memory.rate(data.qvel, memory.torque))

        def move(qpos: np.ndarray, moved: np.ndarray) -> np.ndarray:
            there = qpos.copy()
            mujoco.mj_integratePos(model, there, moved[:n], 1.0)
            return there

        h = model.opt.timestep
        start = data.qpos.copy(), np.append(data.qvel, memory.torque)
        turning = slice(3, 6) if self._states.floating else slice(0)
        data.qpos[:], rates = rk4_on_rotations(*start, h, slope, move, turning)
        data.qvel[:], memory.torque[:] = rates[:n], rates[n:]
        data.time += h

    def check_step(self) -> None:
        """Refuse a force that is too stiff for the step, at the begin and every 50 ms.

        Raises
        ------
        InputError
            The error names the step that would do.
        """
        model, data = self._model, self._data
        if 0.0 <= data.time - self._checked < CHECKED or not self._names:
            return
        self._checked = float(data.time)
        self.update()
        mujoco.mj_forward(model, data)
        h = model.opt.timestep
        M = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, M)
        K, D, is_stable = self._balls.stiffness(), -self.rate_slopes(), _follows_explicitly
        if self._robot.forces:
            by_q, _ = self._robot.force_derivatives(*self._states.from_twin(data.qpos, data.qvel))
            P = self._turned(data.qpos)
            K -= P @ by_q @ P.T
        if self.scheme != Integrator.RK4.mujoco:
            D, is_stable = D + (self._matrix() - M) / h, _follows_implicitly
        if is_stable(M, D, K, h):
            return
        for k in range(1, HALVINGS):
            if is_stable(M, D, K, h / 2**k):
                expected = f"at most {h / 2**k:.3g} s with {self._names}, which is that stiff here"
                raise InputError("timestep", expected, f"{h:g} s")
        raise InputError("forces", "forces that some step can follow", self._names)

    @property
    def _names(self) -> str:
        names = [force.name for force in self._robot.forces] + self._ball_names
        return ", ".join(map(repr, names))


def _follows_implicitly(M: np.ndarray, D: np.ndarray, K: np.ndarray, h: float) -> bool:
    """Whether the linearly implicit step follows forces of this damping and stiffness."""
    implicit = M + h * (D + D.T) / 2
    if np.linalg.eigvalsh(implicit)[0] <= 0:
        return False
    modes = np.linalg.eigvals(np.linalg.solve(2 * M + 2 * implicit, h * h * K))
    return bool(modes.real.max(initial=0.0) < 1.0)


def _follows_explicitly(M: np.ndarray, D: np.ndarray, K: np.ndarray, h: float) -> bool:
    """Whether a step of Runge-Kutta follows forces of this damping and stiffness alone."""
    rates, squares = (np.linalg.eigvals(np.linalg.solve(M, part)) for part in (D, K))
    fastest = max(np.abs(rates).max(initial=0.0), np.sqrt(np.abs(squares).max(initial=0.0)))
    return bool(h * fastest < RK4_REACH)
