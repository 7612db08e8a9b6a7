"""Serve a page with robots on this machine only, and send it frames while a loop runs.

Meshcat's own server listens on every interface. Here HTTP, the websocket and ZMQ are bound to
loopback, and a request that names another host is refused. Any program that uses Meshcat's protocol
can add its own objects to the scene at `Viewer.zmq_url`.
"""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from contextlib import suppress
from typing import Any

import numpy as np
import tornado.httpserver
import tornado.web
import tornado.websocket
import umsgpack
from meshcat.servers.zmqserver import (
    VIEWER_ROOT,
    StaticFileHandlerNoCache,
    WebSocketHandler,
    ZMQWebSocketBridge,
)

from softdyn.exceptions import InputError
from softdyn.view.loopback import HOST, MAX_BODY, Served, is_local, listener
from softdyn.view.page import Page

LIBRARY = "/static/main.min.js"
FLOAT32 = 0x17  # MessagePack's extension that Meshcat reads as a Float32Array


class Viewer(Served):
    """Serves a page from its own thread until it is closed; a context manager.

    Parameters
    ----------
    page : Page
        The page to show.
    port : int, optional
        Port of HTTP and the websocket; by default a free one from 7000 on.

    Attributes
    ----------
    url : str
        Address of the page for browsers on this machine.
    zmq_url : str
        Address of the scene for ``meshcat.Visualizer(zmq_url)``.

    Raises
    ------
    InputError
        If the port is not free or not allowed.
    """

    def __init__(self, page: Page, port: int | None = None) -> None:
        self._html = page.html(LIBRARY).encode()
        self._loop = asyncio.new_event_loop()
        self._ready, self._connected = threading.Event(), threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(
            target=self._serve, args=(listener(port),), name="viewer", daemon=True
        )
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise InputError("--port", "a free port", f"{port}: {self._error}") from self._error

    def __reduce_ex__(self, _protocol: Any) -> str:
        raise TypeError("a live page cannot be copied: make another Viewer of its page")

    def wait(self, timeout: float) -> bool:
        """Wait for a browser, at most `timeout` (s); return whether one has connected."""
        return self._connected.wait(timeout)

    def push(self, frames: np.ndarray) -> None:
        """Show these frames (see `page.frames`) after the earlier ones; returns at once."""
        content = np.asarray(frames, "<f4").tobytes()
        self._call(lambda: self._bridge.add_frames(content))

    def say(self, text: str) -> None:
        """Show a line of text in the legend."""
        self._call(lambda: self._bridge.say(text))

    def close(self) -> None:
        """Send the remaining frames and end the server; an open page keeps its frames."""
        if self._thread.is_alive():
            self._call(self._loop.stop)
            self._thread.join()

    def _call(self, function: Any) -> None:
        with suppress(RuntimeError):  # the server is closed
            self._loop.call_soon_threadsafe(function)

    def _serve(self, listening: socket.socket) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._bridge = _Bridge(self._html, listening, self._connected)
            port = listening.getsockname()[1]
            self.url, self.zmq_url = f"http://{HOST}:{port}/", self._bridge.zmq_url
        except Exception as error:  # ZMQ's errors are no OSErrors
            self._error = error
            listening.close()
            self._loop.close()
            return
        finally:
            self._ready.set()
        self._loop.run_forever()
        self._loop.run_until_complete(self._bridge.stop())
        self._loop.close()


class _Bridge(ZMQWebSocketBridge):
    """Meshcat's server on loopback, with our page and the frames so far."""

    def __init__(self, html: bytes, listening: socket.socket, connected: threading.Event) -> None:
        self._html, self._connected = html, connected
        self.listening = listening
        self._frames = bytearray()
        self._text = ""
        port = listening.getsockname()[1]
        super().__init__(zmq_url=f"tcp://{HOST}:*", host=HOST, port=port)

    def make_app(self) -> tornado.web.Application:
        options = {"bridge": self, "html": self._html, "connected": self._connected}
        self._server = None
        return _Application(
            self,
            [
                (r"/static/(.*)", _Static, {"path": VIEWER_ROOT, "default_filename": "index.html"}),
                (r"/", _Root, options),
            ],
            log_function=lambda _handler: None,
        )

    def setup_zmq(self, url: str) -> tuple[Any, Any, str]:
        socket_, stream, _ = super().setup_zmq(url)
        return socket_, stream, socket_.last_endpoint.decode().rstrip("\0")

    def add_frames(self, content: bytes) -> None:
        self._frames += content
        self._send("frames", umsgpack.Ext(FLOAT32, content), self.websocket_pool)

    def say(self, text: str) -> None:
        self._text = text
        self._send("state", text, self.websocket_pool)

    def send_scene(self, websocket: Any) -> None:
        super().send_scene(websocket)
        if self._frames:
            self._send("frames", umsgpack.Ext(FLOAT32, bytes(self._frames)), [websocket])
        if self._text:
            self._send("state", self._text, [websocket])

    def _send(self, name: str, value: Any, websockets: Any) -> None:
        command = {
            "type": "set_property",
            "path": "/softdyn/<object>",
            "property": name,
            "value": value,
        }
        data = umsgpack.packb(command)
        for websocket in tuple(websockets):
            with suppress(tornado.websocket.WebSocketClosedError):
                sent = websocket.write_message(data, binary=True)
                sent.add_done_callback(lambda done: done.exception())  # ignore: the page was closed

    async def stop(self) -> None:
        """Close every socket, after all data are sent."""
        if self._server is not None:
            self._server.stop()
        for websocket in tuple(self.websocket_pool):
            websocket.close()
        for _ in range(200):  # until the pages have received everything
            if not self.websocket_pool:
                break
            await asyncio.sleep(0.01)
        if self._server is not None:
            await self._server.close_all_connections()
        self.zmq_stream.close(linger=0)


class _Application(tornado.web.Application):
    """Listens on the bridge's socket and ignores other addresses; keeps the server to stop it."""

    def __init__(self, bridge: Any, handlers: Any, **settings: Any) -> None:
        super().__init__(handlers, **settings)
        self._bridge = bridge

    def listen(self, *_arguments: Any, **_options: Any) -> Any:
        self._bridge._server = server = tornado.httpserver.HTTPServer(self, max_body_size=MAX_BODY)
        server.add_socket(self._bridge.listening)
        return server


class _Local:
    """Refuses a request that names another host than this machine (DNS rebinding)."""

    request: Any

    def prepare(self) -> None:
        if not is_local(self.request):
            raise tornado.web.HTTPError(403)


class _Static(_Local, StaticFileHandlerNoCache):
    """Meshcat's own files."""


class _Root(_Local, WebSocketHandler):
    """The page, and the websocket that feeds it."""

    def initialize(self, html: bytes, connected: threading.Event) -> None:
        self._html, self._connected = html, connected

    async def get(self, *arguments: Any, **options: Any) -> None:
        if self.request.headers.get("Upgrade", "").lower() == "websocket":
            await super().get(*arguments, **options)
            return
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.finish(self._html)

    def open(self) -> None:
        self.bridge.websocket_pool.add(self)
        self.bridge.send_scene(self)
        self._connected.set()

    def on_message(self, message: str | bytes) -> None:
        with suppress(ValueError, KeyError, TypeError, AttributeError):
            self.bridge.send_image(json.loads(message)["data"])

    def on_close(self) -> None:
        self.bridge.websocket_pool.discard(self)
