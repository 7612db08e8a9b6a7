"""The figure of a robot's statics: stable equilibria of the tip, and the targets among them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from softdyn.statics import Equilibrium, ReachCell, StuckRest
from softdyn.validation.crosschecks.rest_report import RestReport
from softdyn.validation.loop.pictures.plot_style import (
    BLACK,
    GREEN,
    GREY,
    PAGE,
    SKY,
    VERMILLION,
    check_path,
    letter,
    panels,
    robot_title,
    style,
    write_figure,
)

FLAT = 1e-6  # of the size: points this close to a plane count as in it


@dataclass(frozen=True)
class Plane:
    """The plane of a figure, spanned by `right` and `up` (3,).

    Attributes
    ----------
    titles : tuple of str
        Titles of both axes.
    """

    right: np.ndarray
    up: np.ndarray
    titles: tuple[str, str]

    @classmethod
    def of(cls, points: np.ndarray) -> Plane:
        """The upright plane through the z axis in which `points` (N, 3) spread most.

        For points of equal height, as of a robot on a table, it is the plane of x and y.
        """
        x, y, z = np.eye(3)
        size = max(float(np.abs(points).max(initial=0.0)), 1e-12)
        if np.ptp(points[:, 2]) < FLAT * size:
            return cls(x, y, ("x (cm)", "y (cm)"))
        _, spread, axes = np.linalg.svd(points[:, :2], full_matrices=False)
        along = axes[0] if spread[0] > FLAT * size else np.array([1.0, 0.0])
        along = along * (1.0 if along @ [1.0, 1e-3] >= 0 else -1.0)
        angle = math.degrees(math.atan2(along[1], along[0]))
        if abs(angle) < 1:
            return cls(x, z, ("x (cm)", "z (cm)"))
        title = "y (cm)" if abs(angle - 90) < 1 else f"horizontally, {angle:.0f}° from x (cm)"
        return cls(np.array([*along, 0.0]), z, (title, "z (cm)"))

    def holds(self, points: np.ndarray) -> bool:
        """Whether all points (N, 3) lie in the plane."""
        off = points @ np.cross(self.right, self.up)
        return bool(np.abs(off).max(initial=0.0) <= FLAT * max(np.abs(points).max(), 1e-12))

    def flat(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) (m) projected into the plane (N, 2) (cm)."""
        return 100 * np.stack((points @ self.right, points @ self.up), axis=-1)


def around_z(points: np.ndarray) -> np.ndarray:
    """Distance from the z axis and height (N, 2) (cm) of points (N, 3) (m)."""
    return 100 * np.stack((np.hypot(points[:, 0], points[:, 1]), points[:, 2]), axis=-1)


def draw(path: str | Path, report: RestReport, curve: np.ndarray | None = None) -> None:
    """Draw sampled tips beside the robot's shapes at the targets, in the plane of the robot.

    The left panel shows every sampled tip and the targets. If the robot leaves its plane, it shows
    them by distance from the z axis and height. The right panel shows the shape closest to each
    target, and the closest stable shape.

    Parameters
    ----------
    path : str or Path
        Output file, .png or .pdf.
    report : RestReport
        A report with at least one sample.
    curve : ndarray, (·, 3)
        Points of the path on which the targets lie, drawn for orientation.
    """
    path = check_path(path)
    model = report.samples[0].model
    tips = np.array([one.y for one in report.samples])
    targets = np.array([one.search.target for one in report.targets])
    shapes = []
    for search in (one.search for one in report.targets):
        if not search.nearest.stable:
            shapes.append((_chain(search.nearest), VERMILLION))
        if search.nearest_stable is not None:
            shapes.append((_chain(search.nearest_stable), GREEN))
    plane = Plane.of(np.concatenate([tips, targets, *(points for points, _ in shapes)]))
    planar = plane.holds(np.concatenate([tips, targets]))
    with style():
        figure, axes = panels(1, 2, PAGE, 3.8, sharex=planar, sharey=planar)
        left, right = axes[0]
        views = {left: plane.flat if planar else around_z, right: plane.flat}
        across, upward = views[left](tips).T
        left.scatter(across, upward, s=3, color=SKY, linewidths=0)
        letter(left, 0, f"{robot_title(model.bundled or model.name)}: {len(tips)} stable rests")
        left.set_xlabel(plane.titles[0] if planar else "distance from the z axis (cm)")
        left.set_ylabel(plane.titles[1])
        for points, colour in shapes:
            right.plot(*plane.flat(points).T, color=colour, lw=1.3, marker="o", ms=1.8)
        letter(right, 1, "closest shapes")
        right.set_xlabel(plane.titles[0])
        for axis, seen in views.items():
            if curve is not None:
                axis.plot(*seen(curve).T, color=GREY, lw=0.8, zorder=1)
            for target, at in zip(report.targets, seen(targets), strict=True):
                axis.plot(*at, "+", color=BLACK, ms=8, mew=1.4, zorder=5)
                axis.annotate(target.name, at, (5, 4), textcoords="offset points", fontsize=7)
            axis.set_aspect("equal")
        figure.legend(handles=_handles(), loc="outside upper center", ncols=4)
        write_figure(figure, path)


def draw_directions(path: str | Path, cells: Sequence[ReachCell]) -> None:
    """Draw each cell's mean direction as an arrow, coloured by the cone of directions in it.

    Cells stand at their mean distance from the z axis and height, or in the robot's plane.

    Parameters
    ----------
    path : str or Path
        Output file, .png or .pdf.
    cells : sequence of ReachCell
        The cells, at least one.
    """
    path = check_path(path)
    model = cells[0].rests[0].model
    centres = np.array([np.mean([one.y for one in cell.rests], axis=0) for cell in cells])
    ahead = np.array([cell.direction for cell in cells])
    plane = Plane.of(centres)
    planar = plane.holds(centres)
    across, upward = (plane.flat if planar else around_z)(centres).T
    if planar:
        ways = plane.flat(ahead) / 100
    else:  # out of the page are the parts around the z axis
        radial = centres[:, :2] / np.maximum(np.linalg.norm(centres[:, :2], axis=1), 1e-12)[:, None]
        ways = np.column_stack(((ahead[:, :2] * radial).sum(axis=1), ahead[:, 2]))
    with style():
        figure, panel = panels(1, 1, 0.6 * PAGE, 3.4)
        axis = panel[0][0]
        cones = np.rad2deg([cell.cone for cell in cells])
        drawn = axis.quiver(
            across, upward, *ways.T, cones, angles="xy", width=0.004, clim=(0, None)
        )
        letter(axis, 0, robot_title(model.bundled or model.name))
        axis.set_xlabel(plane.titles[0] if planar else "distance from the z axis (cm)")
        axis.set_ylabel(plane.titles[1])
        axis.set_aspect("equal")
        figure.colorbar(drawn, label="cone of directions (degrees)")
        write_figure(figure, path)


def draw_loop(path: str | Path, shares: np.ndarray, rests: Sequence[StuckRest]) -> None:
    """Draw the hysteresis of a robot whose cables rub: the tip over the inputs' share.

    Parameters
    ----------
    path : str or Path
        Output file, .png or .pdf.
    shares : ndarray, (k,)
        Share of the given inputs, along the path.
    rests : sequence of StuckRest
        The rests at these shares.
    """
    path = check_path(path)
    tips = np.array([one.y for one in rests])
    moved = 100 * (tips - tips[0])
    _, _, axes = np.linalg.svd(moved, full_matrices=False)
    along = moved @ (axes[0] * np.sign(moved[int(np.abs(moved @ axes[0]).argmax())] @ axes[0]))
    model = rests[0].state.model
    with style():
        figure, panel = panels(1, 1, PAGE / 2, 3.0)
        axis = panel[0][0]
        axis.plot(100 * shares, along, color=VERMILLION, lw=1.2)
        letter(axis, 0, robot_title(model.bundled or model.name))
        axis.set_xlabel("inputs (% of the given ones)")
        axis.set_ylabel("tip, along its largest motion (cm)")
        write_figure(figure, path)


def _handles() -> list[Line2D]:
    dots: dict[str, Any] = {"linestyle": "", "marker": "o", "ms": 3}
    return [
        Line2D([], [], color=SKY, label="tip at a stable equilibrium", **dots),
        Line2D([], [], color=BLACK, ls="", marker="+", ms=8, mew=1.4, label="target"),
        Line2D([], [], color=GREEN, label="closest stable shape"),
        Line2D([], [], color=VERMILLION, label="closest shape, unstable"),
    ]


def _chain(one: Equilibrium) -> np.ndarray:
    """The chain of links (·, 3) from the world's origin to the tip (m)."""
    robot, placed = one.model.robot, one.model.link_poses(one.q)
    points = [placed[joint.child][:3, 3] for joint in robot.chain(robot.task)]
    return np.array([np.zeros(3), *points])
