"""The figure of step times: the parts of a step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from softdyn.validation.loop.pictures.plot_style import (
    BLACK,
    BLUE,
    ORANGE,
    PAGE,
    SKY,
    controller_title,
    letter,
    panels,
    robot_title,
    save,
    style,
)  # fmt: skip

PARTS = (("dynamics", BLUE), ("assembly", SKY), ("solve", ORANGE))


def bars(rows: list[dict[str, Any]], path: Path) -> list[Path]:
    """Draw stacked medians of every robot and controller with the floor, as PDF and PNG."""
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    with style():
        figure, axes = panels(1, len(robots), PAGE, 2.6, sharey=True)
        for i, (robot, axis) in enumerate(zip(robots, axes[0], strict=True)):
            own = [row for row in rows if row["robot"] == robot]
            _stack(axis, own)
            letter(axis, i, f"{robot_title(robot)}\nn = {own[0]['n']}, m = {own[0]['m']}")
        axes[0][0].set_ylabel("one control step, median (µs)")
        return save_with_legend(figure, axes[0][0], path)


def save_with_legend(figure: Figure, axis: Axes, path: Path) -> list[Path]:
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
