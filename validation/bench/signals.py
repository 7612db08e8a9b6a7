"""Signals in a run on a rig: they are noted, and asked for before anything moves.

A handler that only raises an exception is not enough: callbacks of the interpreter, destructors,
compilers and a bare `except` swallow it. So the handler notes the signal first. It raises only
while the run waits for somebody else's code.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from typing import Any

from softdyn.validation.bench import supervisor
from softdyn.validation.bench.fail_safe import Stop, StopCause

CAUSES = {
    signal.SIGINT: StopCause.CTRL_C,
    signal.SIGTERM: StopCause.TERMINATED,
    signal.SIGHUP: StopCause.HUNG_UP,
}
TOGETHER = 0.3  # s; a terminal's Ctrl-C comes twice: to this process, and passed on to it


class Interruption(KeyboardInterrupt):
    """A signal that came while the run waited; no `except Exception` swallows it."""


class Overdue(BaseException):
    """A call that has not returned in its time."""


class Signals:
    """The signal that ends the process: the first of Ctrl-C, SIGTERM and SIGHUP.

    Attributes
    ----------
    cause : StopCause or None
        Its cause; None if none came.
    """

    def __init__(self) -> None:
        self.cause: StopCause | None = None
        self._raises, self._listens, self._raised = False, False, -1.0

    def __call__(self, number: int, _: Any) -> None:
        """Note a signal; the handler of all of them."""
        self.cause = self.cause or CAUSES[signal.Signals(number)]
        now = time.monotonic()
        if self._raises and not 0 <= now - self._raised < TOGETHER:
            self._raised = now
            raise Interruption

    @contextmanager
    def heard(self) -> Iterator[Signals]:
        """Have the process' signals in this block; a block inside changes nothing.

        Without a main thread that can hear them, nothing happens.
        """
        if self._listens or current_thread() is not main_thread():
            yield self
            return
        self._listens = True
        before = {number: signal.signal(number, self) for number in CAUSES}
        # a closed pipe, of the watchdog or the rig, must be an error, not the end of the process
        before[signal.SIGPIPE] = signal.signal(signal.SIGPIPE, signal.SIG_IGN)
        try:
            yield self
        finally:
            for number, handler in before.items():
                # a supervised process only has its exit code left to say
                signal.signal(number, signal.SIG_IGN if supervisor.is_below() else handler)
            self._listens = False

    def interrupting(self, work: Callable[[], None]) -> None:
        """Do some `work` that may wait for long; a signal interrupts it by `Interruption`.

        Raises
        ------
        Stop
            A signal came before, or meanwhile, whatever became of the exception.
        """
        try:
            self._raises = True
            self.check()
            work()
        finally:
            self._raises = False
            self.check()

    def check(self) -> None:
        """Stop after a signal, or if the process above this one, the user's, was killed.

        Raises
        ------
        Stop
            The run must not go on.
        """
        if self.cause is not None:
            raise Stop(self.cause, self.cause.value)
        if supervisor.orphaned():
            raise Stop(StopCause.HUNG_UP, "the process of softdyn drive has ended")


def limited(call: Callable[[], Any], seconds: float) -> None:
    """Call a function; interrupt it by `Overdue` when it takes longer, and then again and again.

    Only the main thread can be interrupted, and no code that never comes back to Python.

    Raises
    ------
    Overdue
        It took longer.
    """
    if current_thread() is not main_thread():
        call()
        return
    waits = True

    def over(*_: Any) -> None:
        if waits:
            raise Overdue(f"it has not returned for {seconds:g} s")

    before = signal.signal(signal.SIGALRM, over)
    try:
        signal.setitimer(signal.ITIMER_REAL, seconds, seconds)
        call()
    finally:
        waits = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
