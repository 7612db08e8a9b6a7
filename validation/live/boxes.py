"""What the server keeps for the loop and for each page until they read it: short, and in order."""

from __future__ import annotations

import asyncio
import errno
import json
import socket
from collections import deque
from typing import Any

from softdyn.validation.live.messages import DRAGS, Release

WAITING = 200  # messages that a loop may have unread
AGAIN = 0.01  # s until a loop that takes no more is asked again
ERRORS = 20  # that a page is told of those it has not read


class Inbox:
    """What the loop has still to read, in order; of a drag the last place alone.

    Parameters
    ----------
    loop : socket
        Takes some datagrams, and no more before it has read them: a loop that builds a law for
        seconds, or looks for a rest, loses nothing of what is said meanwhile.
    """

    def __init__(self, loop: socket.socket) -> None:
        self._loop = loop
        self._waiting: deque[tuple[type, bytes]] = deque()
        self._later: asyncio.TimerHandle | None = None

    def put(self, kind: type, text: bytes) -> bool:
        """Hand on a message; whether there was room."""
        if kind in DRAGS and self._waiting and self._waiting[-1][0] is kind:
            self._waiting.pop()
        elif len(self._waiting) >= WAITING and kind is not Release:
            return False
        self._waiting.append((kind, text))
        if self._later is None:
            self._send()
        return True

    def _send(self) -> None:
        self._later = None
        while self._waiting:
            try:
                self._loop.send(self._waiting[0][1])
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
    """What a page has still to be told, in order, and the latest frame behind it.

    It is short whatever the page does not read: a state overtakes the one before, points join
    those before, and of errors the latest few are kept.
    """

    def __init__(self) -> None:
        self._news: list[dict[str, Any]] = []
        self._frame: bytes | None = None

    def __bool__(self) -> bool:
        return bool(self._news) or self._frame is not None

    def put(self, news: dict[str, Any]) -> None:
        """Something to be told; its first member says what kind it is."""
        kind = next(iter(news))
        same = [one for one in self._news if kind in one]
        if kind == "reach" and same:
            same[0]["reach"] = same[0]["reach"] + news["reach"]
            return
        if same and (kind != "error" or len(same) >= ERRORS):
            self._news.remove(same[0])
        self._news.append(news)

    def show(self, frame: bytes) -> bool:
        """A frame, in the place of the one before; whether there was one."""
        before, self._frame = self._frame, frame
        return before is not None

    def take(self) -> str | bytes:
        """What is next: texts first."""
        if self._news:
            return json.dumps(self._news.pop(0))
        frame, self._frame = self._frame or b"", None
        return frame
