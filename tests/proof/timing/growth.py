"""The figure of a step's growth with a robot's joints and inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from softdyn.validation.loop.pictures.plot_style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PAGE,
    VERMILLION,
    letter,
    panels,
    style,
)  # fmt: skip
from tests.proof.timing.step_figures import save_with_legend


def growth(scaling: dict[str, list[dict[str, Any]]], path: Path) -> list[Path]:
    """Draw the step, its QP and the floor by n and by m, as PDF and PNG."""
    with style():
        figure, axes = panels(1, 2, PAGE, 2.6)
        for i, (axis, (key, rows)) in enumerate(zip(axes[0], scaling.items(), strict=True)):
            variable, fixed = ("n", "m") if key == "joints" else ("m", "n")
            _growth(axis, rows, variable)
            title = "degrees of freedom" if variable == "n" else "inputs"
            axis.set_xlabel(f"{variable}, {title} ({fixed} = {rows[0][fixed]})")
            letter(axis, i, f"against {title}")
        axes[0][0].set_ylabel("median (µs)")
        return save_with_legend(figure, axes[0][0], path)


def _growth(axis: Axes, rows: list[dict[str, Any]], variable: str) -> None:
    x = [row[variable] for row in rows]
    lines: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("median_us", "step", {"color": BLUE, "marker": "o"}),
        ("floor_us", "floor", {"color": BLACK, "marker": "s"}),
        ("dynamics_us", "dynamics", {"color": GREEN, "marker": "^", "ls": "--"}),
        ("solve_us", "condensed QP in its solver", {"color": ORANGE, "marker": "D"}),
        ("solver_us", "its own run time", {"color": VERMILLION, "marker": "v", "ls": ":"}),
    )
    for key, label, look in lines:
        axis.plot(x, [row[key] for row in rows], label=label, ms=3, **look)
    axis.set_ylim(bottom=0)
