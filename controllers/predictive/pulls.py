"""Pulls at the winches that make up for the friction of cables on their guides.

A controller answers with the inputs u that are to act on the arm. Friction changes the moment arms
a of a cable to a_f, by the direction in which the cable slides at each guide
(`softdyn.actuation.capstan`). The pull at the winch is r u, and

    r = (a_fᵀ S⁻¹ a) / (a_fᵀ S⁻¹ a_f)

minimises the error ‖a_f r u - a u‖ of its joint forces in the metric S⁻¹, where
S = M/H² + D/H + diag(k) at rest. An error is left, because a cable loses more at each guide.
Friction on the tension of a cable's own spring is not made up for.

The directions are those of the motion that u orders. One step of backward Euler with the joints'
springs, of the length `ORDERED`, gives the speeds q̇ that the model without friction reaches. With
them a cable slides at guide i by s_i = -∂L_i/∂q q̇. A dead band of the width w_i keeps small speeds
from switching the friction:

    d_i = s_i / √(s_i² + w_i²),    w_i = `REST` Σ_j |∂L_i/∂q_j|.

Controllers that estimate no disturbance gain most. Twice the true μ makes them chatter about rests
(`docs/rigs.md`).
"""

from __future__ import annotations

import numpy as np

from softdyn import SoftModel, State
from softdyn.actuation import Capstan
from softdyn.controllers.controller import KnownRig
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.dynamics.derivatives import total_damping
from softdyn.dynamics.projection import underlying_tree

HORIZON = 0.3  # H (s)
ORDERED = 0.02  # s
REST = 0.1  # rad/s, m/s; at this speed of all its joints a cable is at the edge of the dead band
LARGEST = 10.0  # r; beyond it friction leaves next to nothing to pull with


class FrictionPulls:
    """The pulls of a robot whose cables rub.

    Parameters
    ----------
    model : SoftModel
        The robot.
    friction : float or array_like, (tendons,), optional
        Coefficients that replace those of the file, see `softdyn.actuation.Capstan`.
    rig : KnownRig, optional
        The rig whose coefficients hold where none are given; by default the file's.

    Attributes
    ----------
    rubs : bool
        Whether any cable rubs.

    Raises
    ------
    InputError
        For coefficients that `Capstan` refuses.
    """

    def __init__(
        self,
        model: SoftModel,
        friction: np.ndarray | float | None = None,
        rig: KnownRig | None = None,
    ) -> None:
        smooth = friction is None and rig is not None and rig.friction is None
        if friction is None and rig is not None:
            friction = rig.friction
        self._model, self._capstan = model, Capstan(model, friction)
        self.rubs = len(self._capstan.tendon) > 0 and not smooth
        self._tendon = underlying_tree(model)[0].actuated
        self._springs = np.array(model.stiffness)
        self._compliance, self._shares = np.empty((0, 0)), np.ones(model.nu)
        if self.rubs:
            self._compliance = np.linalg.inv(stiffness_at_rest(model, HORIZON)[1])

    def __call__(
        self, u: np.ndarray, state: State, unmodelled: np.ndarray | None = None
    ) -> np.ndarray:
        """The pulls (nu,) for the inputs u (nu,), within the bounds and read-only.

        Parameters
        ----------
        u : ndarray, (nu,)
            Inputs that are to act.
        state : State
            The robot's state.
        unmodelled : ndarray, (n,), optional
            Joint forces that the model lacks.
        """
        model, capstan, v = self._model, self._capstan, state.v
        guides = capstan.at(state)
        D = total_damping(state)
        force = state.B @ u - state.h + D @ v
        if unmodelled is not None:
            force += unmodelled
        matrix = state.M + ORDERED * D
        matrix.flat[:: model.nv + 1] += ORDERED**2 * self._springs
        ordered = np.linalg.solve(matrix, state.M @ v + ORDERED * force)
        beyond = guides.arms_beyond
        slid, width = -beyond @ ordered, REST * np.abs(beyond).sum(axis=1)
        direction = slid / np.maximum(np.hypot(slid, width), 1e-150)
        own, sign = state.moment_arms, -np.sign(guides.pull(u))[capstan.tendon]
        rubbed = own + guides.friction_arms(direction, sign)
        weighed = rubbed @ self._compliance
        size, along = ((weighed * arms).sum(axis=1) for arms in (rubbed, own))
        shares = np.divide(along, size, out=np.ones(len(own)), where=size > 0)
        self._shares = np.clip(shares, 0.0, LARGEST)[self._tendon]
        pulls: np.ndarray = np.clip(u * self._shares, model.u_min, model.u_max)
        pulls.flags.writeable = False
        return pulls

    def inputs(self, pulls: np.ndarray) -> np.ndarray:
        """The inputs (nu,) that act under pulls (nu,), with the r of the last call."""
        r = self._shares
        return np.divide(pulls, r, out=np.array(pulls, float), where=r > 0)
