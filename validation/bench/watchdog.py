"""A process that relaxes a rig when the loop's process dies or no longer moves."""

from __future__ import annotations

import mmap
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from softdyn.validation.bench.driver import Driver

LATE = 0.05  # s that a heartbeat may be late; the end of a killed process takes some 20 to 40 ms
DONE, BEAT = b"d", b"b"
IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)
PATIENCE = 2.0  # s for the killed process to end


def shared(array: np.ndarray) -> np.ndarray:
    """A copy of an array in memory that a process shares with those that it forks."""
    memory = mmap.mmap(-1, max(array.nbytes, 1))
    found = np.frombuffer(memory, array.dtype, array.size).reshape(array.shape)
    found[...] = array
    return found


class Watchdog:
    """It holds a second driver, made before the loop begins, and listens for heartbeats.

    If none comes for `late` seconds, or the loop's process ends without `end`, it kills this
    process, waits for its end, and calls ``start()`` and ``stop()`` of its driver. It is a fork of
    the loop's process, so that it needs no time and imports nothing then.

    Parameters
    ----------
    driver : Driver
        A driver of its own.
    late : float
        Longest time between two heartbeats (s).
    after : Callable[[str], None], optional
        Called in the watchdog with the reason, after the rig is relaxed.

    Attributes
    ----------
    pid : int
        Its process.
    """

    def __init__(
        self, driver: Driver, late: float, after: Callable[[str], None] | None = None
    ) -> None:
        hears, self._tells = os.pipe()
        parent = os.getpid()
        self.pid = os.fork()
        if self.pid == 0:
            code = 1
            try:
                os.close(self._tells)
                code = _watch(hears, parent, driver, late, after)
            finally:
                os._exit(code)
        os.close(hears)
        os.set_blocking(self._tells, False)

    def beat(self) -> bool:
        """Say that the loop moves; False if the watchdog has ended."""
        try:
            os.write(self._tells, BEAT)
        except BlockingIOError:  # it is busy with something else, so the pipe is full
            return True
        except OSError:
            return False
        return True

    def end(self) -> None:
        """End the watchdog; the rig is relaxed already."""
        with suppress(OSError):
            os.write(self._tells, DONE)
        with suppress(OSError):
            os.close(self._tells)
        with suppress(ChildProcessError):
            os.waitpid(self.pid, 0)


def _watch(
    hears: int, parent: int, driver: Driver, late: float, after: Callable[[str], None] | None
) -> int:
    """The watchdog's own process; its exit code."""
    os.setsid()  # the terminal's Ctrl-C is not for it
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    begun = False
    while True:
        # the first heartbeat comes when the loop begins
        ready, _, _ = select.select([hears], [], [], late if begun else None)
        said = os.read(hears, 4096) if ready else b""
        if DONE in said:
            return 0
        if ready and said:
            begun = True
            continue
        break
    reason = "the loop's process ended" if ready else f"no heartbeat for {1e3 * late:.0f} ms"
    _kill(parent)
    for call in (driver.start, driver.stop):
        try:
            call()
        except BaseException as error:  # the other call may still help
            _say(f"watchdog: {type(error).__name__}: {error}")
    _say(f"stopped by the watchdog: {reason}; it has relaxed the rig")
    if after is not None:
        after(f"watchdog: {reason}")
    return 0


def _kill(parent: int) -> None:
    """Kill the loop's process and wait for its end."""
    if os.getppid() == parent:
        with suppress(ProcessLookupError):
            os.kill(parent, signal.SIGKILL)
    patience = time.monotonic() + PATIENCE
    while os.getppid() == parent and time.monotonic() < patience:
        time.sleep(5e-4)


def _say(text: str) -> None:
    with suppress(Exception):
        print(text, file=sys.stderr, flush=True)
