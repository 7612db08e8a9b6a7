"""One case, run in any process on any machine.

Jobs and results are plain data. A worker needs softdyn and no shared folder; the user's own files
are sent along.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import SoftdynError, SoftModel
from softdyn.controllers import Mpc
from softdyn.controllers.registry import find_controller, make_controller
from softdyn.controllers.staged import Best
from softdyn.exceptions import OwnCodeError, one_line
from softdyn.validation.loop import setups
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.recorded import MOTION, motion_of
from softdyn.validation.loop.repeat import whole_record
from softdyn.validation.loop.trajectories import Trajectory
from softdyn.validation.studies.engine import case as cases_
from softdyn.validation.studies.engine import fingerprint, sources
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.sources import NotHere, Source


@dataclass(frozen=True)
class CaseJob:
    """A case with everything that a worker needs to run it, and a store to keep it.

    Attributes
    ----------
    case : Case
    name : str
        Path of its files below a store's folder, without a suffix.
    robot, controller, trajectory : Source
        Their files; None for a controller of the package, and without a trajectory of one's own.
    forces : tuple of Source
        The files of its forces.
    options : tuple of (str, Source)
        The files that the case's options name.
    simulated : float
        Length of the run (s).
    cost : float
        Rough cost, for the order of jobs: control steps, weighted by the robot's size.
    fingerprint, code : str
        Hashes: of everything on which the run depends, and only of softdyn and the engines. Two
        jobs have the same fingerprint if their controllers are the same one by two names.
    log : bool
        Whether the whole run is kept.
    """

    case: Case
    name: str
    robot: Source
    controller: Source | None
    trajectory: Source | None
    forces: tuple[Source, ...]
    options: tuple[tuple[str, Source], ...]
    simulated: float
    cost: float
    fingerprint: str
    code: str
    log: bool


@dataclass(frozen=True)
class CaseResult:
    """The result of a job.

    Attributes
    ----------
    figures : dict
        The end of the run (``outcome``: done, failed, raised, not_run; ``reason``), and its
        figures.
    log : bytes, optional
        Content of the log's file, without step times, because these are not reproducible.
    step_us : dict
        The step times (µs).
    trace : str
        The traceback of an error in a user's own code.
    record : dict
        The run's `whole_record`, and the digest of its motion; none of a run that did not end.
    """

    figures: dict[str, Any]
    log: bytes | None = None
    step_us: Mapping[str, float | None] = field(default_factory=dict, compare=False)
    trace: str = field(default="", compare=False)
    record: Mapping[str, Any] = field(default_factory=dict, compare=False)


def jobs_of(
    cases: Sequence[Case],
    *,
    names: Sequence[str] | None = None,
    folder: Path = Path(),
    depends: Sequence[str] = (),
    log: bool = False,
) -> list[CaseJob]:
    """A job for every case, with its dependencies.

    Parameters
    ----------
    cases : sequence of Case
    names : sequence of str, optional
        `CaseJob.name` of each job; by default the case's name.
    folder : Path
        Relative paths of robots, controllers and trajectories are relative to it.
    depends : sequence of str
        Files that classes of one's own read. A case of such a class runs again where one changed.
    log : bool
        Whether the whole runs are kept.

    Raises
    ------
    InputError, UrdfError
        A robot, a controller or an experiment cannot be used.
    """
    asked = dict.fromkeys((case.robot, case.annotations) for case in cases)
    robots = {pair: sources.of_robot(pair[0], folder, pair[1]) for pair in asked}
    controllers = dict.fromkeys(case.controller for case in cases if case.law is None)
    own = {name: sources.of_controller(name, folder, depends) for name in controllers}
    paths = dict.fromkeys(case.value for case in cases if case.kind in cases_.OWN)
    trajectories = {text: sources.of_trajectory(text, folder, depends) for text in paths}

    names_of_forces = dict.fromkeys(name for case in cases for name in case.forces)
    forces = {name: sources.of_force(name, folder, depends) for name in names_of_forces}

    asked_files = dict.fromkeys(pair for case in cases for pair in files_of(case))
    named = {pair: sources.of_option(*pair, folder, depends) for pair in asked_files}

    @cache
    def path_of(robot: tuple[str, str | None], kind: str, text: str) -> Trajectory:
        return sources.trajectory_of(trajectories[text], kind, robots[robot][1], {})

    same: dict[str, bool] = {}

    def of_run(case: Case, model: SoftModel) -> Case:
        """The case, or the one of another controller that has the same run."""
        other = case.law or case.target or case.forces
        if case.controller != Best.name or case.kind != "tracking" or other:
            return case
        key = repr((case.robot, case.annotations, case.parameters))
        if key not in same:
            same[key] = _same_on_path(model, case.parameters)
        return replace(case, controller=Mpc.name) if same[key] else case

    code = fingerprint.code()
    found = []
    for case, name in zip(cases, names or [case.name for case in cases], strict=True):
        robot, model = robots[case.robot, case.annotations]
        controller = own.get(case.controller)
        source = trajectories[case.value] if case.kind in cases_.OWN else None
        files = [part.files for part in robot.parts]
        files += [source.files] if source else []
        options = tuple((key, named[key, text]) for key, text in files_of(case))
        files += [one.files for _, one in options]
        own_forces = tuple(forces[one] for one in case.forces)
        files += [one.files for one in own_forces]
        parts = (files, controller and controller.files, setups.setup_of(model))
        mark = fingerprint.fingerprint(of_run(case, model), *parts)
        path = path_of((case.robot, case.annotations), case.kind, case.value) if source else None
        grid = case.grid(model, path)
        cost = grid.duration / grid.period * (10 + model.nv)
        found.append(CaseJob(
            case, name, robot, controller, source, own_forces, options, grid.duration, cost, mark,
            code, log,
        ))  # fmt: skip
    return found


def _same_on_path(model: SoftModel, parameters: Any) -> bool:
    """Whether ``best`` follows a path as ``mpc`` does: without a schedule, and without buckling."""
    made = make_controller(Best.name, model, parameters)
    return isinstance(made, Mpc) and not made.buckles


def run(job: CaseJob, contents: Mapping[str, bytes] | None = None) -> CaseResult:
    """Run one case.

    Parameters
    ----------
    job : CaseJob
    contents : mapping, optional
        SHA-256 → content of the user's own files, for a machine without these files.

    Raises
    ------
    NotHere
        This worker cannot run it.
    SoftdynError
        The case has a defect, or a user's own code raised an exception: an `OwnCodeError`.
    """
    with redirect_stdout(sys.stderr):  # prints of a user's code must not mix with our output
        return _case_result(job, _prepare(job, contents or {})())


def attempt(job: CaseJob, contents: Mapping[str, bytes] | None = None) -> CaseResult:
    """Call `run`; an error becomes a part of the result."""
    with redirect_stdout(sys.stderr):
        try:
            loop = _prepare(job, contents or {})
        except Exception as error:
            return not_run(_reason(error))
        try:
            return _case_result(job, loop())
        except (MemoryError, OSError) as error:  # an error of this machine, not of the case
            return not_run(_reason(error))
        except Exception as error:
            trace = error.trace if isinstance(error, OwnCodeError) else ""
            return replace(_without_figures("raised", _reason(error)), trace=trace)


def not_run(reason: str) -> CaseResult:
    """The result of a case that no worker could run; it is tried again the next time."""
    return _without_figures("not_run", reason)


def _prepare(job: CaseJob, contents: Mapping[str, bytes]) -> Callable[[], Log]:
    """The closed loop of a job, on this machine."""
    if job.code != fingerprint.code():
        raise NotHere("this worker has another softdyn, or another version of an engine")
    case, source = job.case, job.controller
    classes = {one.text: sources.class_of(one, contents) for one in job.forces}
    bare = sources.model_of(job.robot, contents)
    model = sources.forced(bare, case.forces, case.force, classes.__getitem__)
    if case.law is None:
        cls = sources.class_of(source, contents) if source else find_controller(case.controller)
        make = partial(make_controller, case.controller, model, case.parameters, cls)
    else:
        make = partial(case.law, case.controller, model)
    path = None
    if job.trajectory is not None:
        path = sources.trajectory_of(job.trajectory, case.kind, model, contents)
    files = {key: sources.option_of(s, key, model, contents) for key, s in job.options}
    return lambda: cases_.run(case, model, make, path, files)


def files_of(case: Case) -> list[tuple[str, str]]:
    """The options of a case that name a file, with its name."""
    values = ((key, case.options.get(key)) for key in cases_.FILES)
    return [(key, x) for key, x in values if isinstance(x, str) and sources.is_file(key, x)]


def _case_result(job: CaseJob, log: Log) -> CaseResult:
    figures = cases_.figures(job.case, log)
    step_us = figures.pop("step_us")
    outcome = {"outcome": "failed" if log.failed else "done"}
    record = {"record": whole_record(log), MOTION: motion_of(log)}
    return CaseResult(outcome | figures, _npz(log) if job.log else None, step_us, record=record)


def _without_figures(outcome: str, reason: str) -> CaseResult:
    figures = ("final_error_cm", "mse_cm2", "second_cycle_mse_cm2")
    return CaseResult({"outcome": outcome, "reason": reason} | dict.fromkeys(figures))


def _npz(log: Log) -> bytes:
    timeless = log.altered(step_us=np.full_like(log.step_us, np.nan))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.npz"
        timeless.save(path)
        return path.read_bytes()


def _reason(error: BaseException) -> str:
    if isinstance(error, SoftdynError):
        return one_line(error, 500)
    return one_line(f"{type(error).__name__}: {error}", 500)
