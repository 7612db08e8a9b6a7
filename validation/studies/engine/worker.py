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
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import SoftdynError
from softdyn.controllers.registry import find_controller, make_controller
from softdyn.exceptions import OwnCodeError, one_line
from softdyn.validation.loop import setups
from softdyn.validation.loop.log import Log
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
    robot, controller : Source
        Their files; None for a controller of the package.
    cost : float
        Rough cost, for the order of jobs.
    fingerprint, code : str
        Hashes: of everything on which the run depends, and only of softdyn and the engines.
    log : bool
        Whether the whole run is kept.
    """

    case: Case
    name: str
    robot: Source
    controller: Source | None
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
    """

    figures: dict[str, Any]
    log: bytes | None = None
    step_us: Mapping[str, float | None] = field(default_factory=dict, compare=False)
    trace: str = field(default="", compare=False)


def jobs_of(
    cases: Sequence[Case],
    *,
    names: Sequence[str] | None = None,
    folder: Path = Path(),
    log: bool = False,
) -> list[CaseJob]:
    """A job for every case, with its dependencies.

    Parameters
    ----------
    cases : sequence of Case
    names : sequence of str, optional
        `CaseJob.name` of each job; by default the case's name.
    folder : Path
        Relative paths of robots and controllers are relative to it.
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
    own = {name: sources.of_controller(name, folder) for name in controllers}
    code = fingerprint.code()
    found = []
    for case, name in zip(cases, names or [case.name for case in cases], strict=True):
        robot, model = robots[case.robot, case.annotations]
        controller = own.get(case.controller)
        files = [part.files for part in robot.parts]
        parts = (files, controller and controller.files, setups.setup_of(model))
        mark = fingerprint.fingerprint(case, *parts)
        found.append(CaseJob(case, name, robot, controller, case.cost(model), mark, code, log))
    return found


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
    model = sources.model_of(job.robot, contents)
    if case.law is None:
        cls = sources.class_of(source, contents) if source else find_controller(case.controller)
        make = partial(make_controller, case.controller, model, case.parameters, cls)
    else:
        make = partial(case.law, case.controller, model)
    return lambda: cases_.run(case, model, make)


def _case_result(job: CaseJob, log: Log) -> CaseResult:
    figures = cases_.figures(job.case, log)
    step_us = figures.pop("step_us")
    outcome = {"outcome": "failed" if log.failed else "done"}
    return CaseResult(outcome | figures, _npz(log) if job.log else None, step_us)


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
