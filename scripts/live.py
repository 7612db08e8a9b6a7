"""What commands that serve a page share: their options and a clean end."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from softdyn.commands import cli


def add_server_options(parser: cli.Parser) -> None:
    """Options of a command that serves a page."""
    parser.add_argument(
        "--port", type=cli.count, metavar="P", help="of the page (default: a free one from 7000 on)"
    )
    parser.add_argument(
        "--no-open", action="store_true", help="print the page's address and open no browser"
    )


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
