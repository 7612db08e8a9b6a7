"""Figures of step times: the parts of a step, and its growth with a robot's size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from softdyn.validation.report.plot_style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PAGE,
    SKY,
    VERMILLION,
    controller_title,
    letter,
    panels,
    robot_title,
    save,
    style,
)  # fmt: skip

PARTS = (("dynamics", BLUE), ("assembly", SKY), ("solve", ORANGE))


def bars(rows: list[dict[str, Any]], path: Path) -> list[Path]:
    """Stacked medians of every robot and controller, the floor marked; PDF and PNG."""
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    with style():
        figure, axes = panels(1, len(robots), PAGE, 2.6, sharey=True)
        for i, (robot, axis) in enumerate(zip(robots, axes[0], strict=True)):
            own = [row for row in rows if row["robot"] == robot]
            _stack(axis, own)
            letter(axis, i, f"{robot_title(robot)}\nn = {own[0]['n']}, m = {own[0]['m']}")
        axes[0][0].set_ylabel("one control step, median (µs)")
        return _save(figure, axes[0][0], path)


def growth(scaling: dict[str, list[dict[str, Any]]], path: Path) -> list[Path]:
    """The step, its QP and the floor against n and against m; PDF and PNG."""
    with style():
        figure, axes = panels(1, 2, PAGE, 2.6)
        for i, (axis, (key, rows)) in enumerate(zip(axes[0], scaling.items(), strict=True)):
            variable, fixed = ("n", "m") if key == "joints" else ("m", "n")
            _growth(axis, rows, variable)
            title = "degrees of freedom" if variable == "n" else "inputs"
            axis.set_xlabel(f"{variable}, {title} ({fixed} = {rows[0][fixed]})")
            letter(axis, i, f"against {title}")
        axes[0][0].set_ylabel("median (µs)")
        return _save(figure, axes[0][0], path)


def _save(figure: Figure, axis: Axes, path: Path) -> list[Path]:
    """Write the figure with the legend of one panel above all."""
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return save(figure, path)


def _stack(axis: Axes, rows: list[dict[str, Any]]) -> None:
    x, bottom = np.arange(len(rows)), np.zeros(len(rows))
    for part, colour in PARTS:
        height = np.array([row[f"{part}_us"] for row in rows])
        axis.bar(x, height, 0.7, bottom, color=colour, label=part)
        bottom += height
    floor = [row["floor_us"] for row in rows]
    axis.hlines(floor, x - 0.42, x + 0.42, BLACK, lw=1.4, label="floor")
    axis.set_xticks(x, [controller_title(row["controller"]) for row in rows], rotation=60)
    for label in axis.get_xticklabels():
        label.set(ha="right", rotation_mode="anchor")
    axis.grid(axis="x", visible=False)


def _growth(axis: Axes, rows: list[dict[str, Any]], variable: str) -> None:
    x = [row[variable] for row in rows]
    lines: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("median_us", "step", {"color": BLUE, "marker": "o"}),
        ("floor_us", "floor", {"color": BLACK, "marker": "s"}),
        ("dynamics_us", "dynamics", {"color": GREEN, "marker": "^", "ls": "--"}),
        ("solve_us", "condensed QP in ProxQP", {"color": ORANGE, "marker": "D"}),
        ("proxqp_us", "its own run time", {"color": VERMILLION, "marker": "v", "ls": ":"}),
    )
    for key, label, look in lines:
        axis.plot(x, [row[key] for row in rows], label=label, ms=3, **look)
    axis.set_ylim(bottom=0)
