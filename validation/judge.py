"""MuJoCo's own answer to each term of the dynamics, in the model's order of joints.

Each answer comes from MuJoCo's pipeline alone: forces of unit velocities and unit inputs give D and
B column by column, the parts of its passive forces give K and D, `mj_jacDot` gives J̇.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from validation.twin import INTEGRATORS, StateMap, Twin, check_warnings, disabled


class Judge:
    """A twin stripped to its smooth dynamics: no limits, contacts, friction or input clamp.

    Parameters
    ----------
    twin : where the MuJoCo model comes from; it is copied.
    states : the convention map from the model's states to the twin's.

    Attributes
    ----------
    nu, mass : number of actuators, mass of all moving bodies (kg).
    """

    def __init__(self, twin: Twin, states: StateMap) -> None:
        self.states = states
        self._model = copy.copy(twin.model)
        self._site = twin.task_site
        self._data = mujoco.MjData(self._model)
        off = disabled(limits=False, contacts=False, friction=False)
        off |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        self._model.opt.disableflags = off
        self._model.opt.enableflags = int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        self.nv, self.nu = self._model.nv, self._model.nu
        self.mass = float(self._model.body_mass[1:].sum())

    # -- at one state --------------------------------------------------------------------------

    def place(self, q: np.ndarray, v: np.ndarray) -> None:
        """Go to the model's state q (nq,), v (nv,)."""
        self._qpos, self._qvel = self.states.to_twin(q, v)
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._qpos
        mujoco.mj_fwdPosition(self._model, self._data)
        self._velocity(self._qvel)

    def _velocity(self, qvel: np.ndarray) -> None:
        self._data.qvel[:] = qvel
        mujoco.mj_fwdVelocity(self._model, self._data)

    def tip(self) -> np.ndarray:
        """Task frame in the world (3,), m."""
        return self._data.site_xpos[self._site].copy()

    def J(self) -> np.ndarray:
        """Linear Jacobian of the tip (3, nv)."""
        jacobian = np.zeros((3, self.nv))
        mujoco.mj_jacSite(self._model, self._data, jacobian, None, self._site)
        return jacobian[:, self.states.dofs]

    def Jdot(self) -> np.ndarray:
        """Time derivative (3, nv) of J."""
        jacobian = np.zeros((3, self.nv))
        body = self._model.site_bodyid[self._site]
        point = self._data.site_xpos[self._site]
        mujoco.mj_jacDot(self._model, self._data, jacobian, None, point, body)
        return jacobian[:, self.states.dofs]

    def M(self) -> np.ndarray:
        """Mass matrix (nv, nv)."""
        matrix = np.zeros((self.nv, self.nv))
        mujoco.mj_fullM(self._model, self._data, matrix)
        return matrix[np.ix_(self.states.dofs, self.states.dofs)]

    def bias(self) -> np.ndarray:
        """C q̇ + g (nv,)."""
        return self._data.qfrc_bias[self.states.dofs]

    def g(self) -> np.ndarray:
        """Gravity force (nv,): the bias at rest."""
        self._velocity(np.zeros(self.nv))
        gravity = self.bias()
        self._velocity(self._qvel)
        return gravity

    def K(self) -> np.ndarray:
        """Spring forces (nv,) of joints and tendons, on the left-hand side."""
        return -self._data.qfrc_spring[self.states.dofs]

    def D(self) -> np.ndarray:
        """Damping matrix (nv, nv): minus the damper forces of unit velocities."""
        matrix = np.zeros((self.nv, self.nv))
        for k, dof in enumerate(self.states.dofs):
            unit = np.zeros(self.nv)
            unit[dof] = 1.0
            self._velocity(unit)
            matrix[:, k] = -self._data.qfrc_damper[self.states.dofs]
        self._velocity(self._qvel)
        return matrix

    def B(self) -> np.ndarray:
        """Input matrix (nv, nu): the generalized forces of unit inputs."""
        matrix = np.zeros((self.nv, self.nu))
        for k in range(self.nu):
            self._data.ctrl[:] = np.eye(self.nu)[k]
            mujoco.mj_fwdActuation(self._model, self._data)
            matrix[:, k] = self._data.qfrc_actuator[self.states.dofs]
        self._data.ctrl[:] = 0.0
        return matrix

    def lengths(self) -> np.ndarray:
        """Tendon lengths (tendons,)."""
        return self._data.ten_length.copy()

    def qdd(self, u: np.ndarray) -> np.ndarray:
        """Acceleration (nv,) under the input u (nu,)."""
        self._data.ctrl[:] = u
        mujoco.mj_forward(self._model, self._data)
        check_warnings(self._data)
        return self._data.qacc[self.states.dofs]

    def energy(self) -> float:
        """Kinetic and potential energy with that of all springs (J)."""
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        return float(self._data.energy.sum())

    # -- along time ----------------------------------------------------------------------------

    def start(self, q: np.ndarray, v: np.ndarray, integrator: str, step: float) -> None:
        """Prepare to `follow` a trajectory from the model's state with a scheme and a step (s)."""
        self._model.opt.integrator = INTEGRATORS[integrator]
        self._model.opt.timestep = step
        self.place(q, v)

    def follow(
        self, inputs: Sequence[np.ndarray], holds: Sequence[int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Integrate each input (nu,) for its number of steps.

        Yields
        ------
        Coordinates (nv,), angles not wrapped, and velocities (nv,) after each hold, in the model's
        order.

        Raises
        ------
        SimulationError
            The state blew up.
        """
        dofs = self.states.dofs
        for u, steps in zip(inputs, holds, strict=True):
            self._data.ctrl[:] = u
            mujoco.mj_step(self._model, self._data, steps)
            check_warnings(self._data)
            yield self._data.qpos[dofs], self._data.qvel[dofs]
