"""What a cross-check found: errors by quantity, trajectories, step halving; its text is a table."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from softdyn.validation.tables import columns


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
        What counts as nothing.
    reason : str
        What went wrong other than a plain difference.
    """

    quantity: str
    max_error: float
    tolerance: float
    scale: str
    reason: str = ""

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the tolerance."""
        return not self.reason and self.max_error <= self.tolerance  # false for NaN


@dataclass(frozen=True)
class TrajectoryRun:
    """One trajectory in both engines.

    Attributes
    ----------
    name, scheme : str
        What moves the robot, and what integrates it.
    step, duration : float
        How finely and how far it was followed (s).
    max_error : float
        Relative.
    why : str
        Why it was followed so far.
    """

    name: str
    scheme: str
    step: float
    duration: float
    max_error: float
    why: str


@dataclass(frozen=True)
class Rung:
    """One step size of a ladder.

    Attributes
    ----------
    step : float
        Size (s).
    engine_error : float
        The engines' difference.
    truncation_error : float
        Our distance from the limit.
    order : float or None
        Observed, from the rung before; None where rounding hides the truncation error.
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
    """What `crosscheck` found; its text is the table that the script prints.

    Attributes
    ----------
    robot, nv, nu, samples, seed
        What was compared, at how many random states.
    checks : tuple of Check
        One a quantity, in the order of `QUANTITIES`; without the last one where no trajectories
        were asked for.
    condition : float
        The largest condition number of M met. Where two engines agree on M to rounding ε, the best
        they can do on q̈ is about ε times that.
    runs : tuple of TrajectoryRun
        The trajectories compared.
    ladders : tuple of StepLadder
        Convergence of the schemes under step halving.
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

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return not self.failures

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the quantities that failed."""
        return tuple(check.quantity for check in self.checks if not check.passed)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data; figures that are not finite are None."""
        data = asdict(self)
        data["trajectories"] = data.pop("runs")
        for check, row in zip(self.checks, data["checks"], strict=True):
            row |= {"max_error": finite(check.max_error), "passed": check.passed}
        return data | {"passed": self.passed, "condition": finite(self.condition)}

    def __str__(self) -> str:
        lines = [["quantity", "max error", "tolerance", "", "relative to at least"]]
        for check in self.checks:
            figures = [f"{check.max_error:.1e}", f"{check.tolerance:.0e}"]
            verdict = ["ok" if check.passed else "FAILED", check.reason or check.scale]
            lines.append([check.quantity, *figures, *verdict])
        parts = [
            f"{self.robot}: {self.nv} degrees of freedom, {self.nu} inputs; "
            f"{self.samples} random states, seed {self.seed}",
            columns(lines, (1, 2)),
        ]
        if self.runs:
            lines = [["trajectory", "scheme", "step s", "length s", "error", ""]]
            for run in self.runs:
                figures = [f"{run.step:.2g}", f"{run.duration:.3g}", f"{run.max_error:.1e}"]
                lines.append([run.name, run.scheme, *figures, run.why])
            parts.append(columns(lines, (2, 3, 4)))
        for ladder in self.ladders:
            lines = [["", "step s", "engines differ", "from the limit", "order"]]
            for rung in ladder.rungs:
                errors = [f"{rung.engine_error:.1e}", f"{rung.truncation_error:.1e}"]
                order = "-" if rung.order is None else f"{rung.order:.2f}"
                lines.append(["", f"{rung.step:.2g}", *errors, order])
            head = (
                f"step halving, {ladder.scheme} over {ladder.duration:.2g} s, "
                f"expected order {ladder.expected_order}"
            )
            parts.append(f"{head}\n{columns(lines, range(5))}")
        failed = ", ".join(self.failures)
        parts.append(f"FAILED: {failed}" if failed else "the two engines agree")
        return "\n\n".join(parts)


def finite(value: float) -> float | None:
    """`value`, or None where JSON has no word for it."""
    return value if math.isfinite(value) else None
