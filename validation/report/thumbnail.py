"""A small picture of a robot in a run, drawn by Matplotlib: no browser, no window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure as Canvas

from softdyn.description.visuals import triangles
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.pictures.plot_style import write_figure
from softdyn.validation.loop.pictures.replay import reference_path
from softdyn.view.scene import Figure, tension_colour

TURN, RISE = 0.42, 0.2  # rad, as on the page: seen from -y, slightly from the side and above
SIZE = 2.4, 2.0  # inch
DPI = 150
TRAIL, PATH, TARGET = "#2b6f9e", "#8a94a0", "#d3202f"

_view = np.array([np.sin(TURN) * np.cos(RISE), -np.cos(TURN) * np.cos(RISE), np.sin(RISE)])
_right = np.array([np.cos(TURN), np.sin(TURN), 0.0])
_up = np.cross(_view, _right)


def thumbnail(log: Log, figure: Figure, path: Path) -> None:
    """Draw the end of a run into a PNG: robot, cables, target, reference path and trail."""
    last = max(log.finite_samples - 1, 0)
    canvas = Canvas(figsize=SIZE, dpi=DPI)
    FigureCanvasAgg(canvas)
    axes = canvas.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_aspect("equal", adjustable="datalim")
    way = reference_path(log, figure.model)
    if way is not None:
        axes.plot(*_flat(way), color=PATH, linewidth=0.8, zorder=1)
    trail = log.y[: log.finite_samples : max(1, log.finite_samples // 1500)]
    trail = trail[np.linalg.norm(trail, axis=1) < 3 * figure.size]
    axes.plot(*_flat(trail), color=TRAIL, linewidth=1.1, zorder=2)
    _draw_robot(axes, log, figure, last)
    x, y = _flat(log.y_ref[last])
    axes.plot([x], [y], "o", color=TARGET, markersize=4.5, alpha=0.85, zorder=5)
    write_figure(canvas, path, transparent=True)


def _draw_robot(axes: Axes, log: Log, figure: Figure, k: int) -> None:
    """Add shapes and cables at sample `k`."""
    placed = figure.link_poses(log.q[k])
    corners, colours = [], []
    for shape in figure.shapes:
        pose = placed[shape.link]
        world = triangles(shape) @ pose[:3, :3].T + pose[:3, 3]
        normals = np.cross(world[:, 1] - world[:, 0], world[:, 2] - world[:, 0])
        length = np.linalg.norm(normals, axis=1)
        keep = length > 0
        facing = np.abs(normals[keep] @ _view) / length[keep]
        corners.append(world[keep])
        colours.append((0.45 + 0.55 * facing)[:, None] * np.array(shape.rgba[:3]))
    triangle, colour = np.concatenate(corners), np.concatenate(colours)
    order = np.argsort(triangle.mean(axis=1) @ _view)
    flat = np.stack(_flat(triangle[order]), axis=-1)
    axes.add_collection(PolyCollection(
        list(flat), facecolors=colour[order], edgecolors=colour[order], linewidths=0.15, zorder=3
    ))  # fmt: skip
    u = log.u[min(k, log.steps - 1)] if log.steps else np.zeros(figure.model.nu)
    if log.acting is not None and np.isfinite(log.acting[k]).all():
        u = log.acting[k]
    for cable in figure.cables:
        drawn = np.stack(_flat(cable.points(placed)), axis=-1)
        shade = tension_colour(cable.part(u))
        axes.add_collection(LineCollection([drawn], colors=[shade], linewidths=1.0, zorder=4))


def _flat(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points @ _right, points @ _up
