"""A sweep's picture when one or two of its numbers vary: lines or a heat map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.markers import MarkerStyle

from validation.plot_style import (
    COLUMN,
    FAILED,
    PAGE,
    VERMILLION,
    controller_title,
    failed_handle,
    handle,
    legend_above,
    looks,
    panels,
    plain,
    robot_title,
    save,
    style,
)  # fmt: skip
from validation.plot_style import CONTROLLERS as LOOKS
from validation.sweep import FIGURES, Axis, Sweep
from validation.sweep_report import SYMBOLS, Row, Setting, label

MAX_PANELS = 12
FEW = 5  # values that each get a tick
MAX_GRID = 250_000  # cells of a heat map


def draw(sweep: Sweep, found: list[Row], path: Path) -> list[Path]:
    """Write the picture as `path`.pdf and .png; nothing when there is none to draw.

    Targets that are not a parameter of the picture are averaged over.
    """
    axes = parameters(sweep)
    if not found or not 1 <= len(axes) <= 2:
        return []
    groups = _groups(sweep, found, axes)
    robots = list(dict.fromkeys(key[0] for key in groups))
    count = len(robots) if len(axes) == 1 else len(groups)
    if count > MAX_PANELS:
        return []
    with style():
        figure = _lines(sweep, groups, axes[0]) if len(axes) == 1 else _maps(sweep, groups, axes)
        return save(figure, path)


def parameters(sweep: Sweep) -> list[Axis]:
    """The numbers that vary: gains and plant, then θ or ω where there is room for it."""
    found = [a for a in sweep.varying() if not isinstance(a.values[0], bool | str)]
    targets = [axis for axis in sweep.targets if axis.name in SYMBOLS and axis.varies]
    if len(found) < 2 and len(sweep.targets) == 1:
        found += targets
    return found


# (robot, controller and all else that is not a number) → (x[, y]) → the cases there
Groups = dict[tuple[str, str], dict[tuple[float, ...], Setting]]


def _groups(sweep: Sweep, found: list[Row], axes: Sequence[Axis]) -> Groups:
    others = [a for a in sweep.varying() if a not in axes]
    sorted_rows: dict[tuple[str, str], dict[tuple[float, ...], list[Row]]] = {}
    for case, result in found:
        words = [controller_title(case.controller)] if len(sweep.controllers) > 1 else []
        words += [f"{label(a.name)} {str(case.parameter(a.name)).lower()}" for a in others]
        at = tuple(case.parameter(axis.name) for axis in axes)
        place = sorted_rows.setdefault((case.robot, ", ".join(words)), {})
        place.setdefault(at, []).append((case, result))
    return {
        key: {at: _together(rows, sweep.figure) for at, rows in places.items()}
        for key, places in sorted_rows.items()
    }


def _together(rows: list[Row], figure: str) -> Setting:
    """All cases at one place, whatever their target."""
    values = [_number(result.get(figure)) for _, result in rows]
    whole = bool(np.isfinite(values).all())
    mean, worst = (float(np.mean(values)), max(values)) if whole else (None, None)
    return Setting(tuple(rows), mean, worst)


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _caption(sweep: Sweep, axes: Sequence[Axis]) -> str:
    """The figure with its unit, and that it is a mean where it is one."""
    several = sum(1 if a.drawn else len(a.values) for a in sweep.targets) > 1
    shown = any(axis in sweep.targets for axis in axes)
    return ("mean " if several and not shown else "") + FIGURES[sweep.figure]


# -- one parameter ---------------------------------------------------------------------------------


def _lines(sweep: Sweep, groups: Groups, axis: Axis) -> Figure:
    """The figure over one parameter: a panel per robot, a line per controller."""
    robots = list(dict.fromkeys(robot for robot, _ in groups))
    columns = min(len(robots), 3)
    lines = -(-len(robots) // columns)
    width = COLUMN if columns == 1 else PAGE
    figure, grid = panels(lines, columns, width, 2.5 * lines)
    titles = list(dict.fromkeys(title for _, title in groups))
    known = {controller_title(name): look for name, look in LOOKS.items()}
    look = looks(titles, known)
    failed = False
    for i, robot in enumerate(robots):
        ax = grid[i // columns][i % columns]
        finite: list[float] = []
        for (of, title), places in groups.items():
            if of == robot:
                failed |= _line(ax, places, axis, look[title], finite)
        _scale(ax, axis, "x")
        if finite and min(finite) > 0 and max(finite) / min(finite) > 30:
            ax.set_yscale("log")
        ax.set_ylabel(_caption(sweep, [axis]))
        if len(robots) > 1:
            ax.set_title(robot_title(robot), loc="left")
    for ax in [ax for row in grid for ax in row][len(robots) :]:
        ax.set_visible(False)
    handles = [handle(plain(title), look[title]) for title in titles if title]
    handles += [failed_handle("a case failed")] if failed else []
    if handles:
        legend_above(figure, handles)
    return figure


def _line(
    ax: Axes, places: dict[tuple[float, ...], Setting], axis: Axis, look: Any, finite: list[float]
) -> bool:
    """One line, or points for random samples; returns whether a case in it failed."""
    at = sorted(places)
    x = np.array([place[0] for place in at])
    y = np.array([_number(places[place].mean) for place in at])
    bad = np.array([places[place].failed > 0 for place in at])
    finite += y[np.isfinite(y)].tolist()
    color, dashes = look
    ax.plot(x, y, color=color, linestyle="" if axis.drawn else dashes, marker="o", markersize=2.5)
    # a case without a figure is marked at the foot of the panel
    known = bad & np.isfinite(y)
    ax.plot(x[known], y[known], **{**FAILED, "color": color})
    none = bad & ~np.isfinite(y)
    foot = ax.get_xaxis_transform()
    ax.plot(x[none], np.full(none.sum(), 0.03), transform=foot, clip_on=False,
            **{**FAILED, "color": color})  # fmt: skip
    return bool(bad.any())


# -- two parameters --------------------------------------------------------------------------------


def _maps(sweep: Sweep, groups: Groups, axes: Sequence[Axis]) -> Figure:
    """The figure over two parameters: a panel per robot and controller, one colour scale."""
    columns = min(len(groups), 3)
    lines = -(-len(groups) // columns)
    width = COLUMN if columns == 1 else PAGE
    figure, grid = panels(lines, columns, width, 2.6 * lines)
    values = np.array([_number(s.mean) for places in groups.values() for s in places.values()])
    finite = values[np.isfinite(values)]
    norm = _norm(finite)
    flat = [ax for row in grid for ax in row]
    shown: Any = None
    failed = False
    gridded = not any(axis.drawn for axis in axes)
    for ax, ((robot, title), places) in zip(flat, groups.items(), strict=False):
        drawn = _cells if gridded and _size(axes) <= MAX_GRID else _points
        shown = drawn(ax, places, axes, norm)
        failed |= _mark_failed(ax, places)
        _scale(ax, axes[0], "x")
        _scale(ax, axes[1], "y")
        ax.grid(visible=False)
        words = [robot_title(robot)] if len(sweep.robots) > 1 else []
        ax.set_title(", ".join([*words, *([plain(title)] if title else [])]), loc="left")
    for ax in flat[len(groups) :]:
        ax.set_visible(False)
    if len(finite):
        figure.colorbar(shown, ax=flat[: len(groups)], label=_caption(sweep, axes))
    if failed:
        mark = failed_handle("a case failed")
        mark.set_color(VERMILLION)
        legend_above(figure, [mark])
    return figure


def _size(axes: Sequence[Axis]) -> int:
    return len(axes[0].values) * len(axes[1].values)


def _norm(finite: np.ndarray) -> Normalize:
    """Colours over all panels, logarithmic over more than 1 : 30."""
    if not len(finite):
        return Normalize(0.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    if low > 0 and high / low > 30:
        return LogNorm(low, high)
    return Normalize(low, high if high > low else low + 1.0)


def _cells(ax: Axes, places: dict[tuple[float, ...], Setting], axes: Any, norm: Normalize) -> Any:
    """A heat map; cells without a figure stay grey."""
    x, y = (sorted(axis.values) for axis in axes)
    field = np.full((len(y), len(x)), np.nan)
    column, row = ({value: i for i, value in enumerate(values)} for values in (x, y))
    for at, setting in places.items():
        field[row[at[1]], column[at[0]]] = _number(setting.mean)
    ax.set_facecolor("#D9D9D9")
    for values, axis, ticks in ((x, axes[0], ax.set_xticks), (y, axes[1], ax.set_yticks)):
        if len(values) <= FEW and not axis.log:
            ticks(values)
    edges = [_edges(np.array(v, float), axis.log) for v, axis in zip((x, y), axes, strict=True)]
    return ax.pcolormesh(*edges, np.ma.masked_invalid(field), norm=norm, cmap="viridis")


def _points(ax: Axes, places: dict[tuple[float, ...], Setting], axes: Any, norm: Normalize) -> Any:
    """Random samples as coloured points."""
    at = np.array(list(places), float)
    colour = [_number(setting.mean) for setting in places.values()]
    ax.margins(0.05)
    return ax.scatter(at[:, 0], at[:, 1], c=colour, norm=norm, cmap="viridis", s=14,
                      marker=MarkerStyle("o"), plotnonfinite=False)  # fmt: skip


def _mark_failed(ax: Axes, places: dict[tuple[float, ...], Setting]) -> bool:
    bad = np.array([at for at, setting in places.items() if setting.failed], float).reshape(-1, 2)
    ax.plot(bad[:, 0], bad[:, 1], color=VERMILLION, **FAILED)
    return len(bad) > 0


def _edges(values: np.ndarray, log: bool) -> np.ndarray:
    """Cell borders halfway between values, on the axis's own scale."""
    v = np.log(values) if log else values
    middle = (v[1:] + v[:-1]) / 2
    edges = np.concatenate(([2 * v[0] - middle[0]], middle, [2 * v[-1] - middle[-1]]))
    return np.exp(edges) if log else edges


def _scale(ax: Axes, axis: Axis, which: str) -> None:
    """Label, unit and scale of one direction."""
    ax.set(**{f"{which}label": plain(label(axis.name))})
    if axis.log:
        ax.set(**{f"{which}scale": "log"})
