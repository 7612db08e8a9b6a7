"""Figures of a sweep: every case over each parameter that varies, and a table for a paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from softdyn.validation.loop.pictures import plot_style as look
from softdyn.validation.loop.pictures.time_figures import FINEST
from softdyn.validation.report.figures import log_axis
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.paper_table import Group, PaperTable
from softdyn.validation.studies.sweep import FIGURES, TARGETS, Sweep, parameter
from softdyn.validation.studies.sweep_report import Row, label, value_text

MOST, ACROSS = 6, 3  # panels of a robot, the first parameters of the file, and those in a row
LONG = 10  # characters of the name of a category that is turned
WIDTH, HEIGHT, CATEGORY = 2.3, 2.1, 0.16  # inch; a category is a value without a scale
DECADES = 20.0  # ratio of the largest value to the least from which on an axis is logarithmic
SPREAD = 0.5  # of the room of a category, for its controllers side by side


@dataclass(frozen=True)
class Panel:
    """A parameter along the horizontal axis.

    Attributes
    ----------
    name, title : str
        The parameter, and its title.
    values : dict of str to Any
        Name of a case → its value.
    categories : tuple of str
        Texts of the values in order, if they are no numbers.
    joined : bool
        Whether a line joins the medians: the values are a grid of numbers.
    """

    name: str
    title: str
    values: dict[str, Any]
    categories: tuple[str, ...]
    joined: bool

    @property
    def width(self) -> float:
        """Width (inch)."""
        return max(WIDTH, CATEGORY * len(self.categories))

    def differs(self, found: Sequence[Row]) -> bool:
        """Whether these cases have several values of the parameter."""
        return len({self.values[case.name] for case, _ in found if case.name in self.values}) > 1

    def at(self, case: Case, shift: float) -> float:
        """The horizontal place of a case; categories move by `shift`."""
        value = self.values[case.name]
        return self.categories.index(_text(value)) + shift if self.categories else value


def draw(sweep: Sweep, found: Sequence[Row], path: Path) -> list[Path]:
    """Draw rows of panels for each robot, a colour per controller; return the PDF and the PNG.

    A robot has the panels in which its cases differ. Where nothing varies, there is no figure, and
    an older one is removed.

    Parameters
    ----------
    sweep : Sweep
    found : sequence of Row
    path : Path
        Of the files, without a suffix.
    """
    shown = []  # robot, its rows, its panels
    for robot in sweep.robots:
        rows = [row for row in found if row[0].robot == robot]
        differs = [panel for panel in _panels(sweep) if panel.differs(rows)][:MOST]
        shown += [(robot, rows, differs[k : k + ACROSS]) for k in range(0, len(differs), ACROSS)]
    if not shown:
        for suffix in look.SUFFIXES:
            path.with_suffix(suffix).unlink(missing_ok=True)
        return []
    colours = look.looks(sweep.controllers, look.CONTROLLERS)
    with look.style():
        figure, grid = _laid_out([[panel.width for panel in panels] for *_, panels in shown])
        beside: dict[str, Axes] = {}  # the first panel of a robot: the others share its scale
        for row, (robot, rows, panels) in zip(grid, shown, strict=True):
            for axes, panel in zip(row, panels, strict=True):
                if beside.setdefault(robot, axes) is not axes:
                    axes.sharey(beside[robot])
                for k, controller in enumerate(sweep.controllers):
                    shift = SPREAD * ((k + 0.5) / len(sweep.controllers) - 0.5)
                    own = [row for row in rows if row[0].controller == controller]
                    _draw(axes, panel, own, sweep.figure, colours[controller], shift)
                _name(axes, panel, sweep.labels)
            values = [v for _, result in rows if (v := result.get(sweep.figure)) is not None]
            if values and _spans_decades(values):
                log_axis(beside[robot])  # the others of the robot share it
            title = sweep.labels.get(robot) or look.robot_title(robot)
            row[0].set_ylabel(f"{title}\n{FIGURES[sweep.figure]}")
        failed = any(result["outcome"] != "done" for _, result in found)
        titles = {n: sweep.labels.get(n) or look.controller_title(n) for n in sweep.controllers}
        dot = look.handle("a case (lines: medians)", (look.NEUTRAL, ""), marker="o", markersize=2.5)
        look.legend_above(figure, [*look.legend_handles(titles, colours, failed), dot])
        return look.save(figure, path)


def draw_table(paper: PaperTable, path: Path) -> list[Path]:
    """Draw a table for a paper: a panel for each of its figures; return the PDF and the PNG.

    The columns are beside each other, and the rows have a colour each; without several columns the
    rows are beside each other. A bar is the spread of a cell. A figure that no run has is left out.

    Parameters
    ----------
    paper : PaperTable
    path : Path
        Of the files, without a suffix.
    """
    spread = paper.sweep.spread
    across = len(paper.columns) > 1
    series, places = (paper.rows, paper.columns) if across else ((), paper.rows)
    shown = [
        name for name in paper.sweep.figures
        if any(np.isfinite(g.centre(spread)[0]) for (*_, n), g in paper.groups.items() if n == name)
    ]  # fmt: skip
    if not shown:
        return []
    widths = [max(WIDTH, 2 * CATEGORY * len(places))] * len(shown)
    with look.style():
        rows = [widths[k : k + ACROSS] for k in range(0, len(shown), ACROSS)]
        figure, grid = _laid_out(rows)
        for axes, name in zip((axes for row in grid for axes in row), shown, strict=True):
            for k, row in enumerate(series or paper.columns):
                shift = SPREAD * ((k + 0.5) / max(len(series), 1) - 0.5)
                cells = [(row, x, name) if across else (x, row, name) for x in places]
                found = [(x + shift, paper.groups.get(cell)) for x, cell in enumerate(cells)]
                _bars(axes, [(x, g) for x, g in found if g], spread, look.INPUTS[k % 9][0])
            axes.set_ylabel(look.plain(paper.titled(name)))
            _ticks(axes, [", ".join(one) for one in places])
        handles = [
            look.handle(look.plain(", ".join(row)), (look.INPUTS[k % 9][0], ""), marker="o")
            for k, row in enumerate(series)
        ]
        failed = any(group.failed for group in paper.groups.values())
        look.legend_above(figure, [*handles, *look.legend_handles({}, {}, failed)])
        return look.save(figure, path)


def _bars(axes: Axes, found: Sequence[tuple[float, Group]], spread: str, colour: str) -> None:
    """A dot with a bar for each group; a cross on the upper edge where runs have no figure."""
    middles = [(x, *group.centre(spread)) for x, group in found]
    known = [one for one in middles if np.isfinite(one[1])]
    if known:
        x, middle, below, above = zip(*known, strict=True)
        bars = np.array([below, above])
        bars[~np.isfinite(bars)] = 0.0
        axes.errorbar(
            x, middle, yerr=bars, fmt="o", color=colour, markersize=3.5, capsize=2, linewidth=0.9
        )
    if lost := [x for x, middle, *_ in middles if not np.isfinite(middle)]:
        axes.plot(
            lost, [1.0] * len(lost), color=colour, transform=axes.get_xaxis_transform(),
            clip_on=False, **look.FAILED,
        )  # fmt: skip


def _laid_out(widths: Sequence[Sequence[float]]) -> tuple[Figure, list[list[Axes]]]:
    """A figure with these panels in each row, by their widths (inch), and no others."""
    columns = max(map(len, widths))
    wide = [max(row[k] for row in widths if k < len(row)) for k in range(columns)]
    figure, grid = look.panels(
        len(widths), columns, sum(wide) + 0.5, HEIGHT * len(widths) + 0.7, width_ratios=wide
    )
    for row, needed in zip(grid, widths, strict=True):
        for axes in row[len(needed) :]:
            axes.remove()
        del row[len(needed) :]
    return figure, grid


def _name(axes: Axes, panel: Panel, labels: Mapping[str, str]) -> None:
    """Title and values of a panel's horizontal axis."""
    axes.set_xlabel(look.plain(labels.get(panel.name, panel.title)))
    if panel.categories:
        _ticks(axes, [labels.get(name, name) for name in panel.categories])
    elif _spans_decades(list(panel.values.values())):
        axes.set_xscale("log")


def _ticks(axes: Axes, names: Sequence[str]) -> None:
    """Names of places beside each other."""
    long = max(map(len, names)) > LONG
    axes.set_xticks(range(len(names)), list(map(look.plain, names)), rotation=90 if long else 0)
    axes.set_xlim(-0.5, len(names) - 0.5)


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
    return [
        _panel(name, label(name, sweep.unitless), values, name in drawn) for name, values in every
    ]


def _panel(name: str, title: str, values: dict[str, Any], drawn: bool) -> Panel:
    numeric = all(isinstance(value, float) and np.isfinite(value) for value in values.values())
    texts = () if numeric else tuple(dict.fromkeys(map(_text, values.values())))
    return Panel(name, title, values, texts, numeric and not drawn)


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
    return value if isinstance(value, str) and value else value_text(value)
