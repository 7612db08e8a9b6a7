"""The result of a cross-check: errors by quantity, trajectories, step halving, as a table."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from softdyn.validation.tables import Table

CHECKS = (
    ("quantity", "quantity", ""), ("max error", "max_error", ".1e"),
    ("tolerance", "tolerance", ".0e"), ("", "verdict", ""), ("relative to at least", "about", ""),
)  # fmt: skip
FORCES = (
    ("force", "name", ""), ("derivatives", "derivatives", ".1e"), ("power balance", "power", ".1e"),
)  # fmt: skip
RUNS = (
    ("trajectory", "name", ""), ("scheme", "scheme", ""), ("step s", "step", ".2g"),
    ("length s", "duration", ".3g"), ("error", "max_error", ".1e"), ("", "why", ""),
)  # fmt: skip
RUNGS = (
    ("", "margin", ""), ("step s", "step", ".2g"), ("engines differ", "engine_error", ".1e"),
    ("from the limit", "truncation_error", ".1e"), ("order", "order", ".2f"),
)  # fmt: skip


@dataclass(frozen=True)
class Check:
    """The verdict on one quantity.

    Attributes
    ----------
    quantity : str
        One of `crosscheck.QUANTITIES`.
    max_error, tolerance : float
        Relative.
    scale : str
        The value below which a difference counts as zero, in words.
    reason : str
        A failure other than a difference of numbers, or why the quantity was not compared.
    compared : bool
        Whether there is a verdict. False where MuJoCo cannot compute the quantity of a robot whose
        terms agree.
    """

    quantity: str
    max_error: float
    tolerance: float
    scale: str
    reason: str = ""
    compared: bool = True

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the tolerance, or nothing was compared."""
        if not self.compared:
            return True
        return not self.reason and self.max_error <= self.tolerance  # false for NaN


@dataclass(frozen=True)
class GivenForce:
    """The statements of a force of one's own about itself; the force is given, not checked.

    Attributes
    ----------
    name : str
        Its name.
    derivatives : float
        Largest relative difference of its derivatives from central differences.
    power : float or None
        Largest relative error of the power balance: the rate of its energy is minus the power of
        the force at rest. None for a force without energy.
    """

    name: str
    derivatives: float
    power: float | None

    @property
    def worst(self) -> float:
        """The larger of both."""
        return max(self.derivatives, self.power or 0.0)


@dataclass(frozen=True)
class TrajectoryRun:
    """One trajectory in both engines.

    Attributes
    ----------
    name, scheme : str
        The name of the trajectory, and of the integration scheme.
    step, duration : float
        Integration step, and length of the compared part (s).
    max_error : float
        Relative.
    why : str
        The reason why the comparison ended there.
    """

    name: str
    scheme: str
    step: float
    duration: float
    max_error: float
    why: str


@dataclass(frozen=True)
class Rung:
    """One step size of a step-halving ladder.

    Attributes
    ----------
    step : float
        Size (s).
    engine_error : float
        Difference between the engines.
    truncation_error : float
        Difference between our trajectory and the converged one.
    order : float or None
        Observed order, from this rung and the one before. None where rounding hides the truncation
        error.
    """

    step: float
    engine_error: float
    truncation_error: float
    order: float | None


@dataclass(frozen=True)
class StepLadder:
    """Step halving of one scheme over `duration` (s)."""

    scheme: str
    expected_order: int
    duration: float
    rungs: tuple[Rung, ...]


@dataclass(frozen=True)
class CrossCheck:
    """The result of `crosscheck`; its text is the table that the script prints.

    Attributes
    ----------
    robot, nv, nu, samples, seed
        The robot, its sizes, the number of random states and their seed.
    checks : tuple of Check
        One per quantity, in the order of `QUANTITIES`. The last one is missing when trajectories
        are not compared.
    condition : float
        The largest condition number of M. If two engines agree on M to rounding ε, they can agree
        on q̈ to about ε times this number, and the tolerances of q̈ and of what is integrated from
        it are not below that.
    runs : tuple of TrajectoryRun
        The trajectories compared.
    ladders : tuple of StepLadder
        Convergence of the schemes under step halving.
    forces : tuple of GivenForce
        The forces of one's own.
    """

    robot: str
    nv: int
    nu: int
    samples: int
    seed: int
    checks: tuple[Check, ...]
    condition: float
    runs: tuple[TrajectoryRun, ...]
    ladders: tuple[StepLadder, ...]
    forces: tuple[GivenForce, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return not self.failures

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the quantities that failed."""
        return tuple(check.quantity for check in self.checks if not check.passed)

    @property
    def verdict(self) -> str:
        """The result in one line."""
        if self.failures:
            return f"FAILED: {', '.join(self.failures)}"
        missing = [check for check in self.checks if not check.compared]
        if not missing:
            return "the two engines agree"
        names = " and no ".join(check.quantity for check in missing)
        reasons = dict.fromkeys(check.reason for check in missing)  # each once
        return f"the terms agree; no {names}, because {'; '.join(reasons)}"

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data; figures that are not finite are None."""
        data = asdict(self)
        data["trajectories"] = [
            {**row, "max_error": finite(row["max_error"])} for row in data.pop("runs")
        ]
        for check, row in zip(self.checks, data["checks"], strict=True):
            row |= {"max_error": finite(check.max_error), "passed": check.passed}
        return data | {"passed": self.passed, "condition": finite(self.condition)}

    def __str__(self) -> str:
        checks = (
            {**vars(c), "verdict": _word(c), "about": c.reason or c.scale} for c in self.checks
        )
        parts = [
            f"{self.robot}: {self.nv} degrees of freedom, {self.nu} inputs; "
            f"{self.samples} random states, seed {self.seed}",
            Table.of(CHECKS, checks).text(),
        ]
        if self.forces:
            parts.append(Table.of(FORCES, map(vars, self.forces)).text())
        if self.runs:
            parts.append(Table.of(RUNS, map(vars, self.runs)).text())
        for ladder in self.ladders:
            head = (
                f"step halving, {ladder.scheme} over {ladder.duration:.2g} s, "
                f"expected order {ladder.expected_order}"
            )
            rungs = ({"margin": "", **vars(rung)} for rung in ladder.rungs)
            parts.append(f"{head}\n{Table.of(RUNGS, rungs).text()}")
        return "\n\n".join([*parts, self.verdict])


def _word(check: Check) -> str:
    """The verdict on one quantity, for the table."""
    return ("ok" if check.passed else "FAILED") if check.compared else "not compared"


def finite(value: float) -> float | None:
    """`value`, or None for NaN and infinity, which JSON cannot write."""
    return value if math.isfinite(value) else None
