"""A closed loop shown while it runs, at the pace of a clock."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, sleep
from typing import Any

import numpy as np

from softdyn import State
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.log import Log
from softdyn.validation.studies import paper
from softdyn.validation.studies.names import controller_title
from softdyn.view.page import Page, Run, Track, frames
from softdyn.view.scene import Figure
from softdyn.view.server import Viewer

RATE = 30.0  # frames a second of a clock
BATCH = 5  # frames sent at once; the page plays them on a clock of its own
WAIT = 10.0  # s that a loop waits for a browser before it starts


def live_page(loop: ClosedLoop) -> Page:
    """An empty page for a loop that is about to run."""
    model, experiment = loop.model, loop.experiment
    width = 1 + model.nv + model.nu + 6
    on_ellipse = experiment and (experiment.theta, experiment.omega) != (None, None)
    path = paper.ellipse_points(model) if on_ellipse else None
    empty = Track(0, np.zeros((0, width)), controller_title(loop.name), path=path)
    run = Run("live", (empty,), duration=loop.grid.duration)
    return Page(model.bundled or model.name, (Figure.of(model),), (run,), live=True)


@dataclass(frozen=True)
class Shown:
    """What showing a loop cost.

    Attributes
    ----------
    frames : int
        Number of frames.
    frame_us : float or None
        Mean time of one (µs), None without any.
    pace : float or None
        Simulated seconds per second of the clock, None for a loop without a step.
    """

    frames: int
    frame_us: float | None
    pace: float | None

    def __str__(self) -> str:
        return (
            f"viewer         {self.frames} frames of {self.frame_us or 0:.0f} us, "
            f"none of it in the step time; {self.pace or 0:.2f} x real time"
        )


def watch(loop: ClosedLoop, viewer: Viewer, speed: float = 1.0) -> tuple[Log, Shown]:
    """Run a loop while a page shows it.

    Parameters
    ----------
    loop : ClosedLoop
        The loop, not yet begun.
    viewer : Viewer
        Serves its `live_page`.
    speed : float
        Simulated seconds per second of the clock.

    Returns
    -------
    tuple[Log, Shown]
        The run, and what showing it cost.
    """
    show = Show(loop, viewer, speed)
    log = loop.run(progress=True, on_step=show)
    shown = show.finish()
    viewer.say("done: the page keeps the run")
    return log, shown


class Show:
    """Called at every control step: shows frames and keeps the pace.

    Frames are made and sent, and the clock is looked at, once every `BATCH` frames: after each wait
    the caches are cold, and the fewer there are, the more steps take what they take without a
    viewer. `watch` explains the parameters.
    """

    def __init__(self, loop: ClosedLoop, viewer: Viewer, speed: float) -> None:
        self._loop, self._viewer, self._speed = loop, viewer, speed
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

    def finish(self) -> Shown:
        """Show what is left."""
        took = perf_counter() - self._began
        self._send()
        if not self._frames:
            return Shown(0, None, None)
        return Shown(
            self._frames, 1e6 * self._spent / self._frames, self._t / took if took > 0 else None
        )

    def _send(self) -> None:
        if not self._kept:
            return
        model = self._loop.model
        t, states, u = zip(*self._kept, strict=True)
        self._kept.clear()
        q, y = (np.array([getattr(state, name) for state in states]) for name in ("q", "y"))
        y_ref = np.array([self._loop.reference(moment).y for moment in t])
        inputs = np.clip(np.array(u), model.u_min, model.u_max)
        self._viewer.push(frames(model, t, q, inputs, y, y_ref))
