"""The server of a live robot: one page, one websocket, one that commands and any number that watch.

A program of its own (``python -m softdyn.validation.live.server``), started by `channel.Channel`.
Everything is on loopback; a request needs the token of the page's address, this machine's own name
as its host, and where it says from which page it comes, that has to be ours. A page that does not
read loses frames, and nobody waits for it.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import os
import pickle
import socket
import sys
from contextlib import suppress
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import tornado.web
import tornado.websocket

from softdyn.exceptions import InputError
from softdyn.validation.live.channel import ERROR, FRAME, STATE
from softdyn.validation.live.messages import LONGEST, Lead, Limits, Reach, Record, read
from softdyn.validation.live.recording import Recording
from softdyn.view.loopback import HOST, is_local

MOST = 16  # pages at once
DATAGRAM = 1 << 18
KINDNESS = 5  # the loop's process goes first


class Hub:
    """All pages, the loop's socket, and what the pages have to be told."""

    def __init__(self, given: dict[str, Any], loop: socket.socket) -> None:
        self.page, self.token = given["page"].encode(), given["token"]
        self.limits: Limits | None = given["limits"]
        self.recording = Recording(given["figure"], given["replayed"], given["title"])
        self.pages: list[Page] = []
        self._loop = loop
        self._state: dict[str, Any] = {}
        self._reach: asyncio.Task | None = None
        self._points: list = []

    # -- from the loop -------------------------------------------------------------------------

    def heard(self) -> None:
        """Hand on what the loop has sent."""
        for _ in range(50):
            try:
                data = self._loop.recv(DATAGRAM)
            except OSError:
                return
            kind, content = data[:1], data[1:]
            if kind == FRAME:
                self.recording.add(content)
                for page in self.pages:
                    page.frame(content)
            elif kind == STATE:
                self._state = json.loads(content)
                self.tell()
            elif kind == ERROR and self.pages:
                self.pages[0].say({"error": content.decode(errors="replace")})

    def tell(self) -> None:
        """Tell every page the state, and whether it commands."""
        for i, page in enumerate(self.pages):
            page.say({
                "state": self._state, "leads": i == 0 and self.limits is not None,
                "pages": len(self.pages), "recording": self.recording.on,
            })  # fmt: skip

    # -- from a page ---------------------------------------------------------------------------

    def joined(self, page: Page) -> None:
        """One more page; the first one commands."""
        self.pages.append(page)
        self._pass(b"")
        self.tell()
        if self._points:
            page.say({"reach": self._points})

    def left(self, page: Page) -> None:
        """It is gone; the next one commands, and no hand stays on the robot."""
        if page in self.pages:
            if page is self.pages[0] and self.limits is not None:
                self._pass(b'{"do": "release"}')
            self.pages.remove(page)
            self.tell()

    def said(self, page: Page, text: str | bytes) -> None:
        """What a page says: done, handed to the loop, or answered with an error."""
        try:
            if self.limits is None:
                raise InputError("message", "none: this page only watches", text[:80])
            message = read(text, self.limits)
            if isinstance(message, Lead):
                self.pages.remove(page)
                self.pages.insert(0, page)
                self.tell()
                return
            if page is not self.pages[0]:
                raise InputError("message", '{"do": "lead"} first', "another page commands")
            if isinstance(message, Record):
                self._record(page, message.on)
            elif isinstance(message, Reach):
                self._ask_reach()
            elif not self._pass(text.encode() if isinstance(text, str) else text):
                raise InputError("message", "fewer at a time", "more than the loop reads")
        except InputError as error:
            page.say({"error": str(error)})

    def _pass(self, text: bytes) -> bool:
        try:
            self._loop.send(text)
        except OSError:
            return False
        return True

    def _record(self, page: Page, on: bool) -> None:
        if on:
            self.recording.begin()
        elif self.recording.end():
            page.say({"recorded": "record.html"})
        self.tell()

    def _ask_reach(self) -> None:
        if self._reach is None:
            self._reach = asyncio.create_task(self._find_reach())

    async def _find_reach(self) -> None:
        """Rests of the tip, shown as they are found; this thread's pages go on meanwhile."""
        loop = asyncio.get_running_loop()
        found = self.recording.rests()
        while batch := await loop.run_in_executor(None, partial(next, found, None)):
            self._points += batch
            for page in self.pages:
                page.say({"reach": batch})


class Checked(tornado.web.RequestHandler):
    """A request of this machine, with the token."""

    def initialize(self, hub: Hub) -> None:
        """Keep the hub."""
        self.hub = hub

    def prepare(self) -> None:
        """Refuse what is not ours."""
        token = self.get_query_argument("token", "")
        if not is_local(self.request) or not hmac.compare_digest(
            token.encode(), self.hub.token.encode()
        ):
            raise tornado.web.HTTPError(403)
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")  # the address holds the token


class Root(Checked):
    """The page itself."""

    def get(self) -> None:
        """Its text."""
        self.finish(self.hub.page)


class Recorded(Checked):
    """The last recording, a page that replays it."""

    async def get(self) -> None:
        """Its text; made in a thread, since it takes a moment."""
        loop = asyncio.get_running_loop()
        text = await loop.run_in_executor(None, self.hub.recording.html)
        if not text:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Disposition", 'attachment; filename="record.html"')
        self.finish(text)


class Page(tornado.websocket.WebSocketHandler, Checked):
    """A page that is open somewhere."""

    def check_origin(self, origin: str) -> bool:
        """Whether the page that asks is the one served here."""
        return urlsplit(origin).netloc == self.request.headers.get("Host")

    def open(self, *_arguments: str) -> None:
        """Join the others, if there is room."""
        self._busy: Any = None
        self._waiting: list[str] = []
        self.dropped = 0
        if len(self.hub.pages) >= MOST:
            self.close(1013, "too many pages")
            return
        self.set_nodelay(True)
        self.hub.joined(self)

    def on_message(self, message: str | bytes) -> None:
        """Hand it to the hub."""
        self.hub.said(self, message)

    def on_close(self) -> None:
        """Leave."""
        self.hub.left(self)

    def frame(self, content: bytes) -> None:
        """Show a frame; dropped where what went before has not left yet."""
        if self._leaving():
            self.dropped += 1
        else:
            self._write(content, binary=True)

    def say(self, what: dict[str, Any]) -> None:
        """Tell something, when it can be sent; of a page that does not read the latest few."""
        self._waiting = [*self._waiting[-20:], json.dumps(what)]
        self._next()

    def _leaving(self) -> bool:
        return self._busy is not None and not self._busy.done()

    def _next(self) -> None:
        """Send what waits, one after the other: each is sent when the one before has left."""
        if self._waiting and not self._leaving():
            self._write(self._waiting.pop(0))

    def _write(self, content: str | bytes, binary: bool = False) -> None:
        with suppress(tornado.websocket.WebSocketClosedError):
            self._busy = asyncio.ensure_future(self.write_message(content, binary))
            self._busy.add_done_callback(self._left)

    def _left(self, done: asyncio.Future) -> None:
        if done.exception() is None:  # else the page is gone
            self._next()


async def serve(given: dict[str, Any], loop: socket.socket) -> None:
    """Serve until standard input ends."""
    hub = Hub(given, loop)
    options = {"hub": hub}
    application = tornado.web.Application(
        [(r"/", Root, options), (r"/live", Page, options), (r"/record.html", Recorded, options)],
        log_function=lambda _handler: None,
        websocket_max_message_size=LONGEST + 1,
    )
    server = application.listen(given["port"], address=HOST)
    running = asyncio.get_running_loop()
    running.add_reader(loop, hub.heard)
    over = asyncio.Event()
    running.add_reader(sys.stdin, over.set)
    print("ready", flush=True)
    await over.wait()
    server.stop()
    for page in tuple(hub.pages):
        page.close()
    await asyncio.sleep(0.05)


def main(descriptor: int) -> None:
    """Read what to serve from standard input, and serve it."""
    os.nice(KINDNESS)
    given = pickle.load(sys.stdin.buffer)  # from our own parent
    loop = socket.socket(fileno=descriptor)
    loop.setblocking(False)
    try:
        asyncio.run(serve(given, loop))
    except OSError as error:
        print(error, flush=True)
    sys.stdout.flush()
    os._exit(0)  # a search of rests may still be going on in a thread


if __name__ == "__main__":
    main(int(sys.argv[1]))
