"""One case of a sweep, run by whichever process and machine has a hand free.

What comes in and goes out is plain data, so that a worker needs softdyn and nothing else: no folder
in common, and of the user's own files only what is sent along.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError, SoftModel
from softdyn.controllers import CONTROLLERS, Gains, find_controller
from softdyn.controllers.registry import own_error
from softdyn.description import library as catalogue
from softdyn.exceptions import one_line
from softdyn.validation.loop.closed_loop import simulate
from softdyn.validation.loop.log import Log
from softdyn.validation.studies import paper
from softdyn.validation.studies.fingerprint import _code as code_of_packages
from softdyn.validation.studies.fingerprint import digest
from softdyn.validation.studies.sweep import Case, Source

# Models and classes are built once a thread: a SoftModel's scratch memory is not for two.
_kept = threading.local()


@dataclass(frozen=True)
class Task:
    """A case with all that a worker needs to run it."""

    case: Case
    robot: Source
    controller: Source | None
    fingerprint: str
    code: str
    logs: bool


@dataclass(frozen=True)
class Answer:
    """What came of a task: the content of its result file, and of its log file if it has one."""

    result: dict[str, Any]
    log: bytes | None = None


class NotHere(Exception):
    """This worker cannot run the case, and another one might."""


@cache
def code() -> str:
    """A hash of the code and the engines' versions that a case's figures depend on."""
    own = (Path(__file__), Path(__file__).with_name("sweep.py"))
    parts = [code_of_packages(), *(digest(path) for path in own)]
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def run(task: Task, contents: Mapping[str, bytes] | None = None) -> Answer:
    """Run one case; whatever goes wrong is in the answer.

    Parameters
    ----------
    task : the case.
    contents : SHA-256 → content of the user's own files, for a machine that does not have them.
    """
    # what a user's code prints is not part of a command's output
    with redirect_stdout(sys.stderr):
        try:
            if task.code != code():
                raise NotHere("this worker has another softdyn, or another version of an engine")
            model, build = _prepare(task, contents or {})
        except Exception as error:
            return not_run(task, _reason(error))
        return _closed_loop(task, model, build)


def not_run(task: Task, reason: str) -> Answer:
    """The answer for a case that no worker could run; it is tried again the next time."""
    return Answer(_result(task, "not_run", reason) | {"fingerprint": None})


def _closed_loop(
    task: Task, model: SoftModel, build: Callable[[], Callable[..., Any]]
) -> Answer:  # fmt: skip
    case = task.case
    try:
        log = simulate(
            model,
            build(),
            case.experiment(model),
            duration=case.duration,
            period=case.period,
            timestep=case.timestep,
            contacts=case.contacts,
            friction=case.friction,
            name=case.controller,
        )
    except (MemoryError, OSError) as error:  # of this machine, not of the case
        return not_run(task, _reason(error))
    except (Exception, SystemExit) as error:  # a user's code may raise anything
        if task.controller is not None and not isinstance(error, softdyn.SoftdynError):
            name = Path(task.controller.text).name
            error = own_error(name, "a command", error)  # type: ignore[arg-type]
        return Answer(_result(task, "raised", _reason(error)))
    figures = {
        "final_error_cm": log.final_error_cm,
        "mse_cm2": log.mse_cm2,
        "second_cycle_mse_cm2": _second_cycle(log),
        "steps": log.steps,
        "simulated_s": float(log.t[-1]),
        "not_solved": log.not_solved,
        "fallbacks": log.fallbacks,
        "max_bound_violation": log.max_bound_violation,
    }
    result = _result(task, "failed" if log.failed else "done", log.reason) | figures
    return Answer(result, _npz(log) if task.logs else None)


def _result(task: Task, outcome: str, reason: str | None) -> dict[str, Any]:
    """The content of a result file; no figure yet."""
    return {
        "fingerprint": task.fingerprint,
        "inputs": asdict(task.case),
        "outcome": outcome,
        "reason": reason,
        "final_error_cm": None,
        "mse_cm2": None,
        "second_cycle_mse_cm2": None,
    }


def _second_cycle(log: Log) -> float | None:
    try:
        return paper.second_cycle_mse_cm2(log)
    except InputError:  # no two whole cycles
        return None


def _npz(log: Log) -> bytes:
    """The log's file, without step times: they are not the same twice."""
    timeless = replace(log, step_us=np.full_like(log.step_us, np.nan))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.npz"
        timeless.save(path)
        return path.read_bytes()


# -- robots and controllers, once a thread ---------------------------------------------------------


def _prepare(
    task: Task, contents: Mapping[str, bytes]
) -> tuple[SoftModel, Callable[[], Callable[..., Any]]]:
    """The model, and how to build the controller."""
    case = task.case
    models = _kept.__dict__.setdefault("models", {})
    # a bundled robot is another one than a user's copy of its file
    key = (task.robot.own, task.robot.files)
    if key not in models:
        models[key] = softdyn.load(_find_robot(task.robot, contents))
    model = models[key]
    if task.controller is None:
        cls, gains = CONTROLLERS[case.controller], Gains(**(case.gains or {}))
        return model, lambda: cls(model, gains)
    own = _own_class(task.controller, contents)
    if case.gains is None:
        return model, lambda: own(model)
    return model, lambda: own(model, dict(case.gains or {}))


def _find_robot(source: Source, contents: Mapping[str, bytes]) -> str | Path:
    if source.own:
        return _own_file(source, contents)
    if digest(catalogue.find(source.text)) != source.files[0][1]:
        raise NotHere(f"this worker has another {source.text}")
    return source.text


def _own_class(source: Source, contents: Mapping[str, bytes]) -> Callable[..., Any]:
    kind = source.text.rpartition(":")[2]
    classes = _kept.__dict__.setdefault("classes", {})
    if (source.files, kind) not in classes:
        path = _own_file(source, contents)
        _forget_modules(source, path.parent)
        classes[source.files, kind] = find_controller(f"{path}:{kind}")
    return classes[source.files, kind]


def _forget_modules(source: Source, folder: Path) -> None:
    """Import a user's files anew: a worker may have met other versions of them."""
    for name, _ in source.files:
        parts = Path(name).with_suffix("").parts
        sys.modules.pop(".".join(parts[:-1] if parts[-1] == "__init__" else parts), None)
    while str(folder) in sys.path:  # it is put first when the class is imported
        sys.path.remove(str(folder))
    importlib.invalidate_caches()


def _own_file(source: Source, contents: Mapping[str, bytes]) -> Path:
    """The user's main file: where it lies, or a copy of what was sent along."""
    path = Path(source.path)
    if all(_is(path.parent / name, sha256) for name, sha256 in source.files):
        return path
    if not all(sha256 in contents for _, sha256 in source.files):
        raise NotHere(f"{source.text} changed after the sweep began")
    if not hasattr(_kept, "folder"):
        _kept.folder = tempfile.TemporaryDirectory(prefix="softdyn-")
    mark = hashlib.sha256(repr(source.files).encode()).hexdigest()[:16]
    for name, sha256 in source.files:
        copy = Path(_kept.folder.name) / mark / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(contents[sha256])
    return Path(_kept.folder.name) / mark / source.files[0][0]


def _is(path: Path, sha256: str) -> bool:
    try:
        return digest(path) == sha256
    except OSError:
        return False


def _reason(error: BaseException) -> str:
    if isinstance(error, softdyn.SoftdynError | NotHere):
        return one_line(error, 500)
    return one_line(f"{type(error).__name__}: {error}", 500)
