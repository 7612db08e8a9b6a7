"""Running a sweep: what is missing, on the local cores or on a cluster, one result file a case.

Workers hand their results back and this process writes them, each file whole or not at all: a
cluster needs no folder in common, and what a killed worker had not handed back is done by another.

On a cluster tasks go to `distributed` itself: joblib's backend for it never returns when a task is
given up because its worker died (joblib 1.6).
"""

from __future__ import annotations

import hashlib
import json
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftdynError
from softdyn.exceptions import one_line
from softdyn.validation.files import atomic, write_json
from softdyn.validation.processes import WorkerKilled, in_processes
from softdyn.validation.studies import sweep_case
from softdyn.validation.studies.sweep import Case, Sweep
from softdyn.validation.studies.sweep_case import Answer, Source, Task

OUTCOMES = ("done", "failed", "raised", "not_run")
DIED = "its worker process died"
GONE = "--scheduler: it went away before the end; call again to go on where it stopped"
CONNECT = 10.0  # s
IN_FLIGHT = 1000  # tasks at a scheduler at a time; more only makes it slow
PATIENCE = 5.0  # s without any worker before saying so

# Yields (position in the list, answer) as tasks end, in any order.
Executor = Callable[[list[Task]], Iterator[tuple[int, Answer]]]


class ClusterError(SoftdynError):
    """The scheduler went away; what was done is kept."""


# -- what is to be done ----------------------------------------------------------------------------


def tasks(sweep: Sweep) -> list[Task]:
    """Every case with what it depends on, in the sweep's order."""
    return [_task(sweep, case) for case in sweep.cases]


def _task(sweep: Sweep, case: Case) -> Task:
    robot, controller = sweep.robots[case.robot], sweep.controllers[case.controller]
    parts = (case.name, robot.files, controller and controller.files, sweep_case.code())
    return Task(case, robot, controller, _hash(parts), sweep_case.code(), sweep.logs)


def _hash(parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def missing(all_tasks: Iterable[Task], folder: Path) -> list[Task]:
    """Tasks without an up-to-date result below `folder`."""
    return [task for task in all_tasks if load(task, folder) is None]


def run(sweep: Sweep, todo: list[Task], folder: Path, executor: Executor) -> Iterator[Answer]:
    """Run tasks and write their files below `folder`; yields the answers as they come.

    Raises
    ------
    InputError
        When a file cannot be written.
    ClusterError
        When the scheduler went away.
    """
    # the longest first, so that no core idles at the end
    order = sorted(todo, key=lambda task: _cost(sweep, task.case), reverse=True)
    with closing(executor(order)) as answers:  # type: ignore[type-var]
        for index, answer in answers:
            write(order[index], answer, folder)
            yield answer


def _cost(sweep: Sweep, case: Case) -> float:
    """Rough work of a case: its control steps, weighed by the robot's size."""
    return case.duration / case.period * (10 + sweep.models[case.robot].nv)


# -- files -----------------------------------------------------------------------------------------


def result_path(case: Case, folder: Path) -> Path:
    """Where the result of a case lies."""
    return folder / "cases" / f"{case.name}.json"


def log_path(case: Case, folder: Path) -> Path:
    """Where the log of a case lies."""
    return folder / "cases" / f"{case.name}.npz"


def write(task: Task, answer: Answer, folder: Path) -> None:
    """Write a case's files, the result last."""
    path = result_path(task.case, folder)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(str(path.parent), "a folder to write to", error.strerror) from None
    if answer.log is not None:
        with atomic(log_path(task.case, folder)) as file:
            file.write(answer.log)
    write_json(path, answer.result)


def load(task: Task, folder: Path) -> dict[str, Any] | None:
    """The result of a case; None when it has none of this fingerprint."""
    result = load_any(task.case, folder)
    if result is None or result["fingerprint"] != task.fingerprint:
        return None
    ran = result["outcome"] in ("done", "failed")
    return None if task.logs and ran and not log_path(task.case, folder).is_file() else result


def load_any(case: Case, folder: Path) -> dict[str, Any] | None:
    """The result of a case, up to date or not; None without a readable one."""
    try:
        result = json.loads(result_path(case, folder).read_bytes())
    except (OSError, ValueError):
        return None
    whole = isinstance(result, dict) and result.get("outcome") in OUTCOMES
    return result if whole and "fingerprint" in result else None


# -- the local cores -------------------------------------------------------------------------------


def local(jobs: int) -> Executor:
    """Processes of this machine, each with one thread; -1 is one per core."""

    def execute(order: list[Task]) -> Iterator[tuple[int, Answer]]:
        left = dict(enumerate(order))
        while left:
            sent: list[int] = []
            try:
                for index, answer in in_processes(_numbered, _feed(left, sent), jobs):
                    del left[index]
                    yield index, answer
            except WorkerKilled:
                # one of those under way killed its process: each gets a process of its own
                for index in [i for i in sent if i in left]:
                    yield index, _alone(left.pop(index))

    return execute


def _feed(left: dict[int, Task], sent: list[int]) -> Iterator[tuple[int, Task]]:
    for call in list(left.items()):
        sent.append(call[0])
        yield call


def _numbered(index: int, task: Task) -> tuple[int, Answer]:
    return index, sweep_case.run(task)


def _alone(task: Task) -> Answer:
    """Run a task that may kill its process; with two of them, for one would be this process."""
    try:
        ((_, answer),) = in_processes(_numbered, [(0, task)], 2)
    except WorkerKilled:
        return sweep_case.not_run(task, DIED)
    return answer


# -- a cluster -------------------------------------------------------------------------------------


def cluster(address: str) -> Executor:
    """The workers of the dask.distributed scheduler at tcp://HOST:PORT, whoever comes and goes.

    Raises
    ------
    InputError
        Without `distributed`, without a scheduler there, and with workers of other code.
    """
    try:
        from distributed import Client
    except ImportError:
        expected = "softdyn's extra: pip install 'softdyn[cluster]'"
        raise InputError("--scheduler", expected, "no dask.distributed") from None
    try:
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        expected = f"a dask scheduler that answers within {CONNECT:g} s"
        raise InputError("--scheduler", expected, f"{address}: {error}") from None
    try:
        _check_workers(client)
    except BaseException:
        client.close()
        raise

    def execute(order: list[Task]) -> Iterator[tuple[int, Answer]]:
        with client:
            contents = _contents(client, order)
            suspects: list[int] = []
            for index, answer in _submit(client, dict(enumerate(order)), contents, IN_FLIGHT):
                if isinstance(answer, Answer):
                    yield index, answer
                else:
                    suspects.append(index)
            # a task whose workers died may only have waited behind the one that killed them
            for index in suspects:
                ((_, answer),) = _submit(client, {index: order[index]}, contents, 1)
                if not isinstance(answer, Answer):
                    answer = sweep_case.not_run(order[index], answer)
                yield index, answer

    return execute


def _check_workers(client: Any) -> None:
    """Refuse workers that would compute something else; a later one refuses by itself."""
    for worker, found in client.run(_worker_code, on_error="return").items():
        if isinstance(found, OSError):  # it left
            continue
        if found != sweep_case.code():
            expected = "workers with this softdyn and these versions of its engines"
            got = one_line(found) if isinstance(found, BaseException) else "others"
            raise InputError("--scheduler", expected, f"{got} on {worker}")


def _worker_code() -> str:
    return sweep_case.code()


def _contents(client: Any, order: list[Task]) -> Any:
    """The user's own files as a task of the cluster: sent once, made again where it got lost."""
    found = {s for task in order for s in (task.robot, task.controller) if s is not None}
    contents: dict[str, bytes] = {}
    for source in found:
        if source.own:
            contents |= _content(source)
    return client.submit(_keep, contents, key=f"files-{uuid.uuid4()}") if contents else None


def _content(source: Source) -> dict[str, bytes]:
    folder = Path(source.path).parent
    try:
        return {sha256: (folder / name).read_bytes() for name, sha256 in source.files}
    except OSError as error:
        raise InputError(source.text, "a readable file", error.strerror) from None


def _keep(contents: dict[str, bytes]) -> dict[str, bytes]:
    return contents


def _submit(
    client: Any, order: dict[int, Task], contents: Any, in_flight: int
) -> Iterator[tuple[int, Answer | str]]:
    """Answers as they come; a text is why a task has none."""
    from distributed import as_completed

    run = f"softdyn-{uuid.uuid4()}"
    waiting = iter(order.items())
    position: dict[str, int] = {}
    done = as_completed([], loop=client.loop, with_results=True, raise_errors=False)

    def submit_next() -> None:
        for index, task in waiting:
            key = f"{run}-{index}"
            position[key] = index
            done.add(client.submit(sweep_case.run, task, contents, key=key, pure=False))
            return

    for _ in range(in_flight):
        submit_next()
    while position:
        _wait(client, done)
        future, answer = next(done)
        index = position.pop(future.key)
        if future.status in ("cancelled", "lost"):
            raise ClusterError(GONE)
        submit_next()
        yield index, answer if future.status == "finished" else _why(answer)


def _wait(client: Any, done: Any) -> None:
    """Wait for an answer; say so when nobody is there to give one."""
    asked = busy = time.monotonic()
    told = False
    while not done.has_ready():
        if client.status != "running":
            raise ClusterError(GONE)
        now = time.monotonic()
        if now - asked > 1.0:
            asked = now
            try:
                workers = client.nthreads()
            except OSError:
                raise ClusterError(GONE) from None
            if workers:
                busy = now
            elif not told and now - busy > PATIENCE:
                told = True
                warnings.warn("the cluster has no workers; waiting for one", stacklevel=2)
        time.sleep(0.005)


def _why(failure: Any) -> str:
    """Why a task has no answer, from (type, exception, traceback)."""
    from distributed import KilledWorker

    error = failure[1] if isinstance(failure, tuple) else failure
    if isinstance(error, KilledWorker):
        return DIED
    return one_line(f"{type(error).__name__}: {error}", 500)
