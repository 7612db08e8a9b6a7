"""The paper's grid of experiments: one file a case, resumable, the same whatever runs it.

A case is a robot, a controller and an experiment. Its result lies in three files below the
output folder: ``runs/CASE.npz``, the log without its step times; ``times/CASE.json``, the step
times, the only part of a run that is not the same twice; and ``runs/CASE.json``, the figures,
written last, with the log's hash and a fingerprint of everything that they depend on.

Each file appears whole or not at all, and two runs of one case write the same bytes: a run that is
killed leaves nothing that is taken for a result, and two runs in one folder do no harm.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.controllers.registry import blamed
from softdyn.validation.files import write_json
from softdyn.validation.loop import metrics
from softdyn.validation.loop.closed_loop import simulate
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.log import Log
from softdyn.validation.processes import in_processes
from softdyn.validation.studies import paper
from softdyn.validation.studies.fingerprint import digest, fingerprint, load_model, make_controller


@dataclass(frozen=True)
class Case:
    """One closed loop: `value` is θ of a set point or ω of a trajectory, in multiples of π."""

    robot: str
    controller: str
    kind: str
    value: float

    @property
    def name(self) -> str:
        """A relative path that is safe as a file's and unique to the case."""
        parts = (safe(self.robot), safe(self.controller), f"{self.kind}_{number_text(self.value)}")
        return "/".join(parts)

    def experiment(self, model: SoftModel) -> Experiment:
        """What to run; the paper's ellipse in the robot's own size unless it is the paper's."""
        setup = paper.setup_of(model)
        make = setup.set_point if self.kind == "set_point" else setup.tracking
        return make(self.value)


def grid(
    robots: Iterable[str],
    controllers: Iterable[str],
    thetas: Iterable[float] = paper.THETAS,
    omegas: Iterable[float] = paper.OMEGAS,
) -> list[Case]:
    """Every robot × controller × experiment once, robots and controllers in the order given."""
    runs = [("set_point", theta) for theta in thetas] + [("tracking", omega) for omega in omegas]
    controllers = tuple(controllers)
    every = (
        Case(robot, controller, kind, float(value) + 0.0)  # -0 is 0
        for robot in robots
        for controller in controllers
        for kind, value in runs
    )
    return list(dict.fromkeys(every))


def run_grid(cases: list[Case], folder: Path, jobs: int = -1) -> Iterator[tuple[Case, bool]]:
    """Run what is missing or out of date below `folder`; yields (case, whether it was run).

    Cases come as they finish, the ones that need no run first. Nothing depends on `jobs`.

    Raises
    ------
    InputError
        An unknown robot or controller, before anything runs; what a user's own controller raises.
    WorkerKilled
        A process was ended from outside.
    """
    with redirect_stdout(sys.stderr):  # what a user's controller prints
        prints = {case: fingerprint(case) for case in cases}
    fresh = {case for case in cases if is_fresh(case, folder, prints[case])}
    yield from ((case, False) for case in cases if case in fresh)
    # the longest first, so that no core idles at the end
    missing = sorted((case for case in cases if case not in fresh), key=cost, reverse=True)
    calls = ((case, folder, prints[case]) for case in missing)
    yield from ((case, True) for case in in_processes(run_case, calls, jobs))


def run_case(case: Case, folder: Path, print_: str) -> Case:
    """Run one case and write its files; engines are built here."""
    save_case(case, _simulate(case), folder, print_)
    return case


def save_case(case: Case, log: Log, folder: Path, print_: str, **changes: float | None) -> None:
    """Write the files of a case that was run, the result last.

    `changes` replace figures of merit, where an experiment has others.
    """
    result = {
        "fingerprint": print_,
        **asdict(case),
        "final_error_cm": log.final_error_cm,
        "mse_cm2": log.mse_cm2,
        "second_cycle_mse_cm2": paper.second_cycle_mse_cm2(log) if log.omega else None,
        "failed": log.failed,
        "reason": log.reason,
        "steps": log.steps,
        "simulated_s": float(log.t[-1]),
        "not_solved": log.not_solved,
        "fallbacks": log.fallbacks,
        "max_bound_violation": log.max_bound_violation,
        **changes,
    }
    paths = {kind: _path(folder, kind, case) for kind in ("log", "result", "times")}
    for path in paths.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    replace(log, step_us=np.full_like(log.step_us, np.nan)).save(paths["log"])
    write_json(paths["times"], log.step_times_us)
    write_json(paths["result"], {**result, "log_sha256": digest(paths["log"])})


def _simulate(case: Case) -> Log:
    model = load_model(case.robot)
    controller = make_controller(case.controller, model)
    with blamed(case.controller, "a command"):
        return simulate(model, controller, case.experiment(model), name=case.controller)


def is_fresh(case: Case, folder: Path, print_: str) -> bool:
    """Whether a case has all its files, whole and of this fingerprint."""
    result = load_result(case, folder, print_)
    if result is None or load_times(case, folder) is None:
        return False
    try:
        return digest(log_path(folder, case)) == result.get("log_sha256")
    except OSError:
        return False


def load_result(case: Case, folder: Path, print_: str | None = None) -> dict[str, Any] | None:
    """The figures of a case; None when it has none, or not of this fingerprint."""
    result = _read(_path(folder, "result", case))
    fits = result is not None and print_ in (None, result.get("fingerprint"))
    return result if fits and log_path(folder, case).is_file() else None


def load_times(case: Case, folder: Path) -> dict[str, float | None] | None:
    """Step times of a case (µs): median, p99, p999, max; None when they are not there."""
    return _read(_path(folder, "times", case))


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def log_path(folder: Path, case: Case) -> Path:
    """Where the log of a case lies."""
    return _path(folder, "log", case)


def simulated_seconds(cases: list[Case], folder: Path) -> float:
    """Simulated time of all cases (s)."""
    return sum((load_result(case, folder) or {}).get("simulated_s", 0.0) for case in cases)


def step_times(cases: list[Case], folder: Path) -> dict[str, dict[str, float]]:
    """Mean of the cases' median step times (µs), by robot and controller."""
    found: dict[str, dict[str, list[float]]] = {}
    for case in cases:
        median = (load_times(case, folder) or {}).get("median")
        if median is not None:
            found.setdefault(case.robot, {}).setdefault(case.controller, []).append(median)
    return {
        robot: {name: float(np.mean(medians)) for name, medians in by_name.items()}
        for robot, by_name in found.items()
    }


def rows(cases: list[Case], folder: Path) -> list[dict[str, Any]]:
    """The table: one row a robot and controller, means over all their runs.

    A run that ended early has no figure, and a mean that contains it is None.
    """
    groups: dict[tuple[str, str], list[Case]] = {}
    for case in cases:
        groups.setdefault((case.robot, case.controller), []).append(case)
    return [_row(*key, group, folder) for key, group in groups.items()]


def _row(robot: str, controller: str, cases: list[Case], folder: Path) -> dict[str, Any]:
    results = [_result(case, folder) for case in cases]
    by_kind = {
        kind: [_number(r[figure]) for r in results if r["kind"] == kind]
        for kind, figure in (("set_point", "final_error_cm"), ("tracking", "mse_cm2"))
    }
    second = [_number(r["second_cycle_mse_cm2"]) for r in results if r["kind"] == "tracking"]
    sp, tt = (metrics.mean_std(by_kind[kind]) for kind in ("set_point", "tracking"))
    published = paper.published(robot, controller)
    return {
        "robot": robot,
        "controller": controller,
        "sp_mean_cm": sp[0],
        "sp_std_cm": sp[1],
        "tt_mean_cm2": tt[0],
        "tt_std_cm2": tt[1],
        "second_cycle_tt_mean_cm2": metrics.mean_std(second)[0],
        "failed": [
            {"kind": r["kind"], "value": r["value"], "reason": r["reason"]}
            for r in results
            if r["failed"]
        ],
        "set_points_cm": {
            number_text(r["value"]): r["final_error_cm"] for r in _of(results, "set_point")
        },
        "trajectories_cm2": {
            number_text(r["value"]): r["mse_cm2"] for r in _of(results, "tracking")
        },
        "not_solved": sum(r["not_solved"] for r in results),
        "fallbacks": sum(r["fallbacks"] for r in results),
        "max_bound_violation": max(_number(r["max_bound_violation"]) for r in results),
        "paper": None if published is None else asdict(published),
    }


def _of(results: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [result for result in results if result["kind"] == kind]


def _result(case: Case, folder: Path) -> dict[str, Any]:
    result = load_result(case, folder)
    if result is None:
        raise InputError(str(_path(folder, "result", case)), "the result of a run", "none")
    return result


def number_text(value: float) -> str:
    """A number as short as it can be without being another one."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def cost(case: Case) -> float:
    """Rough work of a case: simulated time over the period, weighed by the robot's size."""
    model = load_model(case.robot)
    experiment = case.experiment(model)
    return experiment.duration / experiment.period * (10 + model.nv)


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def safe(text: str) -> str:
    """`text` as one path component; a path or a class keeps its last words and gains a hash."""
    if re.fullmatch(r"[A-Za-z0-9_-]+", text):
        return text
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(text).name)
    return f"{stem}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _path(folder: Path, kind: str, case: Case) -> Path:
    root, suffix = {
        "log": ("runs", "npz"), "result": ("runs", "json"), "times": ("times", "json"),
    }[kind]  # fmt: skip
    return folder / root / f"{case.name}.{suffix}"
