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

from softdyn.exceptions import one_line
from softdyn.validation.bench.driver import Driver
from softdyn.validation.bench.signals import limited

DONE, BEAT, OPENING, STOPPING = b"d", b"b", b"o", b"s"
IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)
PATIENCE = 2.0  # s for the killed process to end, and for the watchdog itself
START, STOP = 5.0, 2.0  # s for a driver's start() in the watchdog, and for each stop()
RELAXING = 2 * STOP + 1.0  # s for the loop's own stop(), which is tried twice


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
    the loop's process, so that it needs no time and imports nothing then. It leaves the rig alone
    if the loop's process ends before `opening`.

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
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, IGNORED)  # they are not for the fork
        self.pid = os.fork()
        if self.pid == 0:
            code = 1
            try:
                os.close(self._tells)
                os.setsid()  # the terminal's Ctrl-C is not for it
                for number in IGNORED:
                    signal.signal(number, signal.SIG_IGN)
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
                code = _watch(hears, parent, driver, late, after)
            finally:
                os._exit(code)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        os.close(hears)
        os.set_blocking(self._tells, False)

    def opening(self) -> None:
        """Say that the loop's driver is about to be started."""
        self._tell(OPENING)

    def beat(self) -> bool:
        """Say that the loop moves; False if the watchdog has ended."""
        return self._tell(BEAT)

    def stopping(self) -> None:
        """Say that no heartbeat comes any more, because the loop's driver relaxes the rig."""
        self._tell(STOPPING)

    def end(self) -> None:
        """End the watchdog; the rig is relaxed already."""
        patience = time.monotonic() + PATIENCE
        try:
            os.write(self._tells, DONE)
        except BlockingIOError:  # it has heard nothing for minutes, and must not now
            patience = 0.0
        except OSError:
            pass
        with suppress(OSError):
            os.close(self._tells)
        with suppress(ChildProcessError):
            while not os.waitpid(self.pid, os.WNOHANG)[0]:
                if time.monotonic() > patience:
                    _say("warning: the watchdog's process does not end (it was stopped?): killed")
                    os.kill(self.pid, signal.SIGKILL)
                    os.waitpid(self.pid, 0)
                    return
                time.sleep(5e-4)

    def _tell(self, word: bytes) -> bool:
        """Write to the watchdog; False if it has ended."""
        try:
            os.write(self._tells, word)
        except BlockingIOError:  # it is busy with something else, so the pipe is full
            return True
        except OSError:
            return False
        return True


def _watch(
    hears: int, parent: int, driver: Driver, late: float, after: Callable[[str], None] | None
) -> int:
    """The watchdog's own process; its exit code."""
    # the first heartbeat comes when the loop begins
    longest, opened = None, False
    while True:
        ready, _, _ = select.select([hears], [], [], longest)
        said = os.read(hears, 4096) if ready else b""
        if DONE in said or (ready and not said and not opened):
            return 0
        opened |= bool(said)
        if not said:
            break
        if STOPPING in said or longest == RELAXING:
            longest = RELAXING
        elif BEAT in said:
            longest = late
    reason = "the loop's process ended"
    if not ready:
        what = "stop() has not returned" if longest == RELAXING else "no heartbeat"
        assert longest is not None
        reason = f"{what} for {1e3 * longest:.0f} ms"
    _kill(parent)
    done = "it has relaxed the rig"
    for name, call, seconds in (("start", driver.start, START), ("stop", driver.stop, STOP)):
        try:
            limited(call, seconds)
        except BaseException as error:  # the other call may still help
            _say(one_line(f"watchdog: {name}(): {type(error).__name__}: {error}", 300))
            done = "it could not relax the rig for sure: relax it by hand"
    _say(f"stopped by the watchdog: {reason}; {done}")
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
