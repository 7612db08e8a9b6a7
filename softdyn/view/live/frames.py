"""A frame: one row of numbers, all that a page draws at one moment."""

from __future__ import annotations

import numpy as np

from softdyn.dynamics.model import SoftModel


class Columns:
    """The columns of a frame; a missing value is NaN.

    A frame is float32. It holds: time (s), joint coordinates, inputs, the numbers of the targets of
    tasks, the tip and its target (m), the pushing force (N) and its point (m),
    V, the slowest step and the latest wake-up since the last frame (µs), the count of missed
    periods, simulated seconds per second, the ghost's joint coordinates, its tip's distance from
    the plant's (m), 1 if an equilibrium is stable and else 0, and the tip's compliance (m/N), row
    by row.

    Attributes
    ----------
    places : dict of str to slice
        Columns by name.
    size : int
        Number of columns.
    """

    def __init__(self, model: SoftModel, numbers: int = 0) -> None:
        n, m = model.nv, model.nu
        sizes = {
            "t": 1, "q": n, "u": m, "targets": numbers, "y": 3, "y_ref": 3,
            "force": 3, "point": 3, "V": 1, "step_us": 1, "wake_us": 1, "misses": 1, "pace": 1,
            "ghost": n, "gap": 1, "stable": 1, "compliance": 9,
        }  # fmt: skip
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self.places = {name: slice(ends[i], ends[i + 1]) for i, name in enumerate(sizes)}
        self.size = ends[-1]
        self.replayed = ends[6]  # the columns of `page.frames`; force and point follow

    def frame(self, **values: object) -> np.ndarray:
        """A frame of these values, by name."""
        row = np.full(self.size, np.nan, np.float32)
        with np.errstate(over="ignore"):
            for name, value in values.items():
                row[self.places[name]] = value
        return row

    @property
    def data(self) -> dict[str, list[int]]:
        """First column and size of each, as JSON."""
        return {name: [at.start, at.stop - at.start] for name, at in self.places.items()}
