"""Servos of a user's scene: the commands that make the forces that a controller asks for.

MuJoCo's force of an actuator with gain G and bias b is

    f = G w + b₀ + b₁ l + b₂ l̇,

with l the length that it sees, and w its input, or its activation if it has dynamics. So
w = (f - b₀ - b₁ l - b₂ l̇) / G makes the force f. A filter's input is w, which it reaches with its
lag. An integrator's input leads from its activation to w in one control period. Afterwards the
servo regulates its own length or velocity until the next command.
"""

from __future__ import annotations

import mujoco
import numpy as np

DYNAMICS = (
    mujoco.mjtDyn.mjDYN_NONE,
    mujoco.mjtDyn.mjDYN_INTEGRATOR,
    mujoco.mjtDyn.mjDYN_FILTER,
    mujoco.mjtDyn.mjDYN_FILTEREXACT,
)
BIASES = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)


def obstacle(model: mujoco.MjModel, k: int) -> str:
    """The reason why no command of the k-th actuator makes a given force; empty if one does."""
    kinds = (
        ("gain", mujoco.mjtGain(model.actuator_gaintype[k]), (mujoco.mjtGain.mjGAIN_FIXED,)),
        ("bias", mujoco.mjtBias(model.actuator_biastype[k]), BIASES),
        ("dynamics", mujoco.mjtDyn(model.actuator_dyntype[k]), DYNAMICS),
    )
    for word, kind, known in kinds:
        if kind not in known:
            return f"{word} {kind.name.partition('_')[2].lower()}"
    if model.actuator_ctrlnum[k] != 1:
        return f"{model.actuator_ctrlnum[k]} inputs"
    group = int(model.actuator_group[k])
    if 0 <= group < 31 and int(model.opt.disableactuator) >> group & 1:
        return "its group disabled"
    return "" if model.actuator_gainprm[k, 0] else "gain 0"


def as_forces(model: mujoco.MjModel, actuators: np.ndarray) -> None:
    """Remove bias, dynamics, delay and clamp of actuators, whose inputs then are forces / gain."""
    model.actuator_biasprm[actuators] = 0.0
    model.actuator_dyntype[actuators] = mujoco.mjtDyn.mjDYN_NONE
    model.actuator_actadr[actuators] = -1
    model.actuator_actnum[actuators] = 0
    model.actuator_forcelimited[actuators] = 0
    model.actuator_history[actuators] = 0
    model.actuator_delay[actuators] = 0.0


class Servos:
    """The driven actuators of a scene whose force is not a multiple of their input.

    Parameters
    ----------
    model : mujoco.MjModel
        The scene.
    driven : np.ndarray
        Numbers of the actuators that an input drives, without `obstacle`.
    """

    def __init__(self, model: mujoco.MjModel, driven: np.ndarray) -> None:
        biased = model.actuator_biastype[driven] != mujoco.mjtBias.mjBIAS_NONE
        moving = model.actuator_dyntype[driven] != mujoco.mjtDyn.mjDYN_NONE
        self._model, self._ids = model, driven[biased | moving]
        self._ctrl = model.actuator_ctrladr[self._ids]
        self._out = model.actuator_outadr[self._ids]
        self._gain = model.actuator_gainprm[self._ids, 0]
        affine = model.actuator_biastype[self._ids] == mujoco.mjtBias.mjBIAS_AFFINE
        self._bias = np.where(affine[:, None], model.actuator_biasprm[self._ids, :3], 0.0).T
        self._act = model.actuator_actadr[self._ids]
        self._integrates = model.actuator_dyntype[self._ids] == mujoco.mjtDyn.mjDYN_INTEGRATOR

    def commands(self, data: mujoco.MjData, ctrl: np.ndarray, period: float) -> np.ndarray:
        """MuJoCo's inputs at the present state (MuJoCo's nu,).

        Parameters
        ----------
        data : mujoco.MjData
            The state. Its lengths and velocities are computed anew.
        ctrl : np.ndarray, (MuJoCo's nu,)
            Force / gain of each actuator, at its input.
        period : float
            Time (s) in which an integrator arrives.
        """
        if not len(self._ids):
            return ctrl
        found, asked = ctrl.copy(), self._asked(data, ctrl)
        act = data.act[self._act[self._integrates]]
        asked[self._integrates] = (asked[self._integrates] - act) / period
        found[self._ctrl] = asked
        return found

    def hold(self, data: mujoco.MjData, ctrl: np.ndarray) -> None:
        """Begin with these forces / gain, held for long: in activations and delays."""
        if not len(self._ids):
            return
        asked = self._asked(data, ctrl)
        data.ctrl[self._ctrl] = np.where(self._integrates, 0.0, asked)
        for k, value, act, turns in zip(self._ids, asked, self._act, self._integrates, strict=True):
            if act >= 0:
                low, high = self._model.actuator_actrange[k]
                limited = self._model.actuator_actlimited[k]
                data.act[act] = np.clip(value, low, high) if limited else value
            if samples := int(self._model.actuator_history[k, 0]):
                past = np.full((samples, 1), 0.0 if turns else value)
                mujoco.mj_initCtrlHistory(self._model, data, int(k), None, past)
        mujoco.mj_forward(self._model, data)

    def _asked(self, data: mujoco.MjData, ctrl: np.ndarray) -> np.ndarray:
        """The input or activation of each servo that makes its force at the present state."""
        mujoco.mj_fwdPosition(self._model, data)
        mujoco.mj_fwdVelocity(self._model, data)
        constant, by_length, by_velocity = self._bias
        lengths, velocities = data.actuator_length[self._out], data.actuator_velocity[self._out]
        bias = constant + by_length * lengths + by_velocity * velocities
        return ctrl[self._ctrl] - bias / self._gain
