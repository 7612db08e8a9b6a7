"""Gains of the paper's controllers for any robot, from its model linearised at equilibria.

Near an equilibrium (q*, u*) with its tip at the target the robot is

    M δq̈ + D δq̇ + K_t δq = B δu,    K_t = ∂(K + g - B u*)/∂q,

and soft ID-CLF-QP away from its bounds is linear: it minimises

    w1 ‖J (q̈ + K_d δq̇ + K_p δq)‖² + w2 ‖q̈‖² + w3 ‖u* + δu‖² + w4 ‖N (q̈ + d δq̇)‖²

subject to the actuated rows U (M q̈ + D δq̇ + K_t δq) = U B δu; the rows of U span range(B). Over a
horizon τ, M + τ D + τ² K' replaces M in these rows, and D + τ K' replaces D; K' = ∂K/∂q. (The
Lyapunov function is quadratic in the error, so its row has no part of first order.) The input is
held for a control period. So each K_p gives a matrix of the closed loop, whose spectral radius is
the slowest decay, and a distance at which the tip comes to rest, because w3 ‖u‖² pulls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh, expm

from softdyn import InputError, SoftModel, statics
from softdyn.checks import number
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.qps.linear_algebra import RANK_TOLERANCE
from softdyn.dynamics.derivatives import total_damping
from softdyn.formats import KEY, TOML
from softdyn.statics import Equilibrium

PLACES = 4  # equilibria besides the rest
UNSTABLE = -0.1  # 1/s: a decay below it is no rounding of a mode that the controller leaves alone
SHARE = 0.6  # √K_p over the lowest natural frequency of the robot: faster gains throw slow modes
SAMPLED = 0.1  # largest √K_p times the control period
PULLED = 2e-3  # of the robot's length: how far ‖u‖² may pull the tip from its target
ACCELERATION = 0.1  # weight of ‖q̈‖² over the largest ‖J‖²
SINGULAR = 1e-2  # directions in which the tip moves by less, over the largest, do not count
SLACK = 2.3e4  # ρ L² / ε²; the weights of the paper's finger are near these three


@dataclass(frozen=True)
class ProposedGains:
    """Gains that `propose` found; `toml` is a file for ``softdyn run --gains``.

    Attributes
    ----------
    gains : Gains
        The gains.
    period : float
        The control period for which they are (s).
    slowest : float
        The lowest natural frequency of the robot at the equilibria (rad/s).
    offset : float
        Predicted distance of the tip from its target at rest, at the worst equilibrium (m).
    decay : float
        Slowest decay of the linearised closed loop (1/s), at the worst equilibrium; negative if it
        is unstable.
    acceleration : float
        The acceleration (m/s²) that the inputs can still give the tip in every direction in which
        they move it, at the worst equilibrium.
    places : int
        Number of equilibria.
    """

    gains: Gains
    period: float
    slowest: float
    offset: float
    decay: float
    acceleration: float
    places: int

    @property
    def reason(self) -> str:
        """One line that says why."""
        rate, g = math.sqrt(self.gains.Kp), self.gains
        limit = (
            f"{SHARE:g} times the lowest natural frequency of {self.slowest:.3g} rad/s"
            if rate * self.period < 0.999 * SAMPLED
            else f"{SAMPLED:g} over the control period of {self.period:g} s"
        )
        stable = "stable" if self.decay > 0 else "UNSTABLE"
        return (
            f"sqrt(Kp) = {rate:.3g} 1/s is {limit}; at {self.places} equilibria the loop is "
            f"{stable}, rests within {1e3 * self.offset:.2g} mm of its target, and the inputs can "
            f"give the tip {self.acceleration:.2g} m/s2, which Kp = {g.Kp:.3g} asks for at "
            f"{1e3 * self.acceleration / g.Kp:.2g} mm"
        )

    def toml(self) -> str:
        """The gains as TOML, the reason as its comment."""
        lines = [f"{name} = {value:.4g}" for name, value in vars(self.gains).items()]
        return "\n".join([f"# {self.reason}", f'{KEY} = "{TOML}"', *lines])

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        return vars(self) | {"gains": vars(self.gains), "reason": self.reason}


def propose(model: SoftModel, period: float = 0.002) -> ProposedGains:
    """Gains for soft ID-CLF-QP, from the robot at rest and at a few equilibria.

    √K_p is a share of the lowest natural frequency, and ε = 1 / √K_p. The weights follow from the
    robot's size and inputs, so that robots that are scaled copies get scaled gains: w2 from ‖J‖²;
    w3 from the input that holds the equilibria; ρ from the length.

    Parameters
    ----------
    model : SoftModel
    period : float
        Control period (s).

    Raises
    ------
    InputError
        For a robot without inputs, whose inputs do not move the tip, or that rests on its stops.
    StaticsError
        If the robot has no equilibrium.
    """
    period = number("period", period, above=0.0)
    resolve(model, {}, Gains(1.0))  # it may refuse the robot
    found = [statics.rest(model), *statics.spread_rests(model, PLACES)]
    places = [_Place.of(one, period) for one in found if not one.held.all()]
    if not places:
        raise InputError("robot", f"an equilibrium of {model.robot.path} off its stops", "none")
    # a robot without stiffness has none; then only the period bounds the gains
    slowest = min((x for place in places if (x := place.frequency) > 0), default=math.inf)
    rate = min(SHARE * slowest, SAMPLED / period)
    size = float(np.median([np.linalg.norm(place.J, 2) ** 2 for place in places]))
    pull = max(place.pull for place in places)
    length = max(model.robot.length, math.sqrt(size))
    w2 = ACCELERATION * size
    gains = Gains(
        Kp=rate**2, eps=1 / rate, w2=w2, w3=PULLED * length * rate**2 / pull if pull > 0 else 0.2,
        w4=w2 / 2, rho=SLACK / (rate * length) ** 2, null_damping=2 * rate,
    )  # fmt: skip
    closed = [place.closed(gains, period) for place in places]
    return ProposedGains(
        gains, period, slowest, offset=max(offset for _, offset in closed),
        decay=min(decay for decay, _ in closed),
        acceleration=min(place.room(model.u_min, model.u_max) for place in places),
        places=len(places),
    )  # fmt: skip


def advice(one: Equilibrium, gains: Gains, period: float, horizon: float = 0.0) -> str:
    """A line about gains for a target that was missed, from the equilibrium nearest to it.

    Parameters
    ----------
    one : Equilibrium
        An equilibrium with its tip near the target.
    gains : Gains
        Those of soft ID-CLF-QP.
    period : float
        Control period (s).
    horizon : float
        Its τ (s).
    """
    place = _Place.of(one, period)
    decay, offset = place.closed(gains, period)
    over = place.over(horizon).closed(gains, period)
    if over[0] < UNSTABLE <= decay or over[1] > 2 * max(offset, PULLED * one.model.robot.length):
        fault = (
            f"makes the loop unstable, by {-over[0]:.2g} 1/s" if over[0] < UNSTABLE
            else f"lets w3 pull the tip {1e3 * over[1]:.2g} mm from its target"
        )  # fmt: skip
        return f"the horizon of {1e3 * horizon:.3g} ms {fault}: horizon = 0"
    decay, offset = over
    rate, most = math.sqrt(gains.Kp), SHARE * place.frequency
    if rate * period > SAMPLED:
        return f"Kp = {gains.Kp:g} is too large for a period of {period:g} s"
    if offset > 2 * PULLED * one.model.robot.length:
        return (
            f"w3 = {gains.w3:g} pulls the tip {1e3 * offset:.2g} mm from its target: a smaller w3 "
            "or a larger Kp"
        )
    if rate > most > 0:
        return f"Kp = {gains.Kp:g} may be too large for slow modes: at most {most**2:.2g}"
    if decay < 0:
        return "the loop is unstable at this target: a smaller w2 and w3, or a shorter period"
    return "these gains hold the tip there; the way may be at fault: a target nearer by, or best"


@dataclass(frozen=True, eq=False)
class _Place:
    """The robot linearised at an equilibrium, on its free joints.

    `step` is the exact motion of (δq, δq̇) over a period, and `push` that by an input that is held.
    `neutral` counts the directions without stiffness. M and D are the controller's, the robot's own
    or those over a horizon; K' is `springs`.
    """

    M: np.ndarray
    D: np.ndarray
    stiffness: np.ndarray
    B: np.ndarray
    J: np.ndarray
    u: np.ndarray
    step: np.ndarray
    push: np.ndarray
    neutral: int
    springs: np.ndarray

    @classmethod
    def of(cls, one: Equilibrium, period: float) -> _Place:
        free = np.flatnonzero(~one.held)
        block, state, n = np.ix_(free, free), one.state, len(free)
        M, D, stiffness = state.M[block], total_damping(state)[block], one.stiffness[block]
        B = state.B[free]
        m = B.shape[1]
        A = np.zeros((2 * n + m, 2 * n + m))
        A[:n, n : 2 * n] = np.eye(n)
        A[n : 2 * n] = np.linalg.solve(M, np.hstack([-stiffness, -D, B]))
        motion = expm(A * period)[: 2 * n]
        return cls(
            M, D, stiffness, B, state.J[:, free], one.u, motion[:, : 2 * n], motion[:, 2 * n :],
            one.loose.shape[1], one.model.tangent_stiffness(one.q)[block],
        )  # fmt: skip

    def over(self, horizon: float) -> _Place:
        """With the dynamics over a horizon τ (s), for `closed`; see `qps.horizon`."""
        M = self.M + horizon * self.D + horizon**2 * self.springs
        return replace(self, M=M, D=self.D + horizon * self.springs)

    @property
    def frequency(self) -> float:
        """The lowest natural frequency (rad/s); a direction without stiffness has none."""
        squares = eigh(self.stiffness, self.M, eigvals_only=True)
        firm = squares[np.argsort(np.abs(squares))[self.neutral :]]
        return math.sqrt(max(firm.min(), 0.0)) if firm.size else 0.0

    @property
    def pull(self) -> float:
        """The distance of the tip at rest by w3 alone, over w3 / K_p, from w3 Bᵀ⁺ u* = K_p Jᵀ e."""
        towards = self.M @ np.linalg.pinv(self.B.T, rcond=RANK_TOLERANCE) @ self.u
        return float(np.linalg.norm(np.linalg.pinv(self.J.T, rcond=SINGULAR) @ towards))

    def room(self, lower: np.ndarray, upper: np.ndarray) -> float:
        """The least acceleration of the tip (m/s²) in a direction that the inputs move."""
        mobility = self.J @ np.linalg.solve(self.M, self.B)
        directions, values, _ = np.linalg.svd(mobility, full_matrices=False)
        along = directions[:, values > SINGULAR * values[0]].T @ mobility
        ways = np.vstack([along, -along])
        most = np.maximum(ways * (lower - self.u), ways * (upper - self.u)).sum(axis=1)
        return float(most.min(initial=math.inf))

    def feedback(self, gains: Gains) -> tuple[np.ndarray, np.ndarray]:
        """δu = G (δq, δq̇) + c of the controller without bounds: G (m, 2n), c (m,)."""
        n, m = self.B.shape
        left, values, _ = np.linalg.svd(self.B, full_matrices=False)
        U = left[:, values > RANK_TOLERANCE * values[0]].T
        N = np.eye(n) - np.linalg.pinv(self.J, rcond=RANK_TOLERANCE) @ self.J
        H = np.zeros((n + m, n + m))
        H[:n, :n] = gains.w1 * self.J.T @ self.J + gains.w2 * np.eye(n) + gains.w4 * N
        H[n:, n:] = gains.w3 * np.eye(m)
        right = np.zeros((n + m, 2 * n + 1))
        right[:n, :n] = -gains.w1 * gains.Kp * self.J.T @ self.J
        right[:n, n:-1] = (
            -gains.w1 * gains.Kd * self.J.T @ self.J - gains.w4 * gains.null_damping * N
        )
        right[n:, -1] = -gains.w3 * self.u
        rows = np.hstack([U @ self.M, -U @ self.B])
        forces = np.hstack([-U @ self.stiffness, -U @ self.D, np.zeros((len(U), 1))])
        zero = np.zeros((len(U), len(U)))
        solution = np.linalg.solve(
            np.block([[H, rows.T], [rows, zero]]), np.vstack([right, forces])
        )[n : n + m]
        return solution[:, :-1], solution[:, -1]

    def closed(self, gains: Gains, period: float) -> tuple[float, float]:
        """The slowest decay (1/s), negative if unstable, and the tip's distance at rest (m)."""
        G, c = self.feedback(gains)
        A = self.step + self.push @ G
        radius = float(np.abs(np.linalg.eigvals(A)).max())
        rest = np.linalg.solve(np.eye(len(A)) - A, self.push @ c)
        return -math.log(radius) / period, float(np.linalg.norm(self.J @ rest[: len(rest) // 2]))
