"""The picture of an arm coloured by the expected error of each link."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection

from softdyn import SoftModel
from softdyn.estimation import Observability
from softdyn.validation.loop.pictures.plot_style import (
    COLUMN,
    GREY,
    check_path,
    panels,
    plain,
    style,
    write_figure,
)
from softdyn.validation.report.statics_figure import Plane


def draw(model: SoftModel, q: np.ndarray, found: Observability, path: str | Path) -> None:
    """Draw the arm at q (nq,), each link in the colour of its expected error (mm).

    Raises
    ------
    InputError
        If the figure cannot be written.
    """
    poses = model.link_poses(q)
    lines = np.array([
        [poses[joint.parent][:3, 3], poses[joint.child][:3, 3]] for joint in model.robot.joints
    ])  # fmt: skip
    errors = np.array([1e3 * found.links[joint.child] for joint in model.robot.joints])
    seen = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) > 0
    plane = Plane.of(lines.reshape(-1, 3))
    flat = 100 * lines @ np.column_stack((plane.right, plane.up))
    with style():
        figure, axes = panels(1, 1, COLUMN, COLUMN)
        panel = axes[0][0]
        arm = LineCollection(list(flat[seen]), linewidths=3, capstyle="round", cmap="viridis")
        arm.set_array(errors[seen])
        arm.set_clim(0.0, max(float(errors.max()), 1e-9))
        panel.add_collection(arm)
        y = 100 * model.state(q, np.zeros(model.nv)).y @ np.column_stack((plane.right, plane.up))
        panel.plot(*y, "o", color=GREY, markersize=4)
        panel.set_aspect("equal")
        panel.margins(0.15)
        panel.autoscale_view()
        panel.set_xlabel(plane.titles[0])
        panel.set_ylabel(plane.titles[1])
        figure.colorbar(arm, ax=panel, label="expected error of a link (mm)")
        panel.set_title(plain(f"{model.name}: {found.seen} of {found.free} directions seen"))
        write_figure(figure, check_path(path))
