"""What commands that serve a page share: a clean end."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager


class _Ended(BaseException):
    """SIGINT or SIGTERM; not an Exception, so that nobody takes it for an error."""


@contextmanager
def ends_cleanly() -> Iterator[None]:
    """Leave the block without an error when somebody ends the command by Ctrl-C or SIGTERM."""

    def end(*_: object) -> None:
        # a second Ctrl-C must not interrupt the clean end that the first one began
        for number in before:
            signal.signal(number, signal.SIG_IGN)
        raise _Ended

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    except _Ended:
        pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
