"""A QP with further rows on u, which are relaxed if no admissible input meets them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softdyn.controllers.qps.qp import DenseQp, QpProblem, QpSolution

ROOM = 1e-2  # of a row's unit; every row is relaxed by it, because a QP needs an interior
TIE = 1e-6  # weight that chooses among inputs that break the rows alike


class Rows(NamedTuple):
    """matrix (p, nu) @ u ≤ upper (p,); `unit` (p,) makes the excesses of rows comparable."""

    matrix: np.ndarray
    upper: np.ndarray
    unit: np.ndarray

    @classmethod
    def joined(cls, parts: list[Rows]) -> Rows:
        """The rows of all parts."""
        return cls(*(np.concatenate(same) for same in zip(*parts, strict=True)))

    def where(self, chosen: np.ndarray) -> Rows:
        """Some of the rows."""
        return Rows(*(part[chosen] for part in self))

    def excess(self, u: np.ndarray) -> np.ndarray:
        """Excess (p,) of each row at u, in units; negative where u meets it."""
        excess: np.ndarray = (self.matrix @ u - self.upper) / self.unit
        return excess


class RelaxedAnswer(NamedTuple):
    """An answer, and how far (p,) each row is relaxed for it, in units.

    `least` says that the answer is the input of least excess; other unknowns then have no value.
    """

    solution: QpSolution
    limits: np.ndarray
    least: bool


class RelaxedRows:
    """Solves QPs whose first unknowns are u, with rows.

    If no admissible input meets all rows, they are relaxed by the least squares of their excess.
    The QP's feasible set may then be thinner than the solver's tolerance. If the QP has no accurate
    answer, the result is the input of least excess nearest to the answer without rows.

    Parameters
    ----------
    u_min, u_max : ndarray, (nu,)
        Bounds of u.
    """

    def __init__(self, u_min: np.ndarray, u_max: np.ndarray) -> None:
        self._u_min, self._u_max = u_min, u_max
        self._range = np.where(u_max > u_min, u_max - u_min, 1.0)
        self._solvers: dict[tuple[int, int], DenseQp] = {}

    def __call__(
        self, problem: QpProblem, wanted: np.ndarray, rows: Rows, *, relax: bool = True
    ) -> RelaxedAnswer | None:
        """The answer of `problem` with rows, where `wanted` (nu,) is the answer without.

        None if rows would have to be relaxed and `relax` is false.
        """
        room = np.full(len(rows.upper), ROOM)
        found = self._restricted(problem, rows.matrix, rows.upper + rows.unit * room)
        if found is not None and found.solved:
            return RelaxedAnswer(found, room, False)
        excess, nearest = self.least_excess(rows, wanted)
        if not relax and excess.max(initial=0.0) > ROOM:
            return None
        limits = np.where(excess > ROOM, excess + ROOM, ROOM)
        found = self._restricted(problem, rows.matrix, rows.upper + rows.unit * limits)
        if found is not None and found.solved:
            return RelaxedAnswer(found, limits, False)
        x = np.concatenate((nearest, np.full(len(problem.g) - len(nearest), np.nan)))
        answer = QpSolution(x, np.zeros(len(problem.lower)), 0.0, 0.0, 0.0)
        return RelaxedAnswer(answer, limits, True)

    def _restricted(
        self, problem: QpProblem, matrix: np.ndarray, upper: np.ndarray
    ) -> QpSolution | None:
        """The answer of `problem` with the further rows `matrix` u ≤ `upper` (p,)."""
        (p, m), size = matrix.shape, len(problem.g)
        restricted = QpProblem(
            problem.H,
            problem.g,
            np.vstack((problem.A, np.hstack((matrix, np.zeros((p, size - m)))))),
            np.concatenate((problem.lower, np.full(p, -np.inf))),
            np.concatenate((problem.upper, upper)),
        )
        return self._solver(size, len(restricted.lower)).solve(restricted)

    def least_excess(self, rows: Rows, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Excess of each row (p,) under the best admissible input, in units, and this input (m,).

        It is the s of min ‖s‖² over matrix u - unit s ≤ upper, u in bounds; s ≥ 0 needs no row. Of
        several best inputs, the one nearest to `wanted` is taken.
        """
        p, m = rows.matrix.shape
        matrix, upper = rows.matrix / rows.unit[:, None], rows.upper / rows.unit
        # the weight is relative to the inputs' effect on the rows: a smaller one would be rounding
        effect = max(1.0, float(np.linalg.norm(matrix * self._range, axis=1).max(initial=0.0)))
        tie = TIE * (effect / self._range) ** 2
        H, g = np.diag(np.concatenate((tie, np.ones(p)))), np.zeros(m + p)
        g[:m] = -tie * wanted
        A = np.zeros((m + p, m + p))
        A[:m, :m] = np.eye(m)
        A[m:, :m], A[m:, m:] = matrix, -np.eye(p)
        lower = np.concatenate((self._u_min, np.full(p, -np.inf)))
        solution = self._solver(m + p, m + p).solve(
            QpProblem(H, g, A, lower, np.concatenate((self._u_max, upper)))
        )
        u = wanted if solution is None else np.clip(solution.x[:m], self._u_min, self._u_max)
        return np.maximum(matrix @ u - upper, 0.0), u

    def _solver(self, variables: int, rows: int) -> DenseQp:
        key = variables, rows
        if key not in self._solvers:
            self._solvers[key] = DenseQp(variables, rows)
        return self._solvers[key]
