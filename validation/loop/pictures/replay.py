"""Pages that replay logs: one run at a time, or several side by side or overlaid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softdyn import SoftModel
from softdyn.controllers.channels import LogChannel
from softdyn.description.task_mark import TaskMark
from softdyn.description.visuals import Visual
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.labels import controller_title, goal, labels_of
from softdyn.validation.loop.log_data import LogData, own_channels
from softdyn.validation.loop.setups import ellipse_points
from softdyn.view.page import Page, PlayedRun, Series, Track, frames
from softdyn.view.scene import Figure

RATE = 30.0  # frames a second
MOST = 3000  # frames of one run
STRIDE = 0.02  # largest motion of the tip between two frames, in lengths of the robot
# green, magenta, olive, black, violet, light green: not the blue, orange and red of tensions
COLOURS = ("#009E73", "#C51B8A", "#B5BD00", "#111111", "#8E5BD0", "#9FE07A")
GAP = 1.25  # between robots side by side, in lengths of the robot


def replay(log: LogData, model: SoftModel, around: Sequence[Visual] = ()) -> Page:
    """One run as a page.

    Parameters
    ----------
    log : Log
        The run.
    model : SoftModel
        The robot of the log.
    around : Sequence of Visual
        The `scenery` of its plant; the log's own obstacles are shown too.

    Raises
    ------
    InputError
        When the log is another robot's.
    """
    figure = _figure(model, [log]).with_scenery(None, around)
    run = PlayedRun(goal(log), (track(log, model),))
    return Page(model.bundled or log.robot, (figure,), (run,))


def replays(logs: Sequence[LogData], model: SoftModel, name: str, rate: float = RATE) -> Page:
    """One page with several runs of one robot, chosen from a list."""
    marks = list(dict.fromkeys(log.marks for log in logs))
    runs = tuple(
        PlayedRun(
            goal(log) + (" (failed)" if log.failed else ""),
            (track(log, model, marks.index(log.marks), rate=rate),),
        )
        for log in logs
    )
    figure = _figure(model, logs[:1])
    return Page(name, tuple(replace(figure, marks=each) for each in marks), runs)


def show_runs(
    logs: Sequence[LogData],
    models: Sequence[SoftModel],
    labels: Sequence[str] | None = None,
    side_by_side: bool = False,
) -> Page:
    """One page with several runs at once: overlaid, or beside each other along x.

    Parameters
    ----------
    logs, models : Sequence[LogData], Sequence[SoftModel]
        The runs and the robot of each.
    labels : Sequence[str], optional
        Names in the legend, by default those of `labels_of`.
    side_by_side : bool
        Whether the runs stand beside each other.

    Raises
    ------
    InputError
        When a log is another robot's.
    """
    labels = labels_of(logs) if labels is None else labels
    shared = dict[tuple[int, tuple[TaskMark, ...]], tuple[SoftModel, list[LogData]]]()
    for log, model in zip(logs, models, strict=True):
        shared.setdefault((id(model), log.marks), (model, []))[1].append(log)
    figures = {key: _figure(*pair) for key, pair in shared.items()}
    order = list(figures)
    # overlaid runs share the first one's obstacles
    again = not side_by_side and any(one.scenery for one in figures.values())
    shown = (*figures.values(), *(replace(one, scenery=()) for one in figures.values() if again))
    x, tracks = 0.0, []
    for i, (log, model, label) in enumerate(zip(logs, models, labels, strict=True)):
        alone = i == 0 or side_by_side
        key = id(model), log.marks
        number = order.index(key) + (0 if alone or not again else len(order))
        made = track(log, model, number, path=alone)
        tracks.append(
            replace(
                made,
                label=label,
                colour=COLOURS[i % len(COLOURS)],
                tint=not side_by_side,
                opacity=1.0 if side_by_side or i == 0 else 0.55,
                offset=(x if side_by_side else 0.0, 0.0, 0.0),
            )
        )
        x += GAP * figures[key].size
    goals = list(dict.fromkeys(goal(log) for log in logs))
    robots = list(dict.fromkeys(log.robot for log in logs))
    run = PlayedRun(" and ".join(goals), tuple(tracks), max(float(log.t[-1]) for log in logs))
    return Page(" and ".join(robots), shown, (run,))


def _figure(model: SoftModel, logs: Sequence[LogData]) -> Figure:
    """A robot with the tasks of the first log, among the obstacles of the first that has any."""
    figure = Figure.of(model, logs[0].marks)
    around = next((found for log in logs if (found := log.surroundings) is not None), None)
    return figure.with_scenery(around)


def track(
    log: LogData, model: SoftModel, figure: int = 0, path: bool = True, rate: float = RATE
) -> Track:
    """A log as a track of at most `rate` frames a second and `MOST` in all."""
    log.source.check(model, "robot")
    last = log.finite_samples
    kept = _kept(log.t[:last], log.y[:last], rate, STRIDE * (log.length or np.inf))
    t = log.t
    # the input held from each sample on; the last sample repeats the one before
    u = log.u[np.minimum(kept, log.steps - 1)] if log.steps else np.zeros((len(kept), model.nu))
    if log.acting is not None:  # the last sample of a run that ended early may have none
        u = np.where(np.isfinite(log.acting[kept]), log.acting[kept], u)
    said = [f"in {log.plant}"] if log.plant else []
    said += ["inputs as they act, behind the rig"] if log.acting is not None else []
    said += [f"failed: {log.reason}"] if log.failed else []
    return Track(
        figure,
        frames(
            model,
            t[kept],
            log.q[kept],
            u,
            log.y[kept],
            log.y_ref[kept],
            None if log.targets is None else log.targets[kept],
        ),
        controller_title(log.controller),
        note="; ".join(said),
        path=reference_path(log, model) if path else None,
        failed=not log.complete,
        aims=log.kind != ROLLOUT,
        series=tuple(_series(channel, kept) for channel in own_channels(log)),
    )


def _series(channel: LogChannel, kept: np.ndarray) -> Series:
    """The values of a channel at some samples; a held one keeps its last value."""
    values = channel.values[np.minimum(kept, max(len(channel.values) - 1, 0))]
    return Series(channel.titles, values.reshape(len(values), len(channel.titles)))


def _kept(t: np.ndarray, y: np.ndarray, rate: float, stride: float) -> np.ndarray:
    """Samples at `rate` (Hz), and where the tip moves fast one every `stride` (m) of its path."""
    if not len(t):
        return np.arange(0)
    count = min(MOST, int(np.ceil(t[-1] * rate)) + 1)
    steady = np.searchsorted(t, np.linspace(0, t[-1], count)).clip(max=len(t) - 1)
    way = np.cumsum(np.linalg.norm(np.diff(y, axis=0, prepend=y[:1]), axis=1)) / stride
    fast = np.flatnonzero(np.diff(np.floor(way), prepend=0.0) > 0)
    return np.unique(np.concatenate((steady, fast[:MOST])))


def reference_path(log: LogData, model: SoftModel) -> np.ndarray | None:
    """The reference's path (K, 3): the ellipse of the paper's experiments, else the logged path."""
    if (log.theta, log.omega) != (None, None):
        points = ellipse_points(model)
        # a run of this name may have been on another ellipse
        if points is not None and _distance(points, log.y_ref[0]) < 0.05 * _distance(points, 0):
            return points
    moved = np.linalg.norm(np.ptp(log.y_ref, axis=0)) > 1e-6
    return log.y_ref[:: max(1, len(log.y_ref) // 400)] if moved else None


def _distance(points: np.ndarray, point: np.ndarray | float) -> float:
    return float(np.linalg.norm(points - point, axis=1).min())
