"""The server of every page: one page of a live robot commands, and others may watch.

It is a separate program (``python -m softdyn.view.live.server``), which `channel.Channel` starts.
Everything is on loopback. A request needs the token of the page's address; its Host header must
name this machine, and an Origin header, if sent, must be our page. A user may name one other
origin, that of a proxy on this machine. Each page has an outbox and the
loop has an inbox, so a slow page loses frames but delays no one.
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

import tornado.httpserver
import tornado.web
import tornado.websocket

from softdyn.exceptions import InputError, SoftdynError
from softdyn.view.live.boxes import Inbox, Outbox
from softdyn.view.live.channel import DATAGRAM, ERROR, FRAME, STATE
from softdyn.view.live.messages import (  # fmt: skip
    LONGEST,
    FindReach,
    Lead,
    Limits,
    Message,
    RecordFrames,
    Release,
    read,
)
from softdyn.view.live.recording import Recording
from softdyn.view.loopback import MAX_BODY, is_local

MOST = 16  # pages at once
KINDNESS = 5  # added niceness, so that the loop's process has priority
FAREWELL = 10.0  # s for the pages to receive the rest


class Hub:
    """All pages, the loop's socket, and the state that the pages show."""

    def __init__(
        self, loop: socket.socket, page: str, token: str, limits: Limits | None,
        recording: Recording, origin: str | None,
    ) -> None:  # fmt: skip
        self.origin = origin
        self.page, self.token = page.encode(), token
        self.limits, self.recording = limits, recording
        self.pages: list[PageSocket] = []
        self._loop, self._inbox = loop, Inbox(loop)
        self._state: dict[str, Any] = {}
        self._frame = b""  # the latest
        self._reach: asyncio.Task | None = None
        self._points: list = []
        self._greeted = False

    # -- from the loop -------------------------------------------------------------------------

    def heard(self) -> None:
        """Pass the loop's datagrams to the pages."""
        for _ in range(50):
            try:
                data = self._loop.recv(DATAGRAM)
            except OSError:
                return
            kind, content = data[:1], data[1:]
            if kind == FRAME:
                self._frame = content
                for page in self.pages:
                    page.frame(content)
                if self.recording.add(content):
                    self._record(False)  # the recording is full
            elif kind == STATE:
                self._state = json.loads(content)
                self.notify()
            elif kind == ERROR and self.pages:
                self.pages[0].say({"error": content.decode(errors="replace")})

    def notify(self) -> None:
        """Tell every page the state, and whether it commands."""
        for i, page in enumerate(self.pages):
            page.say({
                "state": self._state, "leads": i == 0 and self.limits is not None,
                "pages": len(self.pages), "recording": self.recording.on,
            })  # fmt: skip

    # -- from a page ---------------------------------------------------------------------------

    def joined(self, page: PageSocket) -> None:
        """Add a page; the first one commands."""
        self.pages.append(page)
        if not self._greeted:  # a loop may wait for its first page
            self._greeted = self._inbox.put(None)
        self.notify()
        if self._points:
            page.say({"reach": self._points})
        if self._frame:
            page.frame(self._frame)

    def left(self, page: PageSocket) -> None:
        """Remove a page; if it commanded, its push ends and the next page commands."""
        if page in self.pages:
            if page is self.pages[0]:
                self._let_go()
            self.pages.remove(page)
            self.notify()

    def said(self, page: PageSocket, text: str | bytes) -> None:
        """Carry out a message, pass it to the loop, or answer it with an error."""
        if page not in self.pages:  # there was no room for it, or it has left
            return
        try:
            if self.limits is None:
                raise InputError("message", "none: this page only watches", text[:80])
            message = read(text, self.limits)
            if isinstance(message, Lead):
                if page is not self.pages[0]:
                    self._let_go()
                self.pages.remove(page)
                self.pages.insert(0, page)
                self.notify()
                return
            if page is not self.pages[0]:
                raise InputError("message", '{"do": "lead"} first', "another page commands")
            self._do(message)
        except InputError as error:
            page.say({"error": str(error)})

    def _do(self, message: Message) -> None:
        if isinstance(message, RecordFrames):
            self.heard()  # frames that were sent before the message
            self._record(message.on)
        elif isinstance(message, FindReach):
            self._ask_reach()
        elif not self._inbox.put(message):
            raise InputError("message", "fewer at a time", "more than the loop reads")

    def _let_go(self) -> None:
        """End a push, because its page no longer commands."""
        if self.limits is not None:
            self._inbox.put(Release())

    def _record(self, on: bool) -> None:
        if on:
            self.recording.begin()
        elif self.recording.end() and self.pages:
            self.pages[0].say({"recorded": "record.html"})
        self.notify()

    def _ask_reach(self) -> None:
        if self._reach is None:
            self._reach = asyncio.create_task(self._find_reach())

    async def _find_reach(self) -> None:
        """Show tips of stable equilibria while a thread finds them."""
        loop = asyncio.get_running_loop()
        found = self.recording.rests()
        try:
            while batch := await loop.run_in_executor(None, partial(next, found, None)):
                self._points = self._points + batch
                for page in self.pages:
                    page.say({"reach": batch})
        except SoftdynError as error:
            self._reach = None  # a page may ask again
            for page in self.pages[:1]:
                page.say({"error": str(error)})

    # -- the end -------------------------------------------------------------------------------

    async def part(self, html: str) -> None:
        """Send every page everything that is left, and the final page `html`."""
        for _ in range(20):
            self.heard()
        for page in self.pages:
            if html:
                page.say({"replay": html})
        end = asyncio.get_running_loop().time() + FAREWELL
        closing: set[PageSocket] = set()
        while self.pages and asyncio.get_running_loop().time() < end:
            for page in tuple(self.pages):
                if page not in closing and not page.behind:
                    closing.add(page)
                    page.close()
            await asyncio.sleep(0.01)


class Checked(tornado.web.RequestHandler):
    """A request from this machine, with the token."""

    def initialize(self, hub: Hub) -> None:
        """Keep the hub."""
        self.hub = hub

    def prepare(self) -> None:
        """Refuse a request from another machine or without the token."""
        token = self.get_query_argument("token", "")
        if not is_local(self.request, self.hub.origin) or not hmac.compare_digest(
            token.encode(), self.hub.token.encode()
        ):
            raise tornado.web.HTTPError(403)
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")  # the address holds the token


class Root(Checked):
    """The page itself."""

    def get(self) -> None:
        """Send its text."""
        self.finish(self.hub.page)


class Recorded(Checked):
    """The page that replays the last recording."""

    async def get(self) -> None:
        """Send its text; a thread makes it, because that takes a moment."""
        loop = asyncio.get_running_loop()
        text = await loop.run_in_executor(None, self.hub.recording.html)
        if not text:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Disposition", 'attachment; filename="record.html"')
        self.finish(text)


class PageSocket(tornado.websocket.WebSocketHandler, Checked):
    """The websocket of an open page."""

    def check_origin(self, origin: str) -> bool:
        """True for a request from the page that is served here, also through the named proxy."""
        if self.hub.origin is not None and origin.lower() == self.hub.origin:
            return True
        return urlsplit(origin).netloc == self.request.headers.get("Host")

    def open(self, *_arguments: str) -> None:
        """Join the other pages, if there is room."""
        self._sending: asyncio.Future | None = None
        self._outbox = Outbox()
        self.dropped = 0
        if len(self.hub.pages) >= MOST:
            self.close(1013, "too many pages")
            return
        self.set_nodelay(True)
        self.hub.joined(self)

    def on_message(self, message: str | bytes) -> None:
        """Pass the message to the hub."""
        self.hub.said(self, message)

    def on_close(self) -> None:
        """Remove the page from the hub."""
        self.hub.left(self)

    def frame(self, content: bytes) -> None:
        """Send a frame as soon as possible; it replaces an unsent one."""
        self.dropped += self._outbox.show(content)
        self._next()

    def say(self, what: dict[str, Any]) -> None:
        """Send news as soon as possible."""
        self._outbox.put(what)
        self._next()

    @property
    def behind(self) -> bool:
        """True while some news or a frame is unsent."""
        return bool(self._sending or self._outbox)

    def _next(self) -> None:
        """Send the next text or frame; called when the one before is sent."""
        if self._sending or not self._outbox:
            return
        content = self._outbox.take()
        with suppress(tornado.websocket.WebSocketClosedError):
            written = self.write_message(content, isinstance(content, bytes))
            self._sending = asyncio.ensure_future(written)
            self._sending.add_done_callback(self._left)

    def _left(self, done: asyncio.Future) -> None:
        self._sending = None
        if not done.cancelled() and done.exception() is None:  # else the page is gone
            self._next()


async def serve(hub: Hub, loop: socket.socket, listening: socket.socket) -> None:
    """Serve until standard input ends; its text is the final page for the open pages."""
    routes = {"/": Root, "/live": PageSocket, "/record.html": Recorded}
    application = tornado.web.Application(
        [(path, handler, {"hub": hub}) for path, handler in routes.items()],
        log_function=lambda _handler: None,
        websocket_max_message_size=LONGEST + 1,
    )
    server = tornado.httpserver.HTTPServer(application, max_body_size=MAX_BODY)
    server.add_socket(listening)
    running = asyncio.get_running_loop()
    running.add_reader(loop, hub.heard)
    print("ready", flush=True)
    left = await running.run_in_executor(None, sys.stdin.buffer.read)
    server.stop()
    await hub.part(left.decode())


def main(*descriptors: int) -> None:
    """Read the page and its settings from standard input, and serve it."""
    os.nice(KINDNESS)
    given = pickle.load(sys.stdin.buffer)  # from the parent process
    loop, listening = (socket.socket(fileno=descriptor) for descriptor in descriptors)
    for one in (loop, listening):
        one.setblocking(False)
    asyncio.new_event_loop().run_until_complete(serve(Hub(loop, *given), loop, listening))
    os._exit(0)  # a thread may still search equilibria


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
