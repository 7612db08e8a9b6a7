"""Figures over time: errors, inputs and their bounds of a few runs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from softdyn.controllers.channels import LogChannel
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.labels import labels_of
from softdyn.validation.loop.log_data import LogData, own_channels
from softdyn.validation.loop.metrics import CM, SIGMAS
from softdyn.validation.loop.pictures import plot_style as look
from softdyn.validation.loop.verdict import activity

FINEST = 1e-4  # cm; errors below a micrometre are drawn as one


def compare(logs: Sequence[LogData], labels: Sequence[str]) -> Figure:
    """‖e‖ (cm, logarithmic) over time of every run, with every run's inputs below.

    Rollouts have the coordinates of the tip instead of ‖e‖. A run that diverged is drawn up to its
    last finite sample. Estimated disturbances with their 95 % intervals are below, a row per unit.
    Below them is a row for each channel of a user's own controller or plant that has numbers. Runs
    among obstacles have the least reserve of their barriers at the bottom. Rows of one quantity
    have the same scale.
    """
    estimated = [
        (log, label, unit)
        for log, label in zip(logs, labels, strict=True)
        for unit in dict.fromkeys(unit for _, unit in log.columns("disturbances"))
    ]
    own = [
        (log, label, channel)
        for log, label in zip(logs, labels, strict=True)
        for channel in own_channels(log)
        if not channel.text and np.isfinite(channel.values).any()
    ]
    among = [
        (log, label, log.reserve)
        for log, label in zip(logs, labels, strict=True)
        if log.reserve is not None
    ]
    rows = 1 + len(logs) + len(estimated) + len(own) + bool(among)
    figure, grid = look.panels(rows, 1, look.PAGE, 1.5 * rows + 0.3, sharex="col")
    (errors,), *inputs = grid[: 1 + len(logs)]
    for (axes,), shown in zip(grid[1 + len(logs) :], estimated, strict=False):
        draw_disturbances(axes, *shown)
    for (axes,), one in zip(grid[1 + len(logs) + len(estimated) :], own, strict=False):
        draw_own(axes, *one)
    if among:
        draw_reserves(grid[-1][0], among)
    (draw_tips if any(log.kind == ROLLOUT for log in logs) else draw_errors)(errors, logs, labels)
    for (axes,), log, label in zip(inputs, logs, labels, strict=True):
        if log.u.size:
            draw_inputs(axes, log)
            scale_inputs(axes, [one for one in logs if one.u.size and one.u_unit == log.u_unit])
        axes.set_ylabel(f"u ({log.u_unit})")
        axes.set_title(label + input_activity(log), loc="left")
    scale_alike([axes for (axes,) in grid[1:]])
    errors.set_xlim(0, max(log.duration for log in logs))
    grid[-1][0].set_xlabel(look.TIME)
    return figure


def draw_errors(axes: Axes, logs: Sequence[LogData], labels: Sequence[str]) -> None:
    """Draw ‖e‖ (cm) of every run on a logarithmic scale."""
    for i, (log, label) in enumerate(zip(logs, labels, strict=True)):
        error = np.maximum(finite_errors(log), FINEST)
        kept = thin(error, bins=600)
        name = f"{label} (failed)" if log.failed else label
        t = log.t[: len(error)]
        look.line(axes, t[kept], error[kept], look.INPUTS[i % len(look.INPUTS)], label=name)
    axes.set_yscale("log")
    axes.set_ylabel("‖e‖ (cm)")
    axes.legend()


def draw_reserves(axes: Axes, runs: Sequence[tuple[LogData, str, np.ndarray]]) -> None:
    """Draw the least reserve (mm) of each run among its barriers; below 0 a link is inside."""
    for i, (log, label, reserve) in enumerate(runs):
        least = 1e3 * np.min(reserve, axis=1)[: log.finite_samples]
        kept = thin(least, bins=600)
        colour = look.INPUTS[i % len(look.INPUTS)]
        look.line(axes, log.t[: len(least)][kept], least[kept], colour, label=label)
    axes.axhline(0, color=look.NEUTRAL, linestyle=look.DOTTED, linewidth=0.8)
    axes.set_ylabel("least reserve (mm)")


def draw_disturbances(axes: Axes, log: LogData, label: str, unit: str) -> None:
    """Draw the estimated disturbances of one unit, with their 95 % intervals."""
    assert log.disturbances is not None
    assert log.deviations is not None
    names = [name for name, of_column in log.columns("disturbances") if of_column == unit]
    columns = [k for k, (name, _) in enumerate(log.columns("disturbances")) if name in names]
    t = log.t[: log.finite_samples]
    for i, (k, name) in enumerate(zip(columns, names, strict=True)):
        value, half = log.disturbances[: len(t), k], SIGMAS * log.deviations[: len(t), k]
        kept = thin(value, bins=600)
        colour = look.INPUTS[i % len(look.INPUTS)]
        look.line(axes, t[kept], value[kept], colour, label=name)
        axes.fill_between(
            t[kept], (value - half)[kept], (value + half)[kept], color=colour[0], alpha=0.2, lw=0
        )
    axes.set_ylabel(f"estimated ({unit or 1})")
    axes.set_title(label, loc="left")
    if len(columns) <= len(look.INPUTS):
        axes.legend()


def draw_own(axes: Axes, log: LogData, label: str, channel: LogChannel) -> None:
    """Draw the columns of a channel of a user's own controller or plant."""
    columns = channel.values.reshape(len(channel.values), -1).T
    for i, (name, values) in enumerate(zip(channel.titles, columns, strict=True)):
        shown = np.append(values, values[-1])[: len(log.t)] if channel.held else values
        kept = np.flatnonzero(np.isfinite(shown))
        if len(kept):
            kept = kept[thin(shown[kept], bins=600)]
        steps = "steps-post" if channel.held else "default"
        colour = look.INPUTS[i % len(look.INPUTS)]
        look.line(axes, log.t[kept], shown[kept], colour, label=look.plain(name), drawstyle=steps)
    units = dict.fromkeys(channel.units)
    axes.set_ylabel(look.plain(f"{channel.name} ({', '.join(unit or '1' for unit in units) or 1})"))
    axes.set_title(label, loc="left")
    if 1 < len(columns) <= len(look.INPUTS):
        axes.legend()


def draw_tips(axes: Axes, logs: Sequence[LogData], labels: Sequence[str]) -> None:
    """Draw the tip's coordinates (cm) of every run, relative to its start."""
    for i, (log, label) in enumerate(zip(logs, labels, strict=True)):
        moved = CM * (log.y - log.y[0])[: log.finite_samples]
        kept = thin(*moved.T, bins=600)
        for axis, way, style in zip("xyz", moved.T, ("-", "--", ":"), strict=True):
            colour = look.INPUTS[i % len(look.INPUTS)][0]
            look.line(axes, log.t[kept], way[kept], (colour, style), label=f"{label}, {axis}")
    axes.set_ylabel("tip from its start (cm)")
    axes.legend()


def save_comparison(
    path: str | Path, logs: Sequence[LogData], labels: Sequence[str] | None = None
) -> None:
    """Write the figure of `compare`, .png or .pdf; `labels` name the runs."""
    path = look.check_path(path)
    with look.style():
        look.write_figure(compare(logs, labels or labels_of(logs)), path, dpi=120)


def plot(log: LogData, path: str | Path | None = None) -> Figure:
    """One run's error and inputs over time; `path` is a .png or .pdf to write as well."""
    if path is not None:
        save_comparison(path, [log])
    with look.style():
        return compare([log], labels_of([log]))


def input_activity(log: LogData) -> str:
    """Rate of change of a run's inputs, for a title; empty without inputs."""
    changes, *_ = activity(log.t, log.u, log.u_min, log.u_max)
    return "" if changes is None else f", {changes:.3g} of the range/s"


def draw_inputs(axes: Axes, log: LogData) -> None:
    """Draw every held input u_i of a run, and its bounds."""
    for i in range(log.u.shape[1]):
        held = np.append(log.u[:, i], log.u[-1, i])[: len(log.t)]
        kept = thin(held, bins=600)
        colour = look.INPUTS[i % len(look.INPUTS)]
        look.line(axes, log.t[kept], held[kept], colour, linewidth=0.9, drawstyle="steps-post")
    for bound in sorted({*log.u_min, *log.u_max}):
        if np.isfinite(bound):
            axes.axhline(bound, color=look.NEUTRAL, linestyle=look.DOTTED, linewidth=0.8)
    if log.failed:
        axes.plot(log.t[-1], log.u[-1, 0], color=look.NEUTRAL, clip_on=False, **look.FAILED)
    axes.set_xlim(0, log.duration)
    axes.xaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))


def scale_inputs(axes: Axes, logs: Sequence[LogData]) -> None:
    """Scale the vertical axis to the bounds; logarithmic away from 0 if most inputs are near 0.

    Inputs ten times smaller than the bounds would be invisible on a linear axis.
    """
    low = min(float(log.u_min.min()) for log in logs)
    high = max(float(log.u_max.max()) for log in logs)
    if not np.isfinite(high - low):
        return
    largest = max(-low, high)
    typical = float(np.median(np.concatenate([np.abs(log.u).ravel() for log in logs])))
    if typical < largest / 10:
        linear = 10.0 ** np.floor(np.log10(max(typical, largest / 1000)))
        axes.set_yscale("symlog", linthresh=linear)
        axes.set_ylim(
            *(1.5 * x if x else 0.3 * side * linear for x, side in ((low, -1), (high, 1)))
        )
    else:
        margin = 0.06 * (high - low)
        axes.set_ylim(low - margin, high + margin)


def scale_alike(rows: Sequence[Axes]) -> None:
    """Give rows with the same label, and so of one quantity, the same vertical axis."""
    for label in dict.fromkeys(axes.get_ylabel() for axes in rows):
        same = [axes for axes in rows if axes.get_ylabel() == label]
        ends = np.array([axes.get_ylim() for axes in same])
        for axes in same:
            axes.set_ylim(float(ends.min()), float(ends.max()))


def finite_errors(log: LogData) -> np.ndarray:
    """‖e‖ (cm) of a log's samples, up to the first that is not finite."""
    return CM * np.linalg.norm(log.error[: log.finite_samples], axis=1)


def thin(*columns: np.ndarray, bins: int = 400) -> np.ndarray:
    """Indices that give the same curves: the ends and, in each bin, every column's extremes.

    Parameters
    ----------
    columns : np.ndarray, (N,)
        Finite columns of equal length.
    bins : int
        Number of equal parts into which the samples are divided.

    Returns
    -------
    np.ndarray, (K,)
        Increasing indices, K ≤ 2 · bins · number of columns + 2; all of them if that is not fewer.
    """
    n = len(columns[0])
    if n <= 2 * bins * len(columns) + 2:
        return np.arange(n)
    edges = np.linspace(0, n, bins + 1).astype(int)
    keep = {0, n - 1}
    for column in columns:
        for begin, end in pairwise(edges):
            part = column[begin:end]
            keep |= {begin + int(part.argmin()), begin + int(part.argmax())}
    return np.array(sorted(keep))
