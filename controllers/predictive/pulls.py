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
(`docs/your_rig.md`).
"""

from __future__ import annotations

import numpy as np

from softdyn import SoftModel, State
from softdyn.actuation import Capstan
from softdyn.compiled import compiled
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.controllers.qps.linear_algebra import dot, solve_rows
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

    Attributes
    ----------
    rubs : bool
        Whether any cable rubs.

    Raises
    ------
    InputError
        For coefficients that `Capstan` refuses.
    """

    def __init__(self, model: SoftModel, friction: np.ndarray | float | None = None) -> None:
        self._model, self._capstan = model, Capstan(model, friction)
        self.rubs = len(self._capstan.tendon) > 0
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
        force = state.B @ u - state.h + state.D @ v
        if unmodelled is not None:
            force += unmodelled
        shares = _shares(
            capstan.tendon, capstan.friction * guides.angles, guides.arms,
            _ordered(state.M, state.D, self._springs, force, v), -np.sign(guides.pull(u)),
            state.moment_arms, self._compliance, REST,
        )  # fmt: skip
        self._shares = shares[self._tendon]
        pulls: np.ndarray = np.clip(u * self._shares, model.u_min, model.u_max)
        pulls.flags.writeable = False
        return pulls

    def inputs(self, pulls: np.ndarray) -> np.ndarray:
        """The inputs (nu,) that act under pulls (nu,), with the r of the last call."""
        r = self._shares
        return np.divide(pulls, r, out=np.array(pulls, float), where=r > 0)


@compiled
def _ordered(M, D, springs, force, v):
    """The speeds (n,) after one step of backward Euler."""
    n = len(v)
    system = np.empty((n, n + 1))
    for i in range(n):
        momentum = 0.0
        for j in range(n):
            system[i, j] = M[i, j] + ORDERED * D[i, j]
            momentum += M[i, j] * v[j]
        system[i, i] += ORDERED * ORDERED * springs[i]
        system[i, n] = momentum + ORDERED * force[i]
    solve_rows(system)
    return system[:, n].copy()


@compiled
def _shares(tendon, turns, arms, speeds, sign, own, compliance, rest):
    """r (tendons,) of cables with μφ and moment arms (guides, n) of the pieces behind the guides.

    The tendons have `own` moment arms and tensions of a `sign`.
    """
    guides, n = arms.shape
    direction, beyond = np.empty(guides), np.zeros(n)
    for g in range(guides - 1, -1, -1):
        if g < guides - 1 and tendon[g] != tendon[g + 1]:
            beyond[:] = 0.0
        slid, width = 0.0, 1e-150  # not squared to zero
        for j in range(n):
            beyond[j] += arms[g, j]
            slid -= beyond[j] * speeds[j]
            width += rest * abs(beyond[j])
        direction[g] = slid / np.sqrt(slid * slid + width * width)
    rubbed, lost = own.copy(), 0.0
    for g in range(guides):
        t = tendon[g]
        lost = direction[g] * turns[g] + (lost if g > 0 and tendon[g - 1] == t else 0.0)
        change = np.expm1(-sign[t] * lost)
        for j in range(n):
            rubbed[t, j] += change * arms[g, j]
    shares, weighed = np.ones(len(own)), np.empty(n)
    for t in range(len(own)):
        for j in range(n):
            weighed[j] = dot(compliance[j], rubbed[t])
        size = dot(weighed, rubbed[t])
        if size > 0.0:
            shares[t] = min(max(dot(weighed, own[t]) / size, 0.0), LARGEST)
    return shares
