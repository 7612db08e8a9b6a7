"""Long work in several processes, which all end together."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import redirect_stdout
from threading import RLock, Thread
from typing import Any, TypeVar

from joblib import Parallel, delayed, parallel_config
from tqdm.auto import tqdm

from softdyn import SoftdynError

Result = TypeVar("Result")


class WorkerKilled(SoftdynError):
    """A worker process was killed; finished results are kept."""


def in_processes(
    function: Callable[..., Result], calls: Iterable[tuple[Any, ...]], jobs: int = -1
) -> Iterator[Result]:
    """Results of ``function(*call)`` as they come; one thread a process, output to stderr.

    Parameters
    ----------
    function : Callable
        The function to call.
    calls : iterable of tuple
        The arguments of each call.
    jobs : int
        How many processes, -1 for one per core; 1 does all in this process.

    Raises
    ------
    WorkerKilled
        A worker process was killed from outside.
    """
    start = {"initializer": _begin, "initargs": (os.getpid(), os.getcwd())}
    try:
        with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1, **start):
            yield from Parallel(return_as="generator_unordered")(
                delayed(_work)(function, call) for call in calls
            )
    except BrokenProcessPool:
        raise WorkerKilled(
            "a process was killed, or ran out of memory: repeat the command to continue where "
            "it stopped"
        ) from None


def in_order(
    function: Callable[..., Result], calls: Iterable[tuple[Any, ...]], jobs: int = -1
) -> list[Result]:
    """All results of `in_processes`, in the order of `calls`; a bar on a terminal."""
    order = [(index, function, call) for index, call in enumerate(calls)]
    answers = in_processes(numbered, order, jobs)
    found = dict(tqdm(answers, total=len(order), disable=None, leave=False, unit="run"))
    return [found[index] for index in range(len(order))]


def numbered(
    index: int, function: Callable[..., Result], call: tuple[Any, ...]
) -> tuple[int, Result]:
    """A result with the number of its call."""
    return index, function(*call)


def _begin(parent: int, folder: str) -> None:
    """Set up a worker: it leaves nothing behind when it is killed, and ends with its parent."""
    tqdm.set_lock(RLock())  # its own is a semaphore of the system
    os.chdir(folder)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _work(function: Callable[..., Result], call: tuple[Any, ...]) -> Result:
    with redirect_stdout(sys.stderr):  # prints of a user's controller must not mix with our output
        return function(*call)
