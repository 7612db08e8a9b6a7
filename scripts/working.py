"""A line on the terminal that says what a command does, until the command writes something.

Afterwards a bar that has not moved for a while is drawn again, so that its clock goes on.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

QUIET = 2.0  # s without any output, before the line appears
EVERY = 1.0  # s between two of its texts
ERASE = "\r\x1b[K"


class _Working:
    """The line of the command that runs; see `working`."""

    def __init__(self, command: str) -> None:
        self.command, self.what = command, "starts"
        self._began, self._shown, self._heard = time.monotonic(), False, False
        self._over, self._lock = threading.Event(), threading.RLock()
        self._streams = {id(one): one for one in (sys.stdout, sys.stderr) if one is not None}
        self._writes: dict[int, Any] = {key: one.write for key, one in self._streams.items()}
        for key, stream in self._streams.items():
            stream.write = self._first(self._writes[key])  # type: ignore[method-assign]
        self._thread = threading.Thread(target=self._tell, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the line and the watch over bars."""
        self._over.set()
        self._hush()

    def _hush(self) -> None:
        """Erase the line, and give the streams back."""
        with self._lock:
            if self._heard:
                return
            self._heard = True
            for stream in self._streams.values():
                del stream.write
            if self._shown:
                self._put(ERASE)

    def _first(self, write: Any) -> Any:
        def first(text: str) -> Any:
            self._hush()
            return write(text)

        return first

    def _tell(self) -> None:
        while not self._over.wait(EVERY if self._shown or self._heard else QUIET):
            if self._heard:
                _refresh_bars()
                continue
            with self._lock:
                if not self._heard:
                    seconds = time.monotonic() - self._began
                    self._put(f"{ERASE}{self.command}: {self.what}, {seconds:.0f} s")
                    self._shown = True

    def _put(self, text: str) -> None:
        self._writes[id(sys.stderr)](text)
        sys.stderr.flush()


def _refresh_bars() -> None:
    """Draw the bars again that have not moved for `QUIET` seconds."""
    bars = sys.modules.get("tqdm.auto")
    for bar in list(getattr(bars.tqdm, "_instances", ())) if bars is not None else ():
        if not bar.disable and time.time() - bar.last_print_t > QUIET:
            bar.refresh()


_now: _Working | None = None


@contextmanager
def working(command: str) -> Iterator[None]:
    """Say on a terminal what `command` does, and for how long, while it has written nothing.

    The line appears after `QUIET` seconds. It goes with the first output of the command, such as a
    bar that says how far it is. Without a terminal there is no line.
    """
    global _now
    if _now is not None or sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    _now = _Working(command)
    try:
        yield
    finally:
        _now.end()
        _now = None


def doing(what: str) -> None:
    """Say in the line of the command what it does from now on, such as ``reads a.urdf``."""
    if _now is not None:
        _now.what = what
