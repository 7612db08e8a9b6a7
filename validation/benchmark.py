"""The paper's grid of experiments: one file a case, resumable, the same whatever runs it.

A case is a robot, a controller and an experiment. Its result lies in three files below the
output folder: ``runs/CASE.npz``, the log without its step times; ``runs/CASE.json``, the figures,
written last, with a fingerprint of everything that they depend on; and ``times/CASE.json``, the
step times, the only part of a run that is not the same twice.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config

import softdyn
from controllers import find_controller
from softdyn import SoftModel
from validation import metrics, paper
from validation.closed_loop import simulate
from validation.files import write_json

# the modules of this package that decide a run's numbers; tables and plots do not
RUN_BY = ("benchmark", "bodies", "closed_loop", "log", "metrics", "paper", "twin")
ENGINES = ("pin", "mujoco", "proxsuite", "numpy", "scipy")


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
        parts = (_safe(self.robot), _safe(self.controller), f"{self.kind}_{self.value:g}")
        return "/".join(parts)

    def experiment(self, model: SoftModel) -> paper.Experiment:
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
    """Every robot × controller × experiment, robots and controllers in the order given."""
    runs = [("set_point", theta) for theta in thetas] + [("tracking", omega) for omega in omegas]
    controllers = tuple(controllers)
    return [Case(r, c, kind, value) for r in robots for c in controllers for kind, value in runs]


def run_grid(cases: list[Case], folder: Path, jobs: int = -1) -> Iterator[tuple[Case, bool]]:
    """Run what is missing or out of date below `folder`; yields (case, whether it was run).

    Cases come as they finish, the ones that need no run first. Nothing depends on `jobs`.

    Raises
    ------
    InputError
        An unknown robot or controller, before anything runs.
    """
    prints = {case: fingerprint(case) for case in cases}
    fresh = [case for case in cases if load_result(case, folder, prints[case]) is not None]
    yield from ((case, False) for case in fresh)
    # the longest first, so that no core idles at the end
    missing = sorted(set(cases) - set(fresh), key=_cost, reverse=True)
    with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
        runs = Parallel(return_as="generator_unordered")(
            delayed(run_case)(case, folder, prints[case]) for case in missing
        )
        yield from ((case, True) for case in runs)


def run_case(case: Case, folder: Path, print_: str) -> Case:
    """Run one case and write its files, the result last; engines are built here."""
    model = _load(case.robot)
    experiment = case.experiment(model)
    controller = find_controller(case.controller)(model)
    log = simulate(model, controller, experiment, name=case.controller)
    result = {
        "fingerprint": print_,
        **asdict(case),
        "final_error_cm": metrics.final_error_cm(log),
        "mse_cm2": metrics.mse_cm2(log),
        "second_cycle_mse_cm2": metrics.second_cycle_mse_cm2(log) if log.omega else None,
        "failed": log.failed,
        "reason": log.reason,
        "steps": log.steps,
        "simulated_s": float(log.t[-1]),
        "not_solved": log.not_solved,
        "fallbacks": log.fallbacks,
        "max_bound_violation": log.max_bound_violation,
    }
    paths = {kind: _path(folder, kind, case) for kind in ("log", "result", "times")}
    for path in paths.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    replace(log, step_us=np.full_like(log.step_us, np.nan)).save(paths["log"])
    write_json(paths["times"], {**metrics.step_times_us(log)})
    write_json(paths["result"], result)
    return case


def load_result(case: Case, folder: Path, print_: str | None = None) -> dict[str, Any] | None:
    """The figures of a case; None when it has none, or not of this fingerprint."""
    try:
        result = json.loads(_path(folder, "result", case).read_text())
    except (OSError, ValueError):
        return None
    fits = isinstance(result, dict) and print_ in (None, result.get("fingerprint"))
    return result if fits and _path(folder, "log", case).is_file() else None


def load_times(case: Case, folder: Path) -> dict[str, float | None]:
    """Step times of a case (µs): median, p99, p999, max."""
    return json.loads(_path(folder, "times", case).read_text())


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
        median = load_times(case, folder)["median"]
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
    results = [load_result(case, folder) or {} for case in cases]
    by_kind = {
        kind: [_number(r[figure]) for r in results if r.get("kind") == kind]
        for kind, figure in (("set_point", "final_error_cm"), ("tracking", "mse_cm2"))
    }
    second = [_number(r["second_cycle_mse_cm2"]) for r in results if r.get("kind") == "tracking"]
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
            if r.get("failed")
        ],
        "set_points_cm": {
            f"{r['value']:g}": r["final_error_cm"] for r in _of(results, "set_point")
        },
        "trajectories_cm2": {f"{r['value']:g}": r["mse_cm2"] for r in _of(results, "tracking")},
        "not_solved": sum(r["not_solved"] for r in results),
        "fallbacks": sum(r["fallbacks"] for r in results),
        "max_bound_violation": max(r["max_bound_violation"] for r in results),
        "paper": None if published is None else asdict(published),
    }


def _of(results: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [result for result in results if result.get("kind") == kind]


def fingerprint(case: Case) -> str:
    """A hash of all that a case's figures depend on.

    The robot's file, the experiment, the controller's gains and file, softdyn's own code, and the
    versions of the engines.
    """
    model = _load(case.robot)
    controller = find_controller(case.controller)
    own = Path(case.controller.rpartition(":")[0])
    parts = (
        asdict(case),
        repr(paper.setup_of(model)),
        hashlib.sha256(model.robot.path.read_bytes()).hexdigest(),
        repr(getattr(controller(model), "gains", None)),
        hashlib.sha256(own.read_bytes()).hexdigest() if own.is_file() else None,
        _code(),
    )
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@cache
def _code() -> str:
    """A hash of the packages that make a run, and of the engines' versions."""
    digest = hashlib.sha256()
    own = Path(__file__).resolve().parent
    paths = [*(own.parent / "softdyn").glob("*.py"), *(own.parent / "controllers").glob("*.py")]
    for path in sorted([*paths, *(own / f"{name}.py" for name in RUN_BY)]):
        digest.update(path.name.encode() + path.read_bytes())
    digest.update(repr([(name, version(name)) for name in ENGINES]).encode())
    return digest.hexdigest()


@cache
def _load(robot: str) -> SoftModel:
    return softdyn.load(robot)


def _cost(case: Case) -> float:
    """Rough work of a case: simulated time over the period, weighed by the robot's size."""
    model = _load(case.robot)
    experiment = case.experiment(model)
    return experiment.duration / experiment.period * (10 + model.nv)


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def _safe(text: str) -> str:
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
