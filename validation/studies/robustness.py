"""A controller away from its model: other targets, plants, delayed inputs, a noisy tip."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.deviations import Link, Plant
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.tables import pipes

CELLS = (("set_point", 0.25), ("set_point", 1.25), ("tracking", 0.25))  # none of them the paper's
FACTORS = (0.8, 0.9, 1.1, 1.2)
FIGURE = {"set_point": "final_error_cm", "tracking": "mse_cm2"}
NAME = {"set_point": "theta", "tracking": "omega"}

# what is changed → the fields of a case that do it
CHANGES: dict[str, dict[str, Any]] = {
    "none": {},
    "ellipse x 0.7": {"shrink": 0.7},
    **{
        f"{name} x {factor:g}": {"plant": Plant(**{name: factor})}  # type: ignore[arg-type]
        for name in ("mass", "stiffness", "damping")
        for factor in FACTORS
    },
    "5 ms delay": {"link": Link(delay=0.005)},
    "1 mm noise": {"link": Link(noise=0.001)},
}


def report(
    robots: Iterable[str], controller: str, period: float, jobs: int = -1
) -> list[dict[str, Any]]:
    """A row for each robot and change: final errors (cm), mean squared ones (cm²), failures."""
    cells = [(robot, change, *cell) for robot in robots for change in CHANGES for cell in CELLS]
    results = run_all(
        [Case(robot, controller, kind, value, period=period, **CHANGES[change])
         for robot, change, kind, value in cells],
        jobs,
    )  # fmt: skip
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for (robot, change, kind, value), result in zip(cells, results, strict=True):
        row = rows.setdefault((robot, change), {"robot": robot, "change": change, "failed": 0})
        row[f"{NAME[kind]} {value:g}"] = result[FIGURE[kind]]
        row["failed"] += result["failed"]
    return list(rows.values())


def nearby_failures(rows: Iterable[dict[str, Any]]) -> int:
    """How many runs failed with a plant within 10 % of the model."""
    far = tuple(f" x {factor:g}" for factor in (FACTORS[0], FACTORS[-1]))
    return sum(row["failed"] for row in rows if not row["change"].endswith(far))


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """The table; set points in cm, trajectories in cm²."""
    texts = [[f"{x:.2f}" if isinstance(x, float) else x for x in row.values()] for row in rows]
    return "\n".join(pipes([list(rows[0]), *texts]))
