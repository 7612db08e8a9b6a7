"""A closed loop shown while it runs, at the pace of a clock."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter, sleep
from typing import Any

import numpy as np

from softdyn import Reference, SoftModel, State
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.report.replay import controller_title, ellipse
from softdyn.view.page import Page, Run, Track, frames
from softdyn.view.scene import Figure
from softdyn.view.server import Viewer

RATE = 30.0  # frames a second of a clock
BATCH = 5  # frames sent at once; the page plays them on a clock of its own
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

    Frames are made and sent, and the clock is looked at, once every `BATCH` frames: after each wait
    the caches are cold, and the fewer there are, the more steps take what they take without a
    viewer.

    Parameters
    ----------
    speed : simulated seconds per second of the clock.
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
        self._kept: list[tuple[float, State, np.ndarray]] = []
        self._next = self._t = self._spent = 0.0
        self._frames = 0
        self._began = perf_counter()

    def __call__(self, t: float, state: State, answer: Any) -> None:
        """Keep the loop's state at time `t` (s) if a frame is due, and show it with the next."""
        if t < self._next:
            return
        began = perf_counter()
        if not self._frames:
            self._began = began
        self._next, self._t = t + self._speed / RATE - 1e-9, t
        self._kept.append((t, state, np.array(answer.u, float)))
        self._frames += 1
        if len(self._kept) < BATCH:
            self._spent += perf_counter() - began
            return
        self._send()
        self._spent += perf_counter() - began
        ahead = self._began + t / self._speed - perf_counter()
        if ahead > 0:
            sleep(ahead)

    def finish(self) -> dict[str, float | int | None]:
        """Show what is left; returns the number of frames, the mean time of one (µs) and the pace.

        The pace is simulated seconds per second of the clock, None for a loop without a step.
        """
        took = perf_counter() - self._began
        self._send()
        return {
            "frames": self._frames,
            "frame_us": 1e6 * self._spent / self._frames if self._frames else None,
            "pace": self._t / took if took > 0 and self._frames else None,
        }

    def _send(self) -> None:
        if not self._kept:
            return
        model = self._model
        t, states, u = zip(*self._kept, strict=True)
        self._kept.clear()
        q, y = (np.array([getattr(state, name) for state in states]) for name in ("q", "y"))
        y_ref = np.array([self._reference(moment).y for moment in t])
        inputs = np.minimum(np.maximum(np.array(u), model.u_min), model.u_max)
        self._viewer.push(frames(model, t, q, inputs, y, y_ref))
