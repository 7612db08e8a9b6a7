"""Short queues of the server: messages that the loop, and news that a page, has not read yet."""

from __future__ import annotations

import asyncio
import errno
import json
import pickle
import socket
from collections import deque
from typing import Any

from softdyn.view.live.messages import DRAGS, Message, Release

WAITING = 200  # messages that a loop may have unread
AGAIN = 0.01  # s until a loop that takes no more is asked again
ERRORS = 20  # that a page is told of those it has not read


class Inbox:
    """Checked messages that the loop has not read yet, in order; of a drag only the last.

    Parameters
    ----------
    loop : socket
        Takes some datagrams, and no more before it has read them: a loop that builds a controller
        for seconds, or looks for a rest, loses no message meanwhile.
    """

    def __init__(self, loop: socket.socket) -> None:
        self._loop = loop
        self._waiting: deque[Message | None] = deque()
        self._later: asyncio.TimerHandle | None = None

    def put(self, message: Message | None) -> bool:
        """Hand on a message, or with None the news of the first page; False without room."""
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
                if error.errno == errno.ENOBUFS:  # macOS says so of a full one
                    self._later = asyncio.get_running_loop().call_later(AGAIN, self._send)
                else:  # the loop is gone
                    self._waiting.clear()
                return
            self._waiting.popleft()


class Outbox:
    """News that a page has not read yet, in order, and the latest frame behind them.

    It is short for a page that reads nothing: a state replaces the one before, points join those
    before, and of errors the latest few are kept.
    """

    def __init__(self) -> None:
        self._news: list[dict[str, Any]] = []
        self._frame: bytes | None = None

    def __bool__(self) -> bool:
        return bool(self._news) or self._frame is not None

    def put(self, news: dict[str, Any]) -> None:
        """Add news; the first member is their kind."""
        kind = next(iter(news))
        same = [one for one in self._news if kind in one]
        if kind == "reach" and same:
            same[0]["reach"] = same[0]["reach"] + news["reach"]
            return
        if same and (kind != "error" or len(same) >= ERRORS):
            self._news.remove(same[0])
        self._news.append(news)

    def show(self, frame: bytes) -> bool:
        """Set the frame; True if it replaces one that was not read."""
        before, self._frame = self._frame, frame
        return before is not None

    def take(self) -> str | bytes:
        """The next text, or the frame after all texts."""
        if self._news:
            return json.dumps(self._news.pop(0))
        frame, self._frame = self._frame or b"", None
        return frame
