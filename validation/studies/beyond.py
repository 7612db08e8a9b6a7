"""Every cell of the paper's experiments for one controller, at several control periods."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from softdyn.validation.loop.metrics import mean_std
from softdyn.validation.studies import paper
from softdyn.validation.studies.trials import Trial, run_all
from softdyn.validation.tables import pipes

PERIODS = (0.001, 0.002)  # s, beside each robot's published one


def cells(
    robots: Sequence[str], controller: str, periods: Iterable[float] = PERIODS
) -> list[Trial]:
    """Set points at each period up to the published one, trajectories at that one."""
    trials = []
    for robot in robots:
        published = paper.setup(robot).period
        for period in sorted({*(p for p in periods if p < published), published}):
            trials += [Trial(robot, controller, "set_point", x, period) for x in paper.THETAS]
        trials += [Trial(robot, controller, "tracking", x, published) for x in paper.OMEGAS]
    return trials


def report(robots: Sequence[str], controller: str, jobs: int = -1) -> list[dict[str, Any]]:
    """A row for each robot, kind and period: the cells and their mean."""
    trials = cells(robots, controller)
    results = run_all(trials, jobs)
    groups: dict[tuple[str, str, float], list[tuple[Trial, dict[str, Any]]]] = {}
    for trial, result in zip(trials, results, strict=True):
        key = (trial.robot, trial.kind, trial.period or 0.0)
        groups.setdefault(key, []).append((trial, result))
    rows = []
    for (robot, kind, period), members in groups.items():
        figure = "final_error_cm" if kind == "set_point" else "mse_cm2"
        mean, std = mean_std(result[figure] for _, result in members)
        row: dict[str, Any] = {
            "robot": robot,
            "controller": controller,
            "kind": kind,
            "period": period,
            "mean": mean,
            "std": std,
            "failed": sum(result["failed"] for _, result in members),
            "median_us": max(result["step_us"]["median"] or 0.0 for _, result in members),
            "cells": [{"value": trial.value, **result} for trial, result in members],
        }
        if kind == "tracking":
            row["second_cycle_mean"], _ = mean_std(
                result["second_cycle_cm2"] for _, result in members
            )
        rows.append(row)
    return rows


def markdown(rows: Iterable[dict[str, Any]]) -> str:
    """Two tables: set points (cm), trajectories (cm², second cycles in brackets)."""
    rows = list(rows)
    parts = []
    for kind, values, unit, head in (
        ("set_point", paper.THETAS, "cm", "θ = {:g}π"),
        ("tracking", paper.OMEGAS, "cm²", "ω = {:g}π"),
    ):
        names = ["robot", "period", *(head.format(x) for x in values), f"mean ({unit})", "failed"]
        lines = [names]
        for row in rows:
            if row["kind"] != kind:
                continue
            texts = [row["robot"], f"{1e3 * row['period']:g} ms"]
            for cell in row["cells"]:
                text = _text(cell["final_error_cm" if kind == "set_point" else "mse_cm2"])
                if kind == "tracking":
                    text += f" ({_text(cell['second_cycle_cm2'])})"
                texts.append(text + (" failed" if cell["failed"] else ""))
            mean = _text(row["mean"])
            if kind == "tracking":
                mean += f" ({_text(row['second_cycle_mean'])})"
            lines.append([*texts, mean, str(row["failed"])])
        if len(lines) > 1:
            parts.append("\n".join(pipes(lines)))
    return "\n\n".join(parts)


def _text(value: float | None) -> str:
    return "–" if value is None or value != value else f"{value:.2f}"
