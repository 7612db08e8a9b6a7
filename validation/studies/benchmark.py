"""The paper's grid of experiments: every robot × controller × set point and trajectory.

Below the output folder lie ``runs/`` with the log and the figures of every case and ``times/``
with the step times, see `engine.store`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.validation.files import read_json
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.loop.metrics import mean_std
from softdyn.validation.studies import experiments
from softdyn.validation.studies.engine.case import NAMES, Case, number_text
from softdyn.validation.studies.engine.distribution import (
    Distribution,
    mean_and_std,
    read_distributions,
    value,
)
from softdyn.validation.studies.engine.store import Store
from softdyn.validation.studies.sweep import Sweep
from softdyn.validation.studies.sweep_file import sweep_of

# committed figures of the paper's grid, made by `benchmark.py --ensemble`
MEASURED = Path(__file__).parent / "measured"
ENSEMBLES = MEASURED / "benchmark.json"
# kind → its short name in a row, unit, figure of a run, key of all its figures in a row
KINDS = {
    "set_point": ("sp", "cm", "final_error_cm", "set_points_cm"),
    "tracking": ("tt", "cm2", "mse_cm2", "trajectories_cm2"),
}


def grid(
    robots: Iterable[str],
    controllers: Iterable[str],
    thetas: Iterable[float] | None = None,
    omegas: Iterable[float] | None = None,
) -> list[Case]:
    """Every robot × controller × experiment once, robots and controllers in the order given.

    Set points `thetas` and rates `omegas` are the paper's by default.
    """
    runs = [("set_point", theta) for theta in (experiments.THETAS if thetas is None else thetas)]
    runs += [("tracking", omega) for omega in (experiments.OMEGAS if omegas is None else omegas)]
    controllers = tuple(controllers)
    every = (
        Case(robot, controller, kind, float(value) + 0.0)  # -0 is 0
        for robot in robots
        for controller in controllers
        for kind, value in runs
    )
    return list({case.name: case for case in every}.values())


def sweep(cases: Sequence[Case]) -> Sweep:
    """The cases of a `grid` as a sweep; its robots are loaded, its controllers built as a check.

    Raises
    ------
    InputError
        An unknown robot or controller, or one that cannot be built.
    """
    targets: dict[str, dict[float, None]] = {}
    for case in cases:
        targets.setdefault(NAMES[case.kind], {})[case.value] = None
    table = {
        "robots": list(dict.fromkeys(case.robot for case in cases)),
        "controllers": list(dict.fromkeys(case.controller for case in cases)),
        "targets": {name: list(values) for name, values in targets.items()},
        "logs": True,
    }
    return sweep_of(table, Path("benchmark"))


def store(folder: Path) -> Store:
    """The store of a benchmark's results."""
    return Store(folder, times="times")


def label(case: Case) -> str:
    """The name of a cell in a file of ensembles."""
    return f"{case.robot}/{case.controller}/{cell_title(case.kind, case.value)}"


def labelled(cases: Iterable[Case]) -> dict[str, Case]:
    """Each case by its label."""
    return {label(case): case for case in cases}


@cache
def committed() -> dict[str, Distribution]:
    """The committed ensembles of the paper's grid."""
    return read_distributions(ENSEMBLES)


@cache
def emulated(robot: str, controller: str) -> dict[str, Any] | None:
    """The committed figures of the published experiment, run by our emulation of it.

    Means and deviations by the names of `experiments.Published`, None where a run ended early, and
    ``experiments`` as `python -m tests.proof reproduce` names them; None without a published row.
    """
    found: dict[str, Any] = {}
    names: dict[str, None] = {}
    for cell in published_cells():
        if cell["cell"] != f"{robot}/{controller}" or cell["published"] == "-":
            continue
        short, unit = ("sp", "cm") if cell["columns"][0].startswith("θ") else ("tt", "cm2")
        runs = emulation(cell)
        if None not in runs.values():
            pair = mean_and_std([run for run in runs.values() if run is not None])
            mean, std = (x.median if math.isfinite(x.median) else None for x in pair)
            found |= {f"{short}_mean_{unit}": mean, f"{short}_std_{unit}": std}
        names |= dict.fromkeys(label.partition("/")[0] for label in runs)
    return found | {"experiments": list(names)} if found else None


def published_cells() -> list[dict[str, Any]]:
    """The published cells: their figures, their logs, and the experiments that emulate them."""
    cells: list[dict[str, Any]] = read_json(MEASURED / "published.json", "rows of a table")["rows"]
    return cells


def emulation(cell: Mapping[str, Any]) -> dict[str, Distribution | None]:
    """The emulated runs of a published cell by their labels, one a column."""
    name = cell["experiment"]  # one for all columns, or each column's own
    each = [name] * len(cell["columns"]) if isinstance(name, str) else name
    pairs = zip(each, cell["columns"], strict=True)
    labels = [f"{experiment}/{cell['cell']}/{column}" for experiment, column in pairs]
    return {label: _emulations().get(label) for label in labels}


@cache
def _emulations() -> dict[str, Distribution]:
    return read_distributions(MEASURED / "reproduction.json")


def benchmark_report(
    cases: Sequence[Case],
    folder: Path,
    ensembles: Mapping[str, Distribution] | None = None,
) -> dict[str, Any]:
    """All figures: the rows, simulated seconds, and median step times (µs).

    The step times are means by robot and controller; `ensembles` as in `benchmark_rows`.
    """
    kept = store(folder)
    results = [kept.result(case.name) or {} for case in cases]
    medians: dict[str, dict[str, list[float]]] = {}
    for case in cases:
        median = (kept.step_times(case.name) or {}).get("median")
        if median is not None:
            medians.setdefault(case.robot, {}).setdefault(case.controller, []).append(median)
    return {
        "rows": benchmark_rows(cases, folder, ensembles),
        "simulated_s": sum(result.get("simulated_s", 0.0) for result in results),
        "step_us": {
            robot: {name: float(np.mean(values)) for name, values in found.items()}
            for robot, found in medians.items()
        },
    }


def benchmark_rows(
    cases: Iterable[Case], folder: Path, ensembles: Mapping[str, Distribution] | None = None
) -> list[dict[str, Any]]:
    """The table: one row per robot and controller, with means over all their runs.

    A run that ended early has no figure, and a mean that contains it is None. With `ensembles` a
    row has ``ensemble``, the distribution of each figure that varies, and ``outside``, the cells
    whose figure here lies outside its distribution.

    Raises
    ------
    InputError
        A case has no result, or its log belongs to another result.
    """
    runs, kept = [], store(folder)
    for case in cases:
        result = kept.figures(case, case.name)
        if result is None:
            raise InputError(str(kept.result_path(case.name)), "the result of a run", "none")
        runs.append((case, result))
    return rows_of_runs(runs, ensembles)


def rows_of_runs(
    runs: Iterable[tuple[Case, dict[str, Any]]], ensembles: Mapping[str, Distribution] | None = None
) -> list[dict[str, Any]]:
    """The same table from runs in memory."""
    groups: dict[tuple[str, str], list[tuple[Case, dict[str, Any]]]] = {}
    for case, result in runs:
        groups.setdefault((case.robot, case.controller), []).append((case, result))
    return [
        row(*key, group) | ({} if ensembles is None else distributions(group, ensembles))
        for key, group in groups.items()
    ]


def distributions(
    runs: Iterable[tuple[Case, dict[str, Any]]], kept: Mapping[str, Distribution]
) -> dict[str, Any]:
    """The committed ensembles' figures for the runs of one row."""
    moving: dict[str, Any] = {}
    outside = []
    for kind, (short, unit, figure, every) in KINDS.items():
        mine = [(case, result) for case, result in runs if case.kind == kind]
        cells = {case: kept[label(case)] for case, _ in mine if label(case) in kept}
        each = {number_text(c.value): cell.summary() for c, cell in cells.items() if cell.moves}
        for case, result in mine:
            if case in cells and not cells[case].holds(value(result[figure])):
                outside.append(cell_title(kind, case.value))
        if each:
            moving[every] = each
            if len(cells) == len(mine):
                mean, std = mean_and_std(list(cells.values()))
                moving[f"{short}_mean_{unit}"] = mean.summary() | {"text": mean.text(std)}
    return {"ensemble": moving, "outside": outside}


def row(robot: str, controller: str, runs: list[tuple[Case, dict[str, Any]]]) -> dict[str, Any]:
    """A row of the table: the figures of one robot and controller over all their runs."""

    def of(kind: str, figure: str) -> dict[str, Any]:
        return {number_text(c.value): r[figure] for c, r in runs if c.kind == kind}

    own = [(c, r) for c, r in runs if c.kind == "point"]
    points, rates = of("set_point", "final_error_cm"), of("tracking", "mse_cm2")
    points |= {cell_title(c.kind, c.value): r["final_error_cm"] for c, r in own}
    second = of("tracking", "second_cycle_mse_cm2")
    sp, tt, late = (mean_std(x.values()) for x in (points, rates, second))
    published = experiments.published(robot, controller)
    results = [result for _, result in runs]
    return {
        "robot": robot,
        "controller": controller,
        "sp_mean_cm": sp[0],
        "sp_std_cm": sp[1],
        "tt_mean_cm2": tt[0],
        "tt_std_cm2": tt[1],
        "second_cycle_tt_mean_cm2": late[0],
        "failed": [
            {"kind": case.kind, "value": case.value, "reason": result["reason"]}
            for case, result in runs
            if result["failed"]
        ],
        "set_points_cm": points,
        "trajectories_cm2": rates,
        "input_activity": mean_std(result["input_activity"] for result in results)[0],
        "not_solved": sum(result["not_solved"] for result in results),
        "fallbacks": sum(result["fallbacks"] for result in results),
        "max_bound_violation": max(_number(r["max_bound_violation"]) for r in results),
        "paper": None if published is None else asdict(published),
        "emulated": emulated(robot, controller),
    }


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
