"""Long work in a process of its own, so that a control step does not wait for it.

A thread would not do: it shares Python's lock with the control loop and makes its steps late. The
process is started by a thread, because even that takes a part of a control period. It is no worker
of `multiprocessing`, which would import the user's script again. It ends with its parent.

    softdyn process                          python -m softdyn.controllers.predictive.background
    Job(work) ── thread ── standard input  ──► the pickled work, then nothing until the parent ends
                           standard output ◄── the pickled result
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from threading import Thread
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")
POLITE = 10  # niceness of the process
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Job(Generic[Result]):
    """Work that another process does.

    Parameters
    ----------
    work : Callable[[], Result]
        It and its result can be pickled. Work that only this process can load, such as that of a
        class in the user's script, is done in a thread here.
    waits : bool
        Whether to do it at once, in this process.
    """

    def __init__(self, work: Callable[[], Result], waits: bool = False) -> None:
        self._work = work
        self._answer: Future[Result] = Future()
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled = False
        if waits:
            self._answer.set_result(work())
            return
        # a daemon, so that the program's end does not wait for it
        Thread(target=self._run, args=(work,), daemon=True).start()

    def __reduce__(self) -> tuple[Any, ...]:
        if self.done() and self._answer.exception() is None:
            return Job, (partial(_same, self.result()), True)
        return Job, (self._work,)  # a copy begins again

    def done(self) -> bool:
        """Whether there is a result, or an error."""
        return self._answer.done()

    def result(self, timeout: float | None = None) -> Result:
        """The result; it waits for it, at most `timeout` s.

        Raises
        ------
        RuntimeError
            If the process failed or was killed; it has written why to stderr.
        TimeoutError
            If it takes longer.
        """
        return self._answer.result(timeout)

    def result_or(self, instead: Result) -> Result:
        """The result; `instead`, with a warning, if the work failed. It waits as `result` does."""
        try:
            return self.result()
        except Exception as error:  # a loop on a rig goes on
            warnings.warn(f"a search failed: {error}", stacklevel=2)
            return instead

    def cancel(self) -> None:
        """End the process; there will be no result."""
        self._cancelled = True
        if self._process is not None:
            self._process.kill()

    def _run(self, work: Callable[[], Result]) -> None:
        try:
            self._answer.set_result(self._in_process(work))
        except BaseException as error:  # the controller's thread has to see it
            self._answer.set_exception(error)

    def _in_process(self, work: Callable[[], Result]) -> Result:
        try:
            packed = pickle.dumps(work)
        except Exception:  # objects may raise anything when they are pickled
            return work()
        path = os.pathsep.join(filter(None, sys.path))
        environment = {**ONE_THREAD, **os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}
        command = [sys.executable, "-m", __name__]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
            start_new_session=True,  # Ctrl-C is for this process, with which the other ends
        ) as process:  # fmt: skip
            self._process = process
            if self._cancelled:
                process.kill()
            assert process.stdin is not None
            assert process.stdout is not None
            with suppress(OSError):  # it ended early, and its code says so
                process.stdin.write(packed)
                process.stdin.flush()  # closed, it would end the process
            answer = process.stdout.read()
        if process.returncode != 0:
            raise RuntimeError(f"its process ended with {process.returncode}")
        if not answer:
            return work()
        result: Result = pickle.loads(answer)
        return result


def _same(result: Result) -> Result:
    return result


def serve() -> None:
    """Do the work that comes through standard input, and write its result to standard output.

    It writes nothing if it cannot load the work.
    """
    if hasattr(os, "nice"):
        os.nice(POLITE)
    answers, sys.stdout = sys.stdout.buffer, sys.stderr
    try:
        work = pickle.load(sys.stdin.buffer)
    except Exception:  # a class that only the parent knows
        return
    Thread(target=_end_with_parent, daemon=True).start()
    answers.write(pickle.dumps(work()))
    answers.flush()


def _end_with_parent() -> None:
    os.read(sys.stdin.fileno(), 1)  # until the parent's end closes it
    os._exit(1)


if __name__ == "__main__":
    serve()
