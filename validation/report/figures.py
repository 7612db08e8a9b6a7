"""The paper's figures, each a function of the runs; None without runs for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from softdyn.validation.loop.labels import experiment_title
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.pictures import plot_style as look
from softdyn.validation.loop.pictures.time_figures import (
    FINEST,
    draw_inputs,
    input_activity,
    scale_inputs,
    thin,
)
from softdyn.validation.report.plot_data import (
    EXAMPLE,
    OURS,
    PlottedRun,
    distinct,
    lyapunov_band,
    main_controller,
    of,
    preferred,
    thin_path,
)

TICKS = 4  # at most, on a small panel's axis
PATH_TOLERANCE = 0.02  # cm; tolerance of simplified paths, less than a printed dot
REFERENCE_WIDTH = 3.5
WILD_LENGTHS, WILD_DECADES = 8.0, 60.0  # a curve with a larger total variation is wild


def lyapunov(runs: Sequence[PlottedRun], kind: str) -> Figure | None:
    """V/V(0) over time, one curve and band per robot (the paper's Figs. clf_set, clf_tracking).

    The time of trajectories is in cycles, because their duration depends on their rate.
    """
    name, runs = main_controller(of(runs, kind=kind))
    colours = look.looks(distinct(runs, "robot"), look.ROBOTS)
    bands = {robot: lyapunov_band(of(runs, robot)) for robot in distinct(runs, "robot")}
    shown = {robot: band for robot, band in bands.items() if band is not None}
    if not shown:
        return None
    span = 2.0 if kind == "tracking" else max(run.log.duration for run in runs)
    figure, ((axes,),) = look.panels(1, 1, look.COLUMN, 2.5)
    for robot, band in shown.items():
        colour, _ = colours[robot]
        axes.fill_between(span * band.s, band.low, band.high, color=colour, alpha=0.16, linewidth=0)
        look.line(axes, span * band.s, band.mean, colours[robot])
        for s, value in band.ends:
            axes.plot(span * s, value, color=colour, **look.FAILED)
    axes.set_xlabel("Time (cycles of the reference)" if kind == "tracking" else look.TIME)
    axes.set_ylabel(r"$V(t)\,/\,V(0)$  (–)")
    axes.set_xlim(0, span)
    axes.xaxis.set_major_locator(MaxNLocator(2 * TICKS, steps=[1, 2, 5, 10]))
    log_axis(axes)
    titles = {robot: look.robot_title(robot) for robot in shown}
    failed = any(band.ends for band in shown.values())
    look.legend_above(figure, look.legend_handles(titles, colours, failed))
    axes.set_title(f"{look.controller_title(name)}: geometric mean and range", loc="left")
    return figure


def convergence(runs: Sequence[PlottedRun], robot: str) -> Figure | None:
    """A robot's tip in x–z from rest to each set point (the paper's Fig. spirob_error)."""
    _, runs = main_controller(of(runs, robot, kind="set_point"))
    if not runs:
        return None
    width = max(look.COLUMN, 1.7 * len(runs) + 0.36)
    spans = [np.ptp(np.vstack([run.path, run.goal]), axis=0) for run in runs]
    x, z = np.maximum(np.max(spans, axis=0), 1e-3)
    height = np.clip((width - 0.9) / len(runs) * z / x, 0.8, 3.0) + 1.0
    figure, (row,) = look.panels(1, len(runs), width, float(height), sharex=True, sharey=True)
    longest = max(run.log.duration for run in runs)
    norm = PowerNorm(0.4, 0, longest)  # the beginning shows the transient
    for i, (axes, run) in enumerate(zip(row, runs, strict=True)):
        log = run.log
        kept = thin_path(run.path, PATH_TOLERANCE)
        points = run.path[kept]
        (x, z), end = points[0], points[-1]
        lines = LineCollection(
            list(np.stack((points[:-1], points[1:]), axis=1)), array=log.t[kept][:-1], norm=norm,
            cmap="viridis", capstyle="round", linewidth=1.4,
        )  # fmt: skip
        axes.add_collection(lines)
        axes.plot(x, z, "o", color=look.BLACK, markerfacecolor="white", zorder=3)
        axes.plot(*run.goal[-1], "+", color=look.VERMILLION, markersize=9, mew=1.4)
        if log.failed:
            axes.plot(*end, color=look.NEUTRAL, **look.FAILED)
        axes.set_aspect("equal")
        reached, ended = f"‖e(T)‖ = {run.error[-1]:.2g} cm", f"ended at {log.t[-1]:.2g} s"
        title = experiment_title("set_point", run.case.value)
        look.letter(axes, i, f"{title}\n{reached if log.complete else ended}")
        axes.set_xlabel("x (cm)")
        axes.xaxis.set_major_locator(MaxNLocator(TICKS))
    row[0].set_ylabel("z (cm)")
    bar = figure.colorbar(lines, ax=row, label=look.TIME, pad=0.01, aspect=25)
    bar.set_ticks([longest * part for part in (0, 0.05, 0.1, 0.2, 0.5, 1)])
    handles = [
        look.handle("rest", (look.BLACK, ""), marker="o", markerfacecolor="white"),
        look.handle(
            "target $(x_d, z_d)$", (look.VERMILLION, ""), marker="+", markersize=9, mew=1.4
        ),
        *look.legend_handles({}, {}, any(run.log.failed for run in runs)),
    ]
    look.legend_above(figure, handles)
    return figure


def tracking(runs: Sequence[PlottedRun]) -> Figure | None:
    """Tip paths of the second cycle, a panel per robot, a line per controller (Fig. tracking)."""
    runs = of(runs, kind="tracking")
    if not runs:
        return None
    rate = preferred(distinct(runs, "value"), EXAMPLE["tracking"])
    runs = of(runs, value=rate)
    robots, controllers = distinct(runs, "robot"), distinct(runs, "controller")
    colours = look.looks(controllers, look.CONTROLLERS)
    figure, (row,) = look.panels(1, len(robots), max(look.COLUMN, 2.387 * len(robots)), 2.9)
    for i, (axes, robot) in enumerate(zip(row, robots, strict=True)):
        draw_second_cycles(axes, of(runs, robot), colours)
        look.letter(axes, i, look.robot_title(robot))
    row[0].set_ylabel("z (cm)")
    title = f"reference, {experiment_title('tracking', rate)}"
    reference = look.handle(title, (look.REFERENCE, "-"), linewidth=REFERENCE_WIDTH)
    look.legend_above(figure, [reference, *legend(runs, colours)])
    return figure


def draw_second_cycles(axes: Axes, runs: Sequence[PlottedRun], colours: dict[str, Any]) -> None:
    """Draw one robot's reference and tip paths in the second half of the planned duration."""
    reference = max(runs, key=lambda run: len(run.log.t)).goal
    axes.plot(*reference.T, color=look.REFERENCE, linewidth=REFERENCE_WIDTH, zorder=1)
    early = []
    for run in runs:
        name = run.case.controller
        second = run.log.t >= run.log.duration / 2 * (1 - 1e-9)
        if not second.any():
            early.append(f"{look.controller_title(name)}, {run.log.t[-1]:.2g} s")
            continue
        path = run.path[second]
        path = path[thin_path(path, PATH_TOLERANCE)]
        wild = length(path) > WILD_LENGTHS * length(reference) / 2
        look.line(axes, path[:, 0], path[:, 1], colours[name], **weight(run, wild))
        if run.log.failed:
            axes.plot(*path[-1], color=colours[name][0], zorder=4, **look.FAILED)
    if early:
        text = "\n".join(("ended before:", *early))
        axes.text(0.99, 0.99, text, transform=axes.transAxes, ha="right", va="top", fontsize=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x (cm)")


def errors(runs: Sequence[PlottedRun], kind: str) -> Figure | None:
    """‖e‖ over time: a row per robot, a column per experiment, a line per controller."""
    runs = of(runs, kind=kind)
    if not runs:
        return None
    robots, values = distinct(runs, "robot"), distinct(runs, "value")
    controllers = distinct(runs, "controller")
    colours = look.looks(controllers, look.CONTROLLERS)
    least = look.PAGE if len(values) > 2 else look.COLUMN
    width, height = max(least, 1.36 * len(values) + 0.36), 1.35 * len(robots) + 0.65
    figure, grid = look.panels(len(robots), len(values), width, height, sharex="col", sharey="row")
    for row, robot in zip(grid, robots, strict=True):
        for axes, value in zip(row, values, strict=True):
            for run in of(runs, robot, value=value):
                colour = colours[run.case.controller]
                error = np.maximum(run.error, FINEST)
                kept = thin(error, bins=200)
                wild = np.abs(np.diff(np.log10(error[kept]))).sum() > WILD_DECADES
                look.line(axes, run.log.t[kept], error[kept], colour, **weight(run, wild))
                if run.log.failed:
                    axes.plot(run.log.t[-1], error[-1], color=colour[0], zorder=4, clip_on=False,
                              **look.FAILED)  # fmt: skip
            axes.set_xlim(0, max(run.log.duration for run in of(runs, value=value)))
            axes.xaxis.set_major_locator(MaxNLocator(TICKS, steps=[1, 2, 5, 10]))
            log_axis(axes)
        row[0].set_ylabel(f"{look.robot_title(robot)}\n‖e‖ (cm)")
    for axes, value in zip(grid[0], values, strict=True):
        axes.set_title(experiment_title(kind, value))
    for axes in grid[-1]:
        axes.set_xlabel(look.TIME)
    look.legend_above(figure, legend(runs, colours))
    return figure


def legend(runs: Sequence[PlottedRun], colours: dict[str, look.Look]) -> list[Line2D]:
    """Handles for the runs' controllers, and for the mark of failed runs if there are any."""
    titles = {name: look.controller_title(name) for name in distinct(runs, "controller")}
    return look.legend_handles(titles, colours, any(run.log.failed for run in runs))


def weight(run: PlottedRun, wild: bool) -> dict[str, Any]:
    """Width and layer of a run's line; dashes over a wide solid line keep equal curves visible.

    A `wild` curve is thin and behind the others, because it would hide them.
    """
    if wild:
        return {"linewidth": 0.4, "zorder": 0.8}
    return {"linewidth": 1.6, "zorder": 2} if run.case.controller == OURS else {"zorder": 3}


def length(path: np.ndarray) -> float:
    """Length of the polyline through points (N, 2)."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def log_axis(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with few powers of ten as labels."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(numticks=6))
    axes.yaxis.set_minor_formatter(NullFormatter())


def inputs(runs: Sequence[PlottedRun]) -> Figure | None:
    """The input and its bounds over time, a row per robot: one set point, one trajectory."""
    _, runs = main_controller(runs)
    runs = [run for run in runs if run.log.u.size]
    robots, kinds = distinct(runs, "robot"), distinct(runs, "kind")
    if not runs:
        return None
    width = look.COLUMN if len(kinds) == 1 else look.PAGE
    figure, grid = look.panels(len(robots), len(kinds), width, 1.6 * len(robots) + 0.3)
    for row, robot in zip(grid, robots, strict=True):
        shown: list[Log] = []
        for axes, kind in zip(row, kinds, strict=True):
            found = of(runs, robot, kind=kind)
            if not found:
                axes.set_axis_off()
                continue
            value = preferred([run.case.value for run in found], EXAMPLE[kind])
            (run,) = of(found, value=value)
            draw_inputs(axes, run.log)
            shown.append(run.log)
            name = f"{look.robot_title(robot)}, {experiment_title(kind, value)}"
            name += input_activity(run.log)
            look.letter(axes, len(kinds) * grid.index(row) + kinds.index(kind), name)
        for axes in row:
            scale_inputs(axes, shown)
        row[0].set_ylabel(f"Input u ({shown[0].u_unit})")
        nu = shown[0].u.shape[1]
        every = [f"$u_{{{i + 1}}}$" for i in range(nu)]
        cycle = len(look.INPUTS)
        names = [", ".join(every[i::cycle]) for i in range(min(cycle, nu))]
        handles = [look.handle(n, c) for n, c in zip(names, look.INPUTS, strict=False)]
        handles.append(look.handle("bounds", (look.NEUTRAL, look.DOTTED), linewidth=0.8))
        handles += look.legend_handles({}, {}, any(log.failed for log in shown))
        row[-1].legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axes in grid[-1]:
        axes.set_xlabel(look.TIME)
    return figure
