"""A process above that of a command: it returns an exit code even if the other one is killed."""

from __future__ import annotations

import os
import select
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import NoReturn

PASSED_ON = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
LONGEST = 60.0  # s for the watchdog to relax the rig and to write a log
_above: int | None = None  # the process above this one


def supervised(work: Callable[[], int], killed: int, interrupted: int) -> int:
    """Run `work` in a child process.

    Ctrl-C, SIGTERM and SIGHUP are passed on to it, and end it at once until it has handlers of its
    own: so no code that it loads can swallow them. This returns when all forks of the child have
    ended too: a watchdog may still write a log.

    Parameters
    ----------
    work : Callable[[], int]
        It returns an exit code.
    killed : int
        The code if its process ends before `work` returns one.
    interrupted : int
        The code if Ctrl-C ends its process.

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
        _work(work, here, held, killed)
    os.close(held)

    def pass_on(number: int, _: FrameType | None) -> None:
        with suppress(ProcessLookupError):
            os.kill(child, number)

    before = {number: signal.signal(number, pass_on) for number in PASSED_ON}
    signal.pthread_sigmask(signal.SIG_UNBLOCK, PASSED_ON)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    for number in PASSED_ON:  # the child's number may be that of another process now
        signal.signal(number, signal.SIG_IGN)
    said = _until_all_end(all_ended)
    for number, handler in before.items():
        signal.signal(number, handler)
    if said:
        return said[0]
    if status == -signal.SIGINT:
        _say("error: interrupted")
        return interrupted
    how = f"was ended by {signal.Signals(-status).name}" if status < 0 else "ended without a result"
    _say(f"error: the loop's process {how}")
    return killed


def _until_all_end(held: int) -> bytes:
    """What the child has said, once nobody holds the other end of its pipe."""
    said = b""
    while select.select([held], [], [], LONGEST)[0]:
        piece = os.read(held, 16)
        said += piece
        if not piece:
            break
    else:
        _say(f"warning: a process of the run has not ended for {LONGEST:g} s: look for it")
    os.close(held)
    return said


def is_below() -> bool:
    """Whether this is the child of `supervised`, whose code ends with `work`."""
    return _above is not None


def orphaned() -> bool:
    """Whether the process above this one has ended; False without one."""
    return _above is not None and os.getppid() != _above


def _work(work: Callable[[], int], above: int, held: int, code: int) -> NoReturn:
    """Work in the child, say its exit code, and end it; `code` is that of an error."""
    global _above
    _above = above
    try:
        for number in PASSED_ON:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, PASSED_ON)
        code = work()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else code
    except BaseException:
        traceback.print_exc()
    finally:
        _flush()
        os.write(held, bytes([code & 0xFF]))
        os._exit(code)


def _flush() -> None:
    """Write what the streams hold."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # a closed one may be None
            stream.flush()


def _say(text: str) -> None:
    with suppress(OSError, ValueError, AttributeError):
        print(text, file=sys.stderr, flush=True)
