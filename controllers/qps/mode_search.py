"""The search for an input that meets rows which depend on the mode that it leads to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from softdyn.controllers.qps.qp import QpProblem, QpSolution
from softdyn.controllers.qps.relaxed_rows import ROOM, RelaxedRows, Rows
from softdyn.controllers.qps.stopped_step import StoppedStep

NEGLIGIBLE = 1e-6  # of a row's unit
ROUNDS = 8  # largest number of QPs from one start
MOST = 20  # rows of a step that a round adds, those of largest excess


class Attempt(NamedTuple):
    """An answer, its largest excess in units, and whether it is the input of least excess."""

    answer: QpSolution
    violation: float = np.inf
    least: bool = False


class ModeSearch:
    """Looks for the answer of a QP that meets the rows of its own modes.

    Few rows ever matter. So a round adds rows that the last answer breaks, in the modes that it
    leads to, to those of earlier rounds.

    Parameters
    ----------
    steps : sequence of StoppedStep
        The steps that have rows.
    rows_of : callable
        (step, mode) -> its rows.
    stopped : bool
        Whether joints have stops; else every step has its free mode only.
    relax : bool
        Whether rows are relaxed if no admissible input meets them; else the search ends there.
    """

    def __init__(
        self,
        steps: Sequence[StoppedStep],
        rows_of: Callable[[StoppedStep, np.ndarray], Rows],
        *,
        stopped: bool,
        relax: bool,
    ) -> None:
        self.steps, self.relax = steps, relax
        self._rows_of, self._stopped = rows_of, stopped
        self._known: dict[tuple[int, bytes], Rows] = {}

    def best(self, qp: RelaxedRows, problem: QpProblem, solution: QpSolution, nu: int) -> Attempt:
        """The attempt of least excess, from `solution` without rows.

        The first modes are those of unchanged velocities, and then those of `solution`.
        """
        free, found = [step.free for step in self.steps], Attempt(solution)
        starts = [free]
        if self._stopped:
            starts = [[step.still for step in self.steps], self._modes(solution.x[:nu], free)]
        for modes in starts:
            found = min(
                found,
                self._attempt(qp, problem, solution, nu, modes),
                key=lambda one: one.violation,
            )
            if found.violation <= 2 * ROOM:
                break
        return found

    def _attempt(
        self,
        qp: RelaxedRows,
        problem: QpProblem,
        solution: QpSolution,
        nu: int,
        modes: list[np.ndarray],
    ) -> Attempt:
        best, wanted = Attempt(solution), solution.x[:nu].copy()
        u, answer, least = wanted, solution, False
        limits: dict[tuple[int, bytes], np.ndarray] = {}  # NaN: the row is not in the QP
        for k in range(ROUNDS):
            if self._add(u, modes, limits):
                parts = [self._known[key].where(~np.isnan(own)) for key, own in limits.items()]
                found = qp(problem, wanted, Rows.joined(parts), relax=self.relax)
                if found is None:
                    break
                answer, least, u = found.solution, found.least, found.solution.x[:nu]
                ends = np.cumsum([len(part.upper) for part in parts])[:-1]
                for own, new in zip(limits.values(), np.split(found.limits, ends), strict=True):
                    own[~np.isnan(own)] = new
            elif k:
                break
            modes = self._modes(u, modes)
            violation = self._violation(u, modes)
            if violation < best.violation:
                best = Attempt(answer, violation, least)
        return best

    def _add(
        self, u: np.ndarray, modes: list[np.ndarray], limits: dict[tuple[int, bytes], np.ndarray]
    ) -> bool:
        """Whether u breaks rows that are not in the QP; the worst of them are added."""
        added = False
        for k, mode in enumerate(modes):
            rows = self._rows(k, mode)
            own = limits.setdefault((k, mode.tobytes()), np.full(len(rows.upper), np.nan))
            excess = np.where(np.isnan(own), rows.excess(u), -np.inf)
            worst = np.argsort(-excess)[:MOST]
            new = worst[excess[worst] > ROOM + 2 * NEGLIGIBLE]
            own[new] = ROOM
            added |= new.size > 0
        return added

    def _violation(self, u: np.ndarray, modes: list[np.ndarray]) -> float:
        return max(
            float(self._rows(k, mode).excess(u).max(initial=0.0)) for k, mode in enumerate(modes)
        )

    def _modes(self, u: np.ndarray, start: list[np.ndarray]) -> list[np.ndarray]:
        if not self._stopped:
            return start
        return [step.motion(u, mode)[1] for step, mode in zip(self.steps, start, strict=True)]

    def _rows(self, k: int, mode: np.ndarray) -> Rows:
        key = k, mode.tobytes()
        if key not in self._known:
            self._known[key] = self._rows_of(self.steps[k], mode)
        return self._known[key]
