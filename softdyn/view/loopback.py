"""Rules for every server: it serves this machine only, under this machine's own name."""

from __future__ import annotations

import socket
from typing import Any

from softdyn.exceptions import InputError

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
PORTS = range(7000, 7100)
MAX_BODY = 0  # bytes; pages send no body, and Tornado would store one before it is checked


def is_local(request: Any) -> bool:
    """Whether a request names this machine as its host; another name may be DNS rebinding."""
    return request.host_name in NAMES


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
