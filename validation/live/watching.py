"""A closed loop in real time with pages that only watch: ``run --view``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np

from softdyn.description.visuals import Visual
from softdyn.tasks.marks import marks_of, target_row
from softdyn.validation.loop import setups
from softdyn.validation.loop.closed_loop import ClosedLoop, OnStep
from softdyn.validation.loop.labels import controller_title
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.record import ControlStep, tasks_in
from softdyn.view.live.channel import Channel
from softdyn.view.live.frames import Columns
from softdyn.view.live.pacing import RATE, Clock
from softdyn.view.live.page import open_live_page
from softdyn.view.scene import Figure

WAIT = 10.0  # s; a loop waits so long for a page before it starts


@dataclass(frozen=True)
class ViewerCost:
    """The cost of showing a loop, and its timing.

    Attributes
    ----------
    frames, dropped : int
        Frames shown, and frames dropped because the browser was slow.
    pace : float
        Simulated seconds per second of the clock.
    misses : int
        Periods whose work ended after the start of the next one.
    wake_us : dict of str to float
        Median, p99 and largest delay of the start of a period (µs).
    """

    frames: int
    dropped: int
    pace: float
    misses: int
    wake_us: dict[str, float]

    def __str__(self) -> str:
        late = f", began {self.wake_us['p99']:.0f} us late (p99)" if self.wake_us else ""
        return (
            f"viewer         {self.frames} frames, {self.dropped} dropped, {self.pace:.2f} x real "
            f"time, {self.misses} periods missed{late}"
        )


def open_watch_page(
    loop: ClosedLoop,
    port: int | None = None,
    scenery: Sequence[Visual] = (),
    origin: str | None = None,
) -> Channel:
    """Serve the page of a loop before it runs; its pages only watch.

    Parameters
    ----------
    loop : ClosedLoop
        Not yet begun.
    port : int, optional
        By default a free one from 7000 on.
    scenery : Sequence of Visual
        The shapes around the robot, in the world.
    origin : str, optional
        As of `Channel`.
    """
    model, experiment = loop.model, loop.experiment
    on_ellipse = experiment and (experiment.theta, experiment.omega) != (None, None)
    robot = model.bundled or model.name
    figure = Figure.of(model, marks_of(tasks_in(loop.controller)))
    title = f"{robot}, {controller_title(loop.name)}"
    if loop.plant.settings.get("plant") is not None:
        title += f", in {loop.plant.settings['plant']}"
    return open_live_page(
        figure.with_scenery(loop.surroundings, scenery), "watch", title=title, port=port,
        origin=origin,
        period=loop.grid.period, path=setups.ellipse_points(model) if on_ellipse else None,
    )  # fmt: skip


def columns_of(loop: ClosedLoop) -> Columns:
    """The columns of a frame of a loop's page."""
    marks = marks_of(tasks_in(loop.controller))
    return Columns(loop.model, sum(len(mark.columns) for mark in marks))


def frame_of(columns: Columns, loop: ClosedLoop, step: ControlStep, **timing: float) -> np.ndarray:
    """A frame of a loop's page; `timing` has its `misses`, `pace`, `step_us` and `wake_us`."""
    goal, tasks = loop.reference(step.t), tasks_in(loop.controller)
    return columns.frame(
        t=step.t, q=loop.model.coordinates(step.plant.q), y=step.plant.y, u=step.acting,
        targets=target_row(tasks, goal), y_ref=goal.y,
        V=getattr(step.output, "V", float("nan")), **timing,
    )  # fmt: skip


def watch(
    loop: ClosedLoop, channel: Channel, speed: float = 1.0, on_step: OnStep | None = None
) -> tuple[Log, ViewerCost]:
    """Run a loop while pages show it.

    Parameters
    ----------
    loop : ClosedLoop
        Not yet begun.
    channel : Channel
        Its `open_watch_page`.
    speed : float
        Simulated seconds per second of the clock.
    on_step : Callable[[float, State, ControllerOutput], None], optional
        As of `ClosedLoop.run`.

    Returns
    -------
    tuple[Log, ViewerCost]
        The run, and the cost of showing it.
    """
    columns, shown = columns_of(loop), 0
    clock = Clock(loop.grid.period, speed, keep=loop.grid.steps)
    channel.state({"law": controller_title(loop.name), "speed": speed})
    with loop.log_in_errors():
        while True:
            clock.wait()
            began = perf_counter_ns()
            step = loop.control()
            spent = (perf_counter_ns() - began) / 1e3
            if step is None:
                break
            if on_step is not None:
                on_step(step.t, step.state, step.output)
            if clock.frame(RATE):
                row = frame_of(
                    columns, loop, step, misses=clock.misses, pace=clock.pace,
                    step_us=clock.worst_step, wake_us=clock.worst_wake,
                )  # fmt: skip
                channel.frame(row)
                clock.worst_step = clock.worst_wake = 0.0
                shown += 1
            loop.advance()
            clock.done(spent)
    found = clock.statistics()
    channel.state({"notice": loop.reason or "done", "paused": True})
    return loop.log(), ViewerCost(shown, channel.dropped, found.pace, found.misses, found.wake_us)
