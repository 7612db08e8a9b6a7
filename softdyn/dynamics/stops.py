"""Joint limits as stops: where they are, which joints they hold, with which forces.

All functions take joint coordinates (nv,), `SoftModel.coordinates` of a configuration (rad, m).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from softdyn.compiled import compiled
from softdyn.copies import Frozen
from softdyn.dynamics.model import SoftModel, check_model

PATIENCE = 10  # rounds in which no fewer joints break a condition, before joints change one by one
ROUNDS = 1000  # in all; 36 joints with a large skew part may need more, which is an error
ROUNDING = 1e-12  # of the largest joint force: less pushes no joint off its stop
ACCURACY = 1e-9  # of the largest joint force: the most that may be left of a free joint's balance
TOUCHING = 1e-9  # a joint this close to a limit counts as at it (rad, m)


@dataclass(frozen=True, eq=False)
class Stops(Frozen):
    """The stops of a robot's joints.

    Attributes
    ----------
    lower, upper : ndarray, (nv,)
        The joint limits (rad, m); ±inf for a joint without one.
    """

    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, model: SoftModel) -> Self:
        """The stops of a robot."""
        return cls(check_model(model).lower, model.upper)

    @classmethod
    def none(cls, model: SoftModel) -> Self:
        """No stops: the joints of a robot pass their limits."""
        return cls(np.full(model.nv, -np.inf), np.full(model.nv, np.inf))

    @cached_property
    def locked(self) -> np.ndarray:
        """Joints (nv,) bool whose limits leave them one position."""
        return self.upper - self.lower <= TOUCHING

    def within(self, at: np.ndarray) -> np.ndarray:
        """The closest coordinates (nv,) that the stops allow."""
        return np.clip(at, self.lower, self.upper)

    def clip(self, at: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The part of a step (nv,) that the stops allow; none away from a limit that was passed."""
        return np.clip(step, np.minimum(self.lower - at, 0), np.maximum(self.upper - at, 0))

    def hit(
        self, at: np.ndarray, margin: np.ndarray | float = TOUCHING
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joints at their lower and at their upper limits (nv,) bool, up to a margin (rad, m)."""
        return at <= self.lower + margin, at >= self.upper - margin

    def near(self, at: np.ndarray, share: float) -> np.ndarray:
        """Joints (…, nv) bool whose distance to a limit is at most a share of their range.

        A joint without two limits has no range: it must be at its limit.
        """
        span = self.upper - self.lower
        lower, upper = self.hit(at, np.where(np.isfinite(span), share * span, 0.0))
        near: np.ndarray = lower | upper
        return near

    def solve(
        self, A: np.ndarray, r: np.ndarray, at: np.ndarray, step: float, held: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Speeds x (nv,) with A x + r = p, where p is the push of stops at the end of a step.

        The joints end at `at` + step x, within their limits. A joint that would leave them is held
        at its stop, as long as the stop pushes it inward. If all principal minors of A are
        positive, as those of a positive definite matrix, there is one such x.

        All joints that break a condition change, as long as this makes them fewer. Else the first
        one alone changes until they are fewer (Júdice and Pires 1994). This rule, Murty's, never
        comes back to an active set of such a matrix: once the joints before one meet their
        conditions, the force on it rises with its speed, so that it changes at most twice.

        Parameters
        ----------
        A, r : ndarray, (nv, nv), (nv,)
            The linear balance of the joint forces.
        at : ndarray, (nv,)
            Joint coordinates before the step.
        step : float
            Its length (s).
        held : ndarray of int, (nv,)
            A first guess: 1 for a joint at its upper stop, -1 at the lower one, 0 for a free joint.

        Returns
        -------
        x, held : ndarray, (nv,)

        Raises
        ------
        LinAlgError
            For a singular matrix, or one that is not finite; or without an answer whose balance
            and pushes are right up to rounding, in `ROUNDS` rounds.
        """
        held = held.copy()
        x, found = _solve(A, r, at, self.lower, self.upper, step, held)
        if not found:
            raise np.linalg.LinAlgError("no speeds balance the forces of joints and stops")
        return x, held

    def prepare(self) -> None:
        """Compile `solve`, so that no step of a loop waits for it when a joint meets its stop."""
        zero = np.zeros(len(self.lower))
        self.solve(np.eye(len(zero)), zero, zero, 1.0, np.zeros(len(zero), int))

    def held(self, at: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Joints (nv,) bool that the stops hold against the forces -r (nv,).

        The complementarity of a stop is r = 0 inside the limits, r ≥ 0 at the lower limit and r ≤ 0
        at the upper one. A locked joint is always held.
        """
        lower, upper = self.hit(at)
        return lower & (r > 0) | upper & (r < 0) | self.locked


@compiled
def _solve(A, r, at, lower, upper, step, held):
    """The speeds (n,) of `Stops.solve`, and whether they are the answer; `held` is changed."""
    n, x, push = len(r), np.empty(len(r)), np.empty(len(r))
    fewest, patience, times = n + 1, PATIENCE, np.zeros(n, np.int64)
    for _ in range(ROUNDS):
        rows = A.copy()
        for i in range(n):
            x[i] = -r[i]
            if held[i] != 0:
                rows[i] = 0.0
                rows[i, i] = 1.0
                x[i] = ((upper[i] if held[i] > 0 else lower[i]) - at[i]) / step
        x = np.linalg.solve(rows, x)
        largest = 0.0
        for i in range(n):
            size, push[i] = abs(r[i]), r[i]
            for j in range(n):
                part = A[i, j] * x[j]
                push[i] += part
                size += abs(part)
            largest = max(largest, size)
        changes, balanced = held.copy(), True
        broken = 0
        for i in range(n):
            if held[i] == 0:
                balanced &= abs(push[i]) <= ACCURACY * largest
                there = at[i] + step * x[i]
                if there > upper[i] or there < lower[i]:
                    changes[i] = 1 if there > upper[i] else -1
            elif push[i] * held[i] > ROUNDING * largest:
                changes[i] = 0
            broken += changes[i] != held[i]
        if broken == 0:
            return x, balanced
        patience = PATIENCE if broken < fewest else patience - 1
        fewest = min(fewest, broken)
        for i in range(n):
            if changes[i] == held[i]:
                continue
            held[i] = changes[i]
            if patience < 0:
                times[:i] = 0
                times[i] += 1
                if times[i] > 2:
                    return x, False
                break
            times[:] = 0
    return x, False
