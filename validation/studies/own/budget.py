"""The time that a tuning may take: how much is left, and what a run costs of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

from softdyn.validation.studies import tuning
from softdyn.validation.studies.engine.case import Case

Tell = Callable[[str, float], None]


@dataclass(eq=False)
class Budget:
    """How much of the time is left, and how much of it a simulated second of `best` takes.

    Attributes
    ----------
    seconds, began : float
        The time that there is, and when it began.
    wall, simulated : float
        What runs took, and how much of them was not cut short by a failure (s).
    """

    seconds: float
    began: float
    wall: float = 0.0
    simulated: float = 0.0

    def spent(self) -> float:
        """The share of the time that has passed."""
        return (monotonic() - self.began) / self.seconds

    def note(self, since: float, cases: Sequence[Case], scores: Sequence[float]) -> None:
        """Runs that began at `since` and ended now."""
        whole = sum(seconds(case) for case, score in zip(cases, scores, strict=True)
                    if score < tuning.WORST)  # fmt: skip
        if whole > 0:
            self.wall += monotonic() - since
            self.simulated += whole

    def share(self, simulated: float) -> float:
        """The share of the time that so many simulated seconds (s) take; 0 while not known."""
        return simulated * self.wall / self.simulated / self.seconds if self.simulated else 0.0


def seconds(*cases: Case) -> float:
    """How long the runs last together (s, simulated)."""
    return sum(case.duration or 0.0 for case in cases)


@dataclass(eq=False)
class Generations:
    """Tells `tuning.tune` when the next generation would end too late.

    Attributes
    ----------
    budget : Budget
        Of the whole.
    cases : list of Case
        What every candidate runs.
    population : int
        Candidates of a generation.
    until : float
        The share of the time at which the last one may end.
    tell : Callable[[str, float], None]
        Told every candidate of the `stage`.
    """

    budget: Budget
    cases: list[Case]
    population: int
    until: float
    tell: Tell
    stage: str

    def __post_init__(self) -> None:
        self._since = monotonic()
        self._scores: list[float] = []

    def each(self, entry: Mapping[str, Any]) -> None:
        """A candidate has been judged."""
        self._scores += entry["scores"]
        self.tell(f"{self.stage}, cost {entry['cost']:.3g}", self.budget.spent())

    def enough(self) -> bool:
        """Whether to end before another generation; all since the last question is one."""
        budget, runs = self.budget, self.cases * (len(self._scores) // len(self.cases))
        budget.note(self._since, runs, self._scores)
        self._since, self._scores = monotonic(), []
        return budget.spent() + budget.share(self.population * seconds(*self.cases)) > self.until
