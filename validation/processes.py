"""Long work in several processes, which all end together."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, redirect_stdout, suppress
from io import TextIOWrapper
from multiprocessing import resource_tracker
from threading import RLock, Thread
from types import FrameType
from typing import Any, TypeVar

from joblib import Parallel, delayed, effective_n_jobs, parallel_config
from joblib.externals.loky.backend import resource_tracker as loky_tracker
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
    KeyboardInterrupt
        Ctrl-C; all workers have ended.
    """
    if effective_n_jobs(jobs) == 1:
        for call in calls:
            yield _work(function, call)
        return
    start = {"initializer": _begin, "initargs": (os.getpid(), os.getcwd())}
    with _Interrupt() as interrupt:
        try:
            with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1, **start):
                with _quiet_start():
                    results = Parallel(return_as="generator_unordered")(
                        delayed(_work)(function, call) for call in calls
                    )
                interrupt.kill_if_heard()  # also workers that had only begun to start
                yield from results
        except BrokenProcessPool:
            if not interrupt.heard:
                raise WorkerKilled(
                    "a process was killed, or ran out of memory: repeat the command to continue "
                    "where it stopped"
                ) from None
        if interrupt.heard:
            raise KeyboardInterrupt


class _Interrupt:
    """Ctrl-C kills the workers, and then raises KeyboardInterrupt at one defined place.

    An exception from the signal handler itself could come anywhere inside joblib, and leave workers
    that nobody ends.
    """

    def __init__(self) -> None:
        self.heard = False
        self._before: Any = None

    def __enter__(self) -> _Interrupt:
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            self._before = signal.signal(signal.SIGINT, self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _hear(self, _number: int, _frame: FrameType | None) -> None:
        self.heard = True
        self.kill_if_heard()

    def kill_if_heard(self) -> None:
        """After Ctrl-C, kill all workers; joblib then reports a broken pool."""
        workers = multiprocessing.active_children() if self.heard else []
        for worker in workers:
            if type(worker).__module__.startswith("joblib.") and worker.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGKILL)


@contextmanager
def _quiet_start() -> Iterator[None]:
    """Start processes that do not hear Ctrl-C, which a terminal sends to all of them."""
    _start_trackers()  # first: to start one unblocks the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # workers inherit it
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_trackers() -> None:
    """Start the trackers of shared resources without stderr.

    They outlive this process, and would write to it after the last line.
    """
    with open(os.devnull, "w") as nothing, suppress(OSError):  # this process may have no stderr
        shown = os.dup(2)
        os.dup2(nothing.fileno(), 2)
        try:
            resource_tracker.ensure_running()
            loky_tracker.ensure_running()
        finally:
            os.dup2(shown, 2)
            os.close(shown)


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
    # processes share it: with PYTHONUNBUFFERED, print would write a line and its end separately
    if isinstance(sys.stderr, TextIOWrapper):
        sys.stderr.reconfigure(line_buffering=True, write_through=False)
    os.chdir(folder)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _work(function: Callable[..., Result], call: tuple[Any, ...]) -> Result:
    with redirect_stdout(sys.stderr):  # prints of a user's controller must not mix with our output
        return function(*call)
