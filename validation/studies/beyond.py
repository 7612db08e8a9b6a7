"""Every cell of the paper's experiments for one controller, at several control periods."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from softdyn.validation.loop.metrics import mean_std
from softdyn.validation.studies import paper
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.studies.names import cell_title
from softdyn.validation.tables import pipes

PERIODS = (0.001, 0.002)  # s, beside each robot's published one
# kind → values, figure, its unit
KINDS = {
    "set_point": (paper.THETAS, "final_error_cm", "cm"),
    "tracking": (paper.OMEGAS, "mse_cm2", "cm²"),
}


def cells(robots: Sequence[str], controller: str, periods: Iterable[float] = PERIODS) -> list[Case]:
    """Set points at each period up to the published one, trajectories at that one."""
    cases = []
    for robot in robots:
        published = paper.setup(robot).period
        at = {"set_point": sorted({*(p for p in periods if p < published), published}),
              "tracking": [published]}  # fmt: skip
        for kind, (values, _, _) in KINDS.items():
            for period in at[kind]:
                cases += [Case(robot, controller, kind, value, period=period) for value in values]
    return cases


def report(robots: Sequence[str], controller: str, jobs: int = -1) -> list[dict[str, Any]]:
    """A row for each robot, kind and period: the cells and their mean."""
    cases = cells(robots, controller)
    groups: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for case, result in zip(cases, run_all(cases, jobs), strict=True):
        key = (case.robot, case.kind, case.period or 0.0)
        groups.setdefault(key, []).append({"value": case.value, **result})
    rows = []
    for (robot, kind, period), found in groups.items():
        mean, std = mean_std(cell[KINDS[kind][1]] for cell in found)
        row: dict[str, Any] = {
            "robot": robot,
            "controller": controller,
            "kind": kind,
            "period": period,
            "mean": mean,
            "std": std,
            "failed": sum(cell["failed"] for cell in found),
            "median_us": max(cell["step_us"]["median"] or 0.0 for cell in found),
            "cells": found,
        }
        if kind == "tracking":
            row["second_cycle_mean"], _ = mean_std(c["second_cycle_mse_cm2"] for c in found)
        rows.append(row)
    return rows


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Two tables: set points (cm), trajectories (cm², second cycles in brackets)."""
    parts = []
    for kind, (values, figure, unit) in KINDS.items():
        titles = [
            "robot",
            "period",
            *(cell_title(kind, x) for x in values),
            f"mean ({unit})",
            "failed",
        ]
        lines = [titles]
        for row in (row for row in rows if row["kind"] == kind):
            texts = [
                _text(cell[figure], cell.get("second_cycle_mse_cm2"), kind == "tracking")
                + (" failed" if cell["failed"] else "")
                for cell in row["cells"]
            ]
            mean = _text(row["mean"], row.get("second_cycle_mean"), kind == "tracking")
            period = f"{1e3 * row['period']:g} ms"
            lines.append([row["robot"], period, *texts, mean, str(row["failed"])])
        if len(lines) > 1:
            parts.append("\n".join(pipes(lines)))
    return "\n\n".join(parts)


def _text(value: float | None, second: float | None, both: bool) -> str:
    if both:
        return f"{_text(value, None, False)} ({_text(second, None, False)})"
    return "–" if value is None or value != value else f"{value:.2f}"
