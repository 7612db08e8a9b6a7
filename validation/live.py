"""A closed loop shown while it runs, at the pace of a clock."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter, sleep
from typing import Any

import numpy as np

from softdyn import Reference, SoftModel, State
from softdyn.figure import Figure
from softdyn.page import Page, Run, Track, frames
from softdyn.viewer import Viewer
from validation.paper import Experiment
from validation.replay import controller_title, ellipse

RATE = 30.0  # frames a second of a clock
WAIT = 10.0  # s that a loop waits for a browser before it starts


def live_page(model: SoftModel, name: str, experiment: Experiment) -> Page:
    """An empty page for a loop that is about to run."""
    width = 1 + model.nv + model.nu + 6
    paper_s = (experiment.theta, experiment.omega) != (None, None)
    path = ellipse(model) if paper_s else None
    empty = Track(0, np.zeros((0, width)), controller_title(name), path=path)
    run = Run("live", (empty,), duration=experiment.duration)
    return Page(model.bundled or model.name, (Figure.of(model),), (run,), live=True)


class Show:
    """Called at every control step (`on_step` of `simulate`): shows frames and keeps the pace.

    The clock is looked at once a frame, not once a step, so that the steps between two frames
    follow each other as they do without a viewer.

    Parameters
    ----------
    speed : simulated seconds per second of the clock.

    Attributes
    ----------
    frame_us : what each frame took (µs), the wait for its time left out.
    """

    def __init__(
        self,
        viewer: Viewer,
        model: SoftModel,
        reference: Callable[[float], Reference],
        speed: float = 1.0,
    ) -> None:
        self._viewer, self._model, self._reference = viewer, model, reference
        self._speed = speed
        self._every = speed / RATE
        self._next = 0.0
        self._began: float | None = None
        self._t = 0.0
        self.frame_us: list[float] = []

    def __call__(self, t: float, state: State, answer: Any) -> None:
        """Show the loop at time `t` (s) if a frame is due."""
        if t < self._next:
            return
        self._next, self._t = t + self._every - 1e-9, t
        began = perf_counter()
        model = self._model
        u = np.minimum(np.maximum(np.asarray(answer.u, float), model.u_min), model.u_max)
        row = frames(model, [t], state.q[None], u[None], state.y[None], self._reference(t).y[None])
        self._viewer.push(row)
        if self._began is None:
            self._began = began
        self.frame_us.append(1e6 * (perf_counter() - began))
        ahead = self._began + t / self._speed - perf_counter()
        if ahead > 0:
            sleep(ahead)

    def report(self) -> dict[str, float | int | None]:
        """Frames, what they took, and the pace that was kept (simulated s per s)."""
        spent = perf_counter() - self._began if self._began is not None else 0.0
        return {
            "frames": len(self.frame_us),
            "frame_us_median": float(np.median(self.frame_us)) if self.frame_us else None,
            "frame_us_max": max(self.frame_us, default=None),
            "pace": self._t / spent if spent > 0 else None,
        }
