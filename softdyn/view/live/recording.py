"""The server's own work: replay pages of recordings, and the tips of stable equilibria.

The engine is imported at its first use, so that a server starts in half a second.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from functools import cached_property
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from softdyn.view.scene import Figure

MOST = 36_000  # frames of a recording
PULL = 6  # numbers of a pull: its force and its point
RAYS = 40  # random inputs that are raised to find reachable points
BATCH = 0.4  # s of search between two batches of points


class Recording:
    """Frames kept for a replay.

    Parameters
    ----------
    figure : bytes
        The robot's figure, pickled, because most servers never need it.
    replayed : int
        Number of columns that a replay has as its frames; the pull's force and point follow.
    title : str
        Title of the page.
    """

    def __init__(self, figure: bytes = b"", replayed: int = 0, title: str = "") -> None:
        self._pickled, self._replayed, self._title = figure, replayed, title
        self._rows: list[np.ndarray] = []
        self._done: np.ndarray | None = None
        self.on = False

    @cached_property
    def _figure(self) -> Figure:
        found: Figure = pickle.loads(self._pickled)
        return found

    def begin(self) -> None:
        """Start to keep frames."""
        self._rows, self.on = [], True

    def add(self, frame: bytes) -> bool:
        """Keep a frame that is later than the one before; True if the recording is full."""
        if not self.on:
            return False
        row = np.frombuffer(frame, "<f4")[: self._replayed + PULL].copy()
        if self._rows and row[0] < self._rows[-1][0]:
            self._rows = []  # the time was reset: a new run
        if not self._rows or row[0] > self._rows[-1][0]:
            self._rows.append(row)
        return len(self._rows) >= MOST

    def end(self) -> bool:
        """Stop; True if there are frames to replay."""
        self.on = False
        if self._rows:
            self._done = np.array(self._rows)
            self._done[:, 0] -= self._done[0, 0]
        return bool(self._rows)

    def html(self) -> str:
        """The last recording as a page; empty if there is none."""
        if self._done is None:
            return ""
        from softdyn.view.page import Page, PlayedRun, Track

        frames, pulls = np.hsplit(self._done, [self._replayed])
        track = Track(0, frames, self._title, pulls=pulls if np.isfinite(pulls).any() else None)
        run = PlayedRun("recorded", (track,))
        return Page(self._title, (self._figure,), (run,)).html()

    def rests(self) -> Iterator[list[list[float]]]:
        """Tips (x, y, z) (m) of stable equilibria, in batches."""
        from softdyn.statics import sample_rests

        model = self._figure.model
        batch, until = [], monotonic() + BATCH
        for one in sample_rests(model, RAYS) if model.nu else ():
            batch.append([round(float(x), 5) for x in one.y])
            if monotonic() > until:
                yield batch
                batch, until = [], monotonic() + BATCH
        if batch:
            yield batch
