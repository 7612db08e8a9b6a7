"""Least squares in which each run of the data has unknowns of its own, solved run by run.

The first state of each run is in no other run's outputs: with 20 s of a robot of 36 joints, 25 runs
and 1400 unknowns, the whole Jacobian is 1.3 GB, and its reduction below has 72 columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr, solve_triangular
from scipy.optimize import lsq_linear

DONE = 1e-9  # the share of the cost that a step would still take off at the end
EVALUATIONS = 40
DAMPING, LARGEST = 1e-8, 1e8  # Marquardt's, at first and when no step helps


class ResidualBlock(NamedTuple):
    """One run: residuals (rows,), their derivatives by θ (rows, P) and by its own unknowns."""

    residual: np.ndarray
    shared: np.ndarray
    own: np.ndarray


class Reduced(NamedTuple):
    """The linear problem without the runs' own unknowns: ‖R δ + d‖² and a constant.

    Attributes
    ----------
    R : ndarray, (P, P)
        Triangular; (RᵀR)⁻¹ is the covariance of θ where residuals have variance 1.
    d : ndarray, (P,)
    cost : float
        Sum of squares at δ = 0.
    gain : float
        What the runs' own steps alone take off it.
    back : tuple
        For each run, what gives its own step from δ.
    """

    R: np.ndarray
    d: np.ndarray
    cost: float
    gain: float
    back: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def own(self, delta: np.ndarray) -> list[np.ndarray]:
        """The runs' own steps that go best with a step δ of θ."""
        return [-solve_triangular(R, d + A @ delta) for R, d, A in self.back]


def reduced(blocks: Iterable[ResidualBlock]) -> Reduced:
    """Eliminate each run's own unknowns by QR, and gather what is left of all runs by QR."""
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

    Levenberg and Marquardt's method; each damped linear problem is SciPy's `lsq_linear`. The runs'
    own unknowns are not damped: an output is nearly linear in them.

    Parameters
    ----------
    blocks : callable
        (θ, own) → blocks, or None where there are none.
    theta : ndarray, (P,)
    own : sequence of ndarray
        Run by run.
    lower : ndarray, (P,)
    done : float
        Share of the cost: where a step promises less, the search ends.
    """
    own = list(own)
    now, damping = reduced(blocks(theta, own) or []), DAMPING
    for _ in range(EVALUATIONS):
        scale = np.sqrt(damping) * np.diag(np.linalg.norm(now.R, axis=0))
        delta = np.zeros(0)
        if theta.size:
            left, right = np.vstack((now.R, scale)), -np.append(now.d, np.zeros(len(scale)))
            with np.errstate(invalid="ignore"):  # at a bound SciPy weighs a way that is not there
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
