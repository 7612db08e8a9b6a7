"""A QP on the inputs u of a step with stops, in strict order of importance.

1. The bounds of u, and the stops of joints, which decide q̈(u) (`stopped_step`).
2. Conditions A q̈ + c ≥ -unit s, with the least ‖s‖².
3. The objective, with this s.

For a mode of the stops, q̈ is linear in u, and 2 and 3 are QPs. The outer loop over the stops is
`Stops.solve`: it says to which mode an answer leads. If the answer breaks conditions in this mode,
their rows join those that the QP has. They also stay after the mode has changed, or answers would
alternate between modes. So the loop ends at an input that meets the conditions of its own mode, at
the price that it may meet those of other modes too. Few conditions ever matter, so only those that
an answer breaks become rows.

The QP of 3 comes first: if it has an answer without slack, it is the answer. If s is needed, it is
the answer of 3 with conditions relaxed by s. Its feasible set may be thinner than the solver's
tolerance. If it has no accurate answer, the result is that of 2: of the inputs with this s, the one
nearest to the input without conditions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softdyn.controllers.qps.qp import DenseQp, QpProblem, QpSolution
from softdyn.controllers.qps.stopped_step import StoppedStep

ROOM = 1e-2  # of a row's unit; every row is relaxed by it, because a QP needs an interior
NEGLIGIBLE = 1e-6  # of a row's unit
ENOUGH = ROOM + 2 * NEGLIGIBLE  # excess of a row, in units, that counts as none
MET = 2 * ROOM  # excess of an answer, in units, that counts as none
TIE = 1e-6  # weight that chooses among inputs of the same slack
ROUNDS = 8  # largest number of QPs of an outer loop
MOST = 20  # rows of a step that a round adds, those of largest excess


class Rows(NamedTuple):
    """matrix (p, nu) @ u ≤ upper (p,); `unit` (p,) makes the excesses of rows comparable."""

    matrix: np.ndarray
    upper: np.ndarray
    unit: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """The rows of all parts."""
        return cls(*(np.concatenate(same) for same in zip(*parts, strict=True)))

    def excess(self, u: np.ndarray) -> np.ndarray:
        """Excess (p,) of each row at u, in units; negative where u meets it."""
        excess: np.ndarray = (self.matrix @ u - self.upper) / self.unit
        return excess


class Conditions(NamedTuple):
    """Conditions A q̈ + c ≥ 0 on the accelerations of a step.

    Attributes
    ----------
    step : StoppedStep
        The step.
    A : ndarray, (p, n)
        Their matrix.
    c : ndarray, (p,)
        Their constant.
    unit : ndarray, (p,)
        It makes their excesses comparable.
    free : ndarray of bool, (p,)
        The conditions on q̈ without stops.
    """

    step: StoppedStep
    A: np.ndarray
    c: np.ndarray
    unit: np.ndarray
    free: np.ndarray

    def excess(self, u: np.ndarray, qdd: np.ndarray, mode: np.ndarray) -> np.ndarray:
        """Excess (p,) of each condition in units, at u and the q̈ (n,) that it has in a mode."""
        second = self.A @ qdd
        if mode.any() and self.free.any():
            second[self.free] = self.A[self.free] @ self.step.unstopped(u)
        excess: np.ndarray = -(second + self.c) / self.unit
        return excess

    def rows(self, mode: np.ndarray, which: np.ndarray) -> Rows:
        """Some of the conditions as rows on u in a mode."""
        A = self.A[which]
        response = A @ self.step.response(mode)
        free = self.free[which]
        if mode.any() and free.any():
            response[free] = A[free] @ self.step.response(self.step.free)
        return Rows(-response[:, :-1], self.c[which] + response[:, -1], self.unit[which])


class Answer(NamedTuple):
    """An answer of 2 and 3.

    Attributes
    ----------
    solution : QpSolution
        The answer.
    excess : float
        Its largest excess in its own mode, in units.
    square : float
        The sum of squares of its excesses.
    slack : bool
        Whether rows needed slack.
    least : bool
        Whether the objective had no part in it; unknowns other than u then have no value.
    """

    solution: QpSolution
    excess: float = np.inf
    square: float = np.inf
    slack: bool = False
    least: bool = False


class LexicographicQp:
    """Solves QPs whose first unknowns are u, with conditions on q̈.

    Parameters
    ----------
    u_min, u_max : ndarray, (nu,)
        Bounds of u.
    """

    def __init__(self, u_min: np.ndarray, u_max: np.ndarray) -> None:
        self._u_min, self._u_max = u_min, u_max
        self._range = np.where(u_max > u_min, u_max - u_min, 1.0)

    def __call__(
        self,
        problem: QpProblem,
        solution: QpSolution,
        conditions: Sequence[Conditions],
        *,
        slack: bool = True,
    ) -> Answer:
        """The answer in its own mode, or that of least squares of excess if none is found.

        The first mode is that of unchanged velocities, and then that of `solution`.

        Parameters
        ----------
        problem : QpProblem
            The objective, with the bounds of u.
        solution : QpSolution
            Its answer without conditions.
        conditions : sequence of Conditions
            Those of each step.
        slack : bool
            Whether conditions may have slack; else a loop ends where they need it.
        """
        steps = [one.step for one in conditions]
        still = [step.still for step in steps]
        best = self._loop(problem, solution, conditions, still, slack)
        if best.excess > MET:
            u = solution.x[: len(self._range)]
            own = [step.motion(u, step.free)[1] for step in steps]
            if not np.array_equal(own, still):
                again = self._loop(problem, solution, conditions, own, slack)
                best = min(best, again, key=lambda one: one.square)
        return best

    def _loop(
        self,
        problem: QpProblem,
        solution: QpSolution,
        conditions: Sequence[Conditions],
        modes: Sequence[np.ndarray],
        slack: bool,
    ) -> Answer:
        """The best answer of the outer loop from some modes, one for each step."""
        u = wanted = solution.x[: len(self._range)]
        best = answer = Answer(solution)
        parts: list[Rows] = []
        # of each step, whether the QP has a condition in a mode
        known: list[dict[bytes, np.ndarray]] = [{} for _ in conditions]
        # first q̈ in the given modes, then in those that u leads to
        motions = [
            (one.step.response(mode) @ np.append(u, 1.0), mode)
            for one, mode in zip(conditions, modes, strict=True)
        ]
        for k in range(ROUNDS + 1):
            excess = [one.excess(u, *m) for one, m in zip(conditions, motions, strict=True)]
            if k:
                over = np.maximum(np.concatenate(excess), 0.0)
                square = float(over @ over)
                if square < best.square:
                    best = answer._replace(excess=float(over.max()), square=square)
            before = len(parts)
            for one, (_, mode), own, in_modes in zip(
                conditions, motions, excess, known, strict=True
            ):
                has = in_modes.setdefault(mode.tobytes(), np.zeros(len(own), bool))
                worst = np.argsort(np.where(has, np.inf, -own))[:MOST]
                new = worst[(own[worst] > ENOUGH) & ~has[worst]]
                if new.size:
                    has[new] = True
                    parts.append(one.rows(mode, new))
            if len(parts) > before and k < ROUNDS:
                found = self.ordered(problem, wanted, Rows.joined(parts), slack, answer.slack)
                if found is None:
                    break
                answer, u = found, found.solution.x[: len(wanted)]
            elif k:
                break
            motions = [
                one.step.motion(u, mode) for one, (_, mode) in zip(conditions, motions, strict=True)
            ]
        return best

    def ordered(
        self, problem: QpProblem, wanted: np.ndarray, rows: Rows, slack: bool = True,
        needed: bool = False,
    ) -> Answer | None:  # fmt: skip
        """Levels 2 and 3 with the rows of known modes.

        Parameters
        ----------
        problem : QpProblem
            The objective, with the bounds of u.
        wanted : ndarray, (nu,)
            The input without rows.
        rows : Rows
            The rows.
        slack : bool
            Whether rows may have slack; else None where they need it.
        needed : bool
            Whether it is known that they need it.
        """
        if not needed:
            found = self._restricted(problem, rows.matrix, rows.upper + rows.unit * ROOM)
            if found is not None and found.solved:
                return Answer(found)
        excess, nearest = self.least_slack(rows, wanted)
        needed = excess.max(initial=0.0) > ROOM
        if needed and not slack:
            return None
        limits = np.where(excess > ROOM, excess + ROOM, ROOM)
        found = self._restricted(problem, rows.matrix, rows.upper + rows.unit * limits)
        if found is not None and found.solved:
            return Answer(found, slack=needed)
        x = np.concatenate((nearest, np.full(len(problem.g) - len(nearest), np.nan)))
        answer = QpSolution(x, np.zeros(len(problem.lower)), 0.0, 0.0, 0.0)
        return Answer(answer, slack=needed, least=True)

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
        return DenseQp(size, len(restricted.lower)).solve(restricted)

    def least_slack(self, rows: Rows, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The least slack (p,) of the rows, in units, and an admissible input (nu,) with it.

        It is the s of min ‖s‖² over matrix u - unit s ≤ upper, u in bounds; s ≥ 0 needs no row. Of
        several such inputs, the one nearest to `wanted` is taken.
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
        solution = DenseQp(m + p, m + p).solve(
            QpProblem(H, g, A, lower, np.concatenate((self._u_max, upper)))
        )
        u = wanted if solution is None else np.clip(solution.x[:m], self._u_min, self._u_max)
        return np.maximum(matrix @ u - upper, 0.0), u
