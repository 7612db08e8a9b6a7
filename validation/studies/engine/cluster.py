"""Jobs on the workers of a dask.distributed cluster, which may join and leave at any time.

Jobs go directly to `distributed`, because joblib's backend for it (joblib 1.6) never returns if a
job fails when its worker dies.
"""

from __future__ import annotations

import time
import uuid
import warnings
from collections.abc import Iterator
from typing import Any

from softdyn import InputError, SoftdynError
from softdyn.exceptions import one_line
from softdyn.validation.studies.engine import fingerprint, worker
from softdyn.validation.studies.engine.executors import DIED
from softdyn.validation.studies.engine.store import Executor
from softdyn.validation.studies.engine.worker import CaseJob, CaseResult

GONE = "--scheduler: the scheduler was lost; repeat the command to continue where it stopped"
CONNECT = 10.0  # s
IN_FLIGHT = 1000  # jobs at a scheduler at a time; more would only slow it down
PATIENCE = 5.0  # s without any worker before a message


class ClusterError(SoftdynError):
    """The scheduler was lost; finished results are kept."""


def cluster(address: str) -> Executor:
    """The workers of the dask.distributed scheduler at tcp://HOST:PORT; they may join and leave.

    Raises
    ------
    InputError
        `distributed` is not installed, no scheduler answers, or workers have other code.
    """
    try:
        from distributed import Client
    except ImportError:
        expected = "the extra softdyn[cluster] (pip install distributed)"
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

    def execute(order: list[CaseJob]) -> Iterator[tuple[int, CaseResult]]:
        with client:
            contents = _contents(client, order)
            suspects: list[int] = []
            for index, result in _submit(client, dict(enumerate(order)), contents, IN_FLIGHT):
                if isinstance(result, CaseResult):
                    yield index, result
                else:
                    suspects.append(index)
            # a job whose workers died may only have been queued behind the job that killed them
            for index in suspects:
                ((_, result),) = _submit(client, {index: order[index]}, contents, 1)
                if not isinstance(result, CaseResult):
                    result = worker.not_run(result)
                yield index, result

    return execute


def _check_workers(client: Any) -> None:
    """Refuse workers with other code; a worker that joins later refuses its jobs itself."""
    for where, found in client.run(_worker_code, on_error="return").items():
        if isinstance(found, OSError):  # it has left
            continue
        if found != fingerprint.code():
            expected = "workers with this softdyn and these versions of its engines"
            got = one_line(found) if isinstance(found, BaseException) else "others"
            raise InputError("--scheduler", expected, f"{got} on {where}")


def _worker_code() -> str:
    return fingerprint.code()


def _contents(client: Any, order: list[CaseJob]) -> Any:
    """The user's own files as a job of the cluster: sent once, and repeated if it is lost."""
    files = {
        s
        for job in order
        for s in (
            job.robot,
            job.controller,
            job.trajectory,
            *job.forces,
            *dict(job.options).values(),
        )
        if s is not None
    }
    found = {part for source in files for part in source.parts}
    contents = {sha: data for s in found if s.own for sha, data in s.contents().items()}
    return client.submit(dict, contents, key=f"files-{uuid.uuid4()}") if contents else None


def _submit(
    client: Any, order: dict[int, CaseJob], contents: Any, in_flight: int
) -> Iterator[tuple[int, CaseResult | str]]:
    """Results as they come; a text gives the reason why a job has none."""
    from distributed import as_completed

    run = f"softdyn-{uuid.uuid4()}"
    waiting = iter(order.items())
    position: dict[str, int] = {}
    done = as_completed([], loop=client.loop, with_results=True, raise_errors=False)

    def submit_next() -> None:
        for index, job in waiting:
            key = f"{run}-{index}"
            position[key] = index
            done.add(client.submit(worker.attempt, job, contents, key=key, pure=False))
            return

    for _ in range(in_flight):
        submit_next()
    while position:
        _wait(client, done)
        future, result = next(done)
        index = position.pop(future.key)
        if future.status in ("cancelled", "lost"):
            raise ClusterError(GONE)
        submit_next()
        yield index, result if future.status == "finished" else _why(result)


def _wait(client: Any, done: Any) -> None:
    """Wait for a result, with a message when there are no workers."""
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
    """The reason why a job has no result, from (type, exception, traceback)."""
    from distributed import KilledWorker

    error = failure[1] if isinstance(failure, tuple) else failure
    if isinstance(error, KilledWorker):
        return DIED
    return one_line(f"{type(error).__name__}: {error}", 500)
