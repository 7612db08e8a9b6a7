"""A process above that of a command: it returns an exit code even if the other one is killed."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import NoReturn

PASSED_ON = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
_above: int | None = None  # the process above this one


def supervised(work: Callable[[], int], killed: int) -> int:
    """Run `work` in a child process.

    Ctrl-C, SIGTERM and SIGHUP are passed on to it. This returns when all forks of the child have
    ended too: a watchdog may still write a log.

    Parameters
    ----------
    work : Callable[[], int]
        It returns an exit code.
    killed : int
        The code if a signal ends its process.

    Returns
    -------
    int
        The code.
    """
    _flush()
    all_ended, held = os.pipe()
    here = os.getpid()
    signal.pthread_sigmask(signal.SIG_BLOCK, PASSED_ON)  # until somebody can hear them
    child = os.fork()
    if child == 0:
        os.close(all_ended)
        _work(work, here, killed)
    os.close(held)

    def pass_on(number: int, _: FrameType | None) -> None:
        with suppress(ProcessLookupError):
            os.kill(child, number)

    before = {number: signal.signal(number, pass_on) for number in PASSED_ON}
    signal.pthread_sigmask(signal.SIG_UNBLOCK, PASSED_ON)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    os.read(all_ended, 1)
    os.close(all_ended)
    for number, handler in before.items():
        signal.signal(number, handler)
    return killed if code < 0 else code


def orphaned() -> bool:
    """Whether the process above this one has ended; False without one."""
    return _above is not None and os.getppid() != _above


def _work(work: Callable[[], int], above: int, code: int) -> NoReturn:
    """Work in the child, and end it with its exit code; `code` is that of an error."""
    global _above
    _above = above
    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _first_interrupt)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, PASSED_ON)
        code = work()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else code
    except BaseException:
        traceback.print_exc()
    finally:
        _flush()
        os._exit(code)


def _flush() -> None:
    """Write what the streams hold."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()


def _first_interrupt(*_: int | FrameType | None) -> None:
    """Raise KeyboardInterrupt once: a terminal sends Ctrl-C to both processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt
