"""Least squares in which each run of the data has its own unknowns too, solved run by run.

A run's first state affects no other run, so it can be eliminated. This saves memory: for 20 s of a
robot with 36 joints (25 runs, 1400 unknowns) the whole Jacobian takes 1.3 GB, while the reduced one
has 72 columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr, solve_triangular
from scipy.optimize import lsq_linear

DONE = 1e-9  # the search ends if a step would reduce the cost by a smaller share
EVALUATIONS = 40
DAMPING, LARGEST = 1e-8, 1e8  # Marquardt's damping: the first value, and the one to give up at


class ResidualBlock(NamedTuple):
    """One run: residuals (rows,), their derivatives by θ (rows, P) and by the run's unknowns."""

    residual: np.ndarray
    shared: np.ndarray
    own: np.ndarray


class Reduced(NamedTuple):
    """The linear problem without the runs' own unknowns: ‖R δ + d‖² and a constant.

    Attributes
    ----------
    R : ndarray, (P, P)
        Triangular; (RᵀR)⁻¹ is the covariance of θ if residuals have variance 1.
    d : ndarray, (P,)
    cost : float
        Sum of squares at δ = 0.
    gain : float
        Part of it that the runs' own steps remove.
    back : tuple
        Arrays that give each run's own step from δ.
    """

    R: np.ndarray
    d: np.ndarray
    cost: float
    gain: float
    back: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def own(self, delta: np.ndarray) -> list[np.ndarray]:
        """The best steps of the runs' own unknowns for a step δ of θ."""
        return [-solve_triangular(R, d + A @ delta) for R, d, A in self.back]


def reduced(blocks: Iterable[ResidualBlock]) -> Reduced:
    """Eliminate each run's own unknowns by QR; combine the remaining rows of all runs by QR."""
    back, cost, gain = [], 0.0, 0.0
    rows = np.zeros((0, 0))
    for residual, shared, own in blocks:
        cost += float(residual @ residual)
        both = np.column_stack((shared, residual))
        Q, R = np.linalg.qr(own)
        explained = Q.T @ both
        both = both - Q @ explained
        back.append((R, explained[:, -1], explained[:, :-1]))
        gain += float(explained[:, -1] @ explained[:, -1])
        rows = qr(np.vstack((rows, both)) if rows.size else both, mode="r")[0]
    count = rows.shape[1] - 1
    square = np.zeros((count, count + 1))
    square[: min(count, len(rows))] = rows[:count]
    return Reduced(square[:, :count], square[:, count], cost, gain, tuple(back))


def least_squares(
    blocks: Callable[[np.ndarray, Sequence[np.ndarray]], list[ResidualBlock] | None],
    theta: np.ndarray,
    own: Sequence[np.ndarray],
    lower: np.ndarray,
    done: float = DONE,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """θ ≥ `lower` and the runs' own unknowns with the least sum of squares.

    The method is Levenberg and Marquardt's; SciPy's `lsq_linear` solves each damped linear problem.
    The runs' own unknowns are not damped, because the outputs are nearly linear in them.

    Parameters
    ----------
    blocks : callable
        (θ, own) → blocks, or None if these values cannot be simulated.
    theta : ndarray, (P,)
    own : sequence of ndarray
        First values of each run's own unknowns.
    lower : ndarray, (P,)
    done : float
        The search ends if a step would reduce the cost by a smaller share.
    """
    own = list(own)
    now, damping = reduced(blocks(theta, own) or []), DAMPING
    for _ in range(EVALUATIONS):
        scale = np.sqrt(damping) * np.diag(np.linalg.norm(now.R, axis=0))
        delta = np.zeros(0)
        if theta.size:
            left, right = np.vstack((now.R, scale)), -np.append(now.d, np.zeros(len(scale)))
            with np.errstate(invalid="ignore"):  # at a bound, for a step that it does not take
                delta = lsq_linear(left, right, (lower - theta, np.inf)).x
        after = now.R @ delta + now.d
        promised = now.gain + float(now.d @ now.d - after @ after)
        if promised <= done * now.cost or damping > LARGEST:
            break
        there = theta + delta, [a + b for a, b in zip(own, now.own(delta), strict=True)]
        found = blocks(*there)
        then = reduced(found) if found is not None else None
        if then is not None and then.cost < now.cost:
            (theta, own), now, damping = there, then, max(damping / 10, DAMPING)
        else:
            damping *= 100
    return theta, own
