"""Short queues of the server: unread messages for the loop, and unread news for a page."""

from __future__ import annotations

import asyncio
import errno
import json
import pickle
import socket
from collections import deque
from typing import Any

from softdyn.view.live.messages import DRAGS, Message, Release

WAITING = 200  # largest number of unread messages of a loop
AGAIN = 0.01  # s until the next try, if the loop's socket is full
ERRORS = 20  # largest number of unread errors of a page


class Inbox:
    """Checked messages that the loop has not read yet, in order; of a drag only the last.

    The queue keeps messages while a loop is busy for seconds, for example with a new controller.

    Parameters
    ----------
    loop : socket
        The loop's socket, which holds only a few unread datagrams.
    """

    def __init__(self, loop: socket.socket) -> None:
        self._loop = loop
        self._waiting: deque[Message | None] = deque()
        self._later: asyncio.TimerHandle | None = None

    def put(self, message: Message | None) -> bool:
        """Queue a message; None says that the first page has come. False if there is no room."""
        last = self._waiting[-1] if self._waiting else None
        if isinstance(message, DRAGS) and type(last) is type(message):
            self._waiting.pop()
        elif len(self._waiting) >= WAITING and not isinstance(message, Release):
            return False
        self._waiting.append(message)
        if self._later is None:
            self._send()
        return True

    def _send(self) -> None:
        self._later = None
        while self._waiting:
            try:
                message = self._waiting[0]
                self._loop.send(b"" if message is None else pickle.dumps(message))
            except (BlockingIOError, InterruptedError):
                self._later = asyncio.get_running_loop().call_later(AGAIN, self._send)
                return
            except OSError as error:
                if error.errno == errno.ENOBUFS:  # macOS reports a full socket so
                    self._later = asyncio.get_running_loop().call_later(AGAIN, self._send)
                else:  # the loop has ended
                    self._waiting.clear()
                return
            self._waiting.popleft()


class Outbox:
    """News that a page has not read yet, in order, followed by the latest frame.

    The queue stays short even if the page reads nothing: a new state replaces the old one, new
    points join the old ones, and only the latest few errors are kept.
    """

    def __init__(self) -> None:
        self._news: list[dict[str, Any]] = []
        self._frame: bytes | None = None

    def __bool__(self) -> bool:
        return bool(self._news) or self._frame is not None

    def put(self, news: dict[str, Any]) -> None:
        """Add news; the name of the first member is their kind."""
        kind = next(iter(news))
        same = [one for one in self._news if kind in one]
        if kind == "reach" and same:
            same[0]["reach"] = same[0]["reach"] + news["reach"]
            return
        if same and (kind != "error" or len(same) >= ERRORS):
            self._news.remove(same[0])
        self._news.append(news)

    def show(self, frame: bytes) -> bool:
        """Set the frame; True if it replaces an unread one."""
        before, self._frame = self._frame, frame
        return before is not None

    def take(self) -> str | bytes:
        """The next text; after all texts, the frame."""
        if self._news:
            return json.dumps(self._news.pop(0))
        frame, self._frame = self._frame or b"", None
        return frame
