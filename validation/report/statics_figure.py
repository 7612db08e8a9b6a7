"""The picture of a robot's statics: where its tip can rest stably, and the targets in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from softdyn import InputError
from softdyn.statics import Equilibrium
from softdyn.validation.crosschecks.rest_report import RestReport
from softdyn.validation.files import atomic
from softdyn.validation.report.plot_style import (
    BLACK,
    GREEN,
    GREY,
    PAGE,
    SKY,
    VERMILLION,
    letter,
    panels,
    robot_title,
    style,
)

SUFFIXES = (".png", ".pdf")


def check_path(path: str | Path) -> Path:
    """`path`, if a figure can be written under its name.

    Raises
    ------
    InputError
        For any other suffix than .png and .pdf.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(str(path), "a file name that ends in .png or .pdf", path.suffix or "none")
    return path


def draw(path: str | Path, report: RestReport, curve: np.ndarray | None = None) -> None:
    """Sampled tips beside the robot's shapes at the targets.

    Left, every sampled tip by its distance from the z axis and its height (by x where the robot
    is planar); right, the shape that comes closest to each target, and the closest stable one.

    Parameters
    ----------
    path : str or Path
        To write, .png or .pdf.
    report : RestReport
        With at least one sample.
    curve : ndarray, (·, 3)
        Points of the tracked ellipse, for the eye.
    """
    path = check_path(path)
    model = report.samples[0].model
    tips = np.array([one.y for one in report.samples])
    planar = bool(np.abs(tips[:, 1]).max() < 1e-9)
    with style():
        figure, axes = panels(1, 2, PAGE, 3.8, sharex=True, sharey=True)
        left, right = axes[0]
        out = tips[:, 0] if planar else np.hypot(tips[:, 0], tips[:, 1])
        left.scatter(100 * out, 100 * tips[:, 2], s=3, color=SKY, linewidths=0)
        letter(left, 0, f"{robot_title(model.bundled or model.name)}: {len(tips)} stable rests")
        left.set_xlabel("x (cm)" if planar else "distance from the z axis (cm)")
        left.set_ylabel("z (cm)")
        for search in (one.search for one in report.targets):
            stable = search.nearest_stable
            if not search.nearest.stable:
                _shape(right, search.nearest, VERMILLION)
            if stable is not None:
                _shape(right, stable, GREEN)
        letter(right, 1, "closest shapes")
        right.set_xlabel("x (cm)")
        for axis in (left, right):
            if curve is not None:
                axis.plot(100 * curve[:, 0], 100 * curve[:, 2], color=GREY, lw=0.8, zorder=1)
            for target in report.targets:
                x, _, z = 100 * target.search.target
                axis.plot(x, z, "+", color=BLACK, ms=8, mew=1.4, zorder=5)
                axis.annotate(target.name, (x, z), (5, 4), textcoords="offset points", fontsize=7)
            axis.set_aspect("equal")
        figure.legend(handles=_handles(), loc="outside upper center", ncols=4)
        with atomic(path) as stream:
            figure.savefig(stream, format=path.suffix.lower()[1:])


def _handles() -> list[Line2D]:
    dots: dict[str, Any] = {"linestyle": "", "marker": "o", "ms": 3}
    return [
        Line2D([], [], color=SKY, label="tip at a stable rest", **dots),
        Line2D([], [], color=BLACK, ls="", marker="+", ms=8, mew=1.4, label="target"),
        Line2D([], [], color=GREEN, label="closest stable shape"),
        Line2D([], [], color=VERMILLION, label="closest shape, unstable"),
    ]


def _shape(axis: Axes, one: Equilibrium, colour: str) -> None:
    """The chain of links from the world's origin to the tip, in the xz-plane."""
    robot, placed = one.model.robot, one.model.link_poses(one.q)
    points = [placed[joint.child][:3, 3] for joint in robot.chain(robot.task)]
    xyz = 100 * np.array([np.zeros(3), *points])
    axis.plot(xyz[:, 0], xyz[:, 2], color=colour, lw=1.3, marker="o", ms=1.8)
