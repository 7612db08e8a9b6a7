"""Serve a page from a separate process: datagrams carry frames to it and messages from it.

A loop never waits for a page: a frame that does not fit in the socket's buffer is dropped and
counted. The server checks the messages and sends them as pickles; it is a child of this process.
"""

from __future__ import annotations

import json
import os
import pickle
import secrets
import select
import socket
import subprocess
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np

import softdyn
from softdyn.exceptions import InputError, SoftdynError
from softdyn.view.live.messages import LONGEST, Limits, Message
from softdyn.view.live.recording import Recording
from softdyn.view.loopback import HOST, listener, read_origin

FRAME, STATE, ERROR = b"F", b"S", b"E"  # kinds of datagrams
DATAGRAM = 1 << 18  # bytes, more than any datagram has
AT_ONCE = 8  # messages that a loop reads between two control steps
AGAIN = 1e-3  # s until the next try of a frame that must not be dropped
PATIENCE = 30.0  # s until the server must have sent the rest and ended


class Channel(AbstractContextManager):
    """Serves a page at `url` until it is closed: sends it frames and receives its messages.

    Parameters
    ----------
    page : str
        The page that the server shows.
    limits : Limits, optional
        Limits of the messages; without them the pages only watch.
    recording : Recording, optional
        The robot of a page with messages, for recordings and reachable points.
    port : int, optional
        Port of the page; by default a free one from 7000 on.
    origin : str, optional
        The origin of a proxy on this machine whose pages may connect, too: ``https://host``.

    Attributes
    ----------
    url : str
        Address of the page for browsers on this machine; it contains the token.
    dropped : int
        Number of frames that the server did not take in time.

    Raises
    ------
    InputError
        If the port is taken, the server does not start or the origin is none.
    """

    def __init__(
        self,
        page: str,
        limits: Limits | None = None,
        recording: Recording | None = None,
        port: int | None = None,
        origin: str | None = None,
    ) -> None:
        origin = None if origin is None else read_origin(origin)
        self.dropped = 0
        self._late: dict[bytes, bytes] = {}
        token = secrets.token_urlsafe(16)
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        listening = listener(port)
        found = listening.getsockname()[1]
        ours = (theirs.fileno(), listening.fileno())
        root = str(Path(softdyn.__file__).parents[1])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "softdyn.view.live.server", *map(str, ours)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=ours,
            env={**os.environ, "PYTHONPATH": path}, start_new_session=True,
        )  # fmt: skip
        theirs.close()
        listening.close()
        given = (page, token, limits, recording or Recording(), origin)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(BrokenPipeError):  # the server died: its answer below says so
            pickle.dump(given, self._process.stdin)
            self._process.stdin.flush()
        answer = self._process.stdout.readline().decode().strip()
        if answer != "ready":
            self.close()
            raise InputError("pages", "a running server process", answer or "one that died")
        self.url = f"http://{HOST}:{found}/?token={token}"

    def __reduce_ex__(self, _protocol: Any) -> str:
        raise TypeError("a live page cannot be copied: make another Channel of its page")

    def __exit__(self, *_error: object) -> None:
        self.close()

    def open(self) -> None:
        """Show the page in the user's browser, if there is one."""
        with suppress(webbrowser.Error):
            webbrowser.open(self.url, new=2)

    def check(self) -> None:
        """Check that the server still runs.

        Raises
        ------
        SoftdynError
            If it has ended.
        """
        if self._process.poll() is not None:
            raise SoftdynError("the server of the pages has ended")

    def wait(self, timeout: float) -> bool:
        """Wait for the first page, at most `timeout` (s); return whether one has come."""
        return bool(select.select([self._socket], [], [], timeout)[0])

    def frame(self, row: np.ndarray, patience: float = 0.0) -> None:
        """Send a frame; drop it if the socket is still full after `patience` (s)."""
        content, until = np.asarray(row, "<f4").tobytes(), monotonic() + patience
        while True:
            for kind in tuple(self._late):  # states and errors must not be lost, so they go first
                if self._send(kind, self._late[kind]):
                    del self._late[kind]
            if self._send(FRAME, content):
                return
            if self._process.poll() is not None or monotonic() >= until:
                self.dropped += 1
                return
            sleep(AGAIN)

    def state(self, shown: dict[str, Any]) -> None:
        """Send what has changed: at once, or if that fails with the next frame."""
        self._say(STATE, json.dumps(shown).encode())

    def error(self, text: str) -> None:
        """Answer a message that failed."""
        self._say(ERROR, text.encode()[:LONGEST])

    def messages(self) -> Iterator[Message]:
        """Messages of the commanding page since the last call, at most `AT_ONCE`."""
        for _ in range(AT_ONCE):
            try:
                data = self._socket.recv(DATAGRAM)
            except OSError:  # no message, or no server
                return
            if data:  # an empty datagram says that a page has come
                yield pickle.loads(data)

    def leave(self, html: str) -> None:
        """Send the pages a final page, which they keep after the server's end; call it once."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.write(html.encode())

    def close(self) -> None:
        """End the server; it first sends the pages everything that is left."""
        process = self._process
        with suppress(OSError):
            self._socket.settimeout(1.0)
            for kind, content in self._late.items():
                self._socket.send(kind + content)
        self._late.clear()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):
                    pipe.close()  # the server ends when its standard input ends
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._socket.close()

    def _say(self, kind: bytes, content: bytes) -> None:
        self._late.pop(kind, None)  # the new content replaces an older one of this kind
        if not self._send(kind, content):
            self._late[kind] = content

    def _send(self, kind: bytes, content: bytes) -> bool:
        try:
            self._socket.send(kind + content)
        except OSError:  # the socket is full or closed, or the server has ended
            return False
        return True
