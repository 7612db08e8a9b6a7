"""The figure of a sweep: the figure of merit of every case over each parameter that varies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from softdyn.validation.loop.pictures import plot_style as look
from softdyn.validation.loop.pictures.time_figures import FINEST
from softdyn.validation.report.figures import log_axis
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.sweep import FIGURES, TARGETS, Sweep, parameter
from softdyn.validation.studies.sweep_report import Row, label, value_text

MOST = 6  # panels in a row: the first parameters of the file
WIDTH, HEIGHT, CATEGORY = 2.3, 2.1, 0.16  # inch; a category is a value without a scale
DECADES = 20.0  # ratio of the largest value to the least from which on an axis is logarithmic
SPREAD = 0.5  # of the room of a category, for its controllers side by side


@dataclass(frozen=True)
class Panel:
    """A parameter along the horizontal axis.

    Attributes
    ----------
    title : str
    values : dict of str to Any
        Name of a case → its value.
    categories : tuple of str
        Texts of the values in order, if they are no numbers.
    joined : bool
        Whether a line joins the medians: the values are a grid of numbers.
    """

    title: str
    values: dict[str, Any]
    categories: tuple[str, ...]
    joined: bool

    @property
    def width(self) -> float:
        """Width (inch)."""
        return max(WIDTH, CATEGORY * len(self.categories))

    def at(self, case: Case, shift: float) -> float:
        """The horizontal place of a case; categories move by `shift`."""
        value = self.values[case.name]
        return self.categories.index(_text(value)) + shift if self.categories else value


def draw(sweep: Sweep, found: Sequence[Row], path: Path) -> bool:
    """Draw a row of panels per robot, a colour per controller; return whether there is a figure.

    Where nothing varies, there is none, and an older one is removed.
    """
    panels = [panel for panel in _panels(sweep) if len(set(panel.values.values())) > 1][:MOST]
    robots = [name for name in sweep.robots if any(case.robot == name for case, _ in found)]
    if not panels or not robots:
        path.unlink(missing_ok=True)
        return False
    colours = look.looks(sweep.controllers, look.CONTROLLERS)
    widths = [panel.width for panel in panels]
    with look.style():
        figure, grid = look.panels(
            len(robots), len(panels), sum(widths) + 0.5, HEIGHT * len(robots) + 0.7,
            sharex="col", sharey="row", width_ratios=widths,
        )  # fmt: skip
        for row, robot in zip(grid, robots, strict=True):
            for axes, panel in zip(row, panels, strict=True):
                for k, controller in enumerate(sweep.controllers):
                    shift = SPREAD * ((k + 0.5) / len(sweep.controllers) - 0.5)
                    rows = [(case, result) for case, result in found
                            if (case.robot, case.controller) == (robot, controller)]  # fmt: skip
                    _draw(axes, panel, rows, sweep.figure, colours[controller], shift)
            every = [r.get(sweep.figure) for case, r in found if case.robot == robot]
            values = [value for value in every if value is not None]
            if values and _spans_decades(values):
                log_axis(row[0])  # the others of the row share it
            row[0].set_ylabel(f"{look.robot_title(robot)}\n{FIGURES[sweep.figure]}")
        for axes, panel in zip(grid[-1], panels, strict=True):
            axes.set_xlabel(look.plain(panel.title))
            if panel.categories:
                names = [look.plain(name) for name in panel.categories]
                long = max(map(len, names)) > 8
                axes.set_xticks(range(len(names)), names, rotation=90 if long else 0)
            elif _spans_decades(list(panel.values.values())):
                axes.set_xscale("log")
        failed = any(result["outcome"] != "done" for _, result in found)
        titles = {name: look.controller_title(name) for name in sweep.controllers}
        dot = look.handle("a case (lines: medians)", (look.NEUTRAL, ""), marker="o", markersize=2.5)
        look.legend_above(figure, [*look.legend_handles(titles, colours, failed), dot])
        look.write_figure(figure, path)
    return True


def _panels(sweep: Sweep) -> list[Panel]:
    """A panel for each parameter of the file, for the changes, and for the targets."""
    names = [axis.name for axis in sweep.varying()]
    names += ["run.period"] if sweep.shorter_periods and "run.period" not in names else []
    drawn = {axis.name for axis in (*sweep.axes, *sweep.targets) if axis.drawn}
    every = [(name, {case.name: parameter(case, name) for case in sweep.cases}) for name in names]
    if len(sweep.changes) > 1:
        every.append(("change", {case.name: change for case, change in sweep.expanded}))
    for axis in sweep.targets:
        kind = TARGETS[axis.name]
        values = {case.name: case.value for case in sweep.cases if case.kind == kind}
        every.append((axis.name, values))
    return [_panel(name, values, name in drawn) for name, values in every]


def _panel(name: str, values: dict[str, Any], drawn: bool) -> Panel:
    numeric = all(isinstance(value, float) and np.isfinite(value) for value in values.values())
    texts = () if numeric else tuple(dict.fromkeys(map(_text, values.values())))
    return Panel(label(name), values, texts, numeric and not drawn)


def _draw(
    axes: Axes, panel: Panel, rows: Sequence[Row], figure: str, colour: look.Look, shift: float
) -> None:
    """Draw the cases of a controller: a dot each, a cross if it failed, and a line of medians."""
    dots: list[tuple[float, float]] = []
    crosses: list[tuple[float, float]] = []
    above: list[tuple[float, float]] = []  # crosses without a figure are on the upper edge
    for case, result in rows:
        if case.name in panel.values:
            x, value = panel.at(case, shift), result.get(figure)
            done = result["outcome"] == "done" and value is not None
            drawn = dots if done else above if value is None else crosses
            drawn.append((x, 1.0 if value is None else max(value, FINEST)))
    edge, inside = axes.get_xaxis_transform(), axes.transData
    mark = {"marker": "o", "linestyle": "", "markersize": 2.5, "alpha": 0.6, "mew": 0}
    cross = {**look.FAILED, "clip_on": False}
    for points, place, kind in (
        (dots, inside, mark),
        (crosses, inside, cross),
        (above, edge, cross),
    ):
        if points:
            axes.plot(*zip(*points, strict=True), color=colour[0], transform=place, **kind)
    values: dict[float, list[float]] = {}
    for x, value in (*dots, *crosses):
        values.setdefault(x, []).append(value)
    if panel.joined and len(values) > 1:
        order = sorted(values)
        look.line(axes, order, [float(np.median(values[x])) for x in order], colour)


def _spans_decades(values: Sequence[float]) -> bool:
    return min(values) > 0 and max(values) / min(values) >= DECADES


def _text(value: Any) -> str:
    return value if isinstance(value, str) else value_text(value)
