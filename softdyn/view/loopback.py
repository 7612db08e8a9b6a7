"""What every server of pages keeps to: this machine alone, by its own name, on a free port."""

from __future__ import annotations

import socket
from typing import Any

from softdyn.exceptions import InputError

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
PORTS = range(7000, 7100)


def is_local(request: Any) -> bool:
    """Whether a request came by this machine's own name (else it may be DNS rebinding)."""
    return request.host_name in NAMES


def free_port(port: int | None) -> int:
    """`port`, or the first one of `PORTS` that nobody has.

    Raises
    ------
    InputError
        When there is none.
    """
    reason: Exception | None = None
    for candidate in PORTS if port is None else (port,):
        try:
            with socket.socket() as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((HOST, candidate))
            return candidate
        except (OSError, OverflowError) as error:
            reason = error
    expected = "a free port" if port is not None else f"a free port in {PORTS[0]}-{PORTS[-1]}"
    raise InputError("--port", expected, f"{port}: {reason}" if port is not None else "none")
