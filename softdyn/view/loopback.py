"""Rules for every server: it serves this machine only, under this machine's own name.

A proxy on this machine may pass requests on, from one origin that the user names.
"""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from softdyn.exceptions import InputError

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
PORTS = range(7000, 7100)
MAX_BODY = 0  # bytes; pages send no body, and Tornado would store one before it is checked


def is_local(request: Any, origin: str | None = None) -> bool:
    """Whether a request names this machine or the host of `origin`, and no DNS rebinding is.

    A request for the host of `origin` may come from a page of this very origin only.
    """
    if request.host_name in NAMES or origin is None:
        return request.host_name in NAMES
    sent = request.headers.get("Origin", origin).lower()
    return bool(request.host.lower() == urlsplit(origin).netloc and sent == origin)


def read_origin(text: str) -> str:
    """An origin such as ``https://host:port``: scheme, host and port, nothing else.

    Raises
    ------
    InputError
        For another text.
    """
    with suppress(ValueError):
        parts = urlsplit(text.strip().removesuffix("/"))
        plain = f"{parts.scheme}://{parts.netloc}".lower()
        sound = parts.scheme in ("http", "https") and parts.hostname and "@" not in parts.netloc
        if sound and text.strip().removesuffix("/").lower() == plain and parts.port != 0:
            return plain
    raise InputError("--origin", "an origin such as https://host.example", repr(text))


def listener(port: int | None) -> socket.socket:
    """A socket that listens on `port`, or on the first free one of `PORTS`.

    The socket is opened at once, so that no other program can take the port.

    Raises
    ------
    InputError
        If no port is free.
    """
    reason: Exception | None = None
    for candidate in PORTS if port is None else (port,):
        found = socket.socket()
        try:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.bind((HOST, candidate))
            found.listen(128)
            found.setblocking(False)
            return found
        except (OSError, OverflowError) as error:
            found.close()
            reason = error
    expected = "a free port" if port is not None else f"a free port in {PORTS[0]}-{PORTS[-1]}"
    raise InputError("--port", expected, f"{port}: {reason}" if port is not None else "none")
