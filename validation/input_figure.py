"""The figure of the inputs and their bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from softdyn import SoftModel
from softdyn.robot import Robot
from validation import plot_style as look
from validation.plot_data import EXAMPLE, Run, distinct, main_controller, of, preferred, thin


def inputs(runs: Sequence[Run], models: Mapping[str, SoftModel]) -> Figure | None:
    """The input and its bounds over time, a row a robot: one set point, one trajectory.

    `models` has every robot's model: bounds and units are the robot's, not the run's.
    """
    _, runs = main_controller(runs)
    runs = [run for run in runs if run.u.size]
    robots, kinds = distinct(runs, "robot"), distinct(runs, "kind")
    if not runs:
        return None
    width = look.COLUMN if len(kinds) == 1 else look.PAGE
    figure, grid = look.panels(len(robots), len(kinds), width, 1.6 * len(robots) + 0.3)
    for row, robot in zip(grid, robots, strict=True):
        model, shown = models[robot], []
        for axes, kind in zip(row, kinds, strict=True):
            found = of(runs, robot, kind=kind)
            if not found:
                axes.set_axis_off()
                continue
            value = preferred([run.case.value for run in found], EXAMPLE[kind])
            (run,) = of(found, value=value)
            draw_inputs(axes, run, model)
            shown.append(run)
            name = f"{look.robot_title(robot)}, {look.experiment_title(kind, value)}"
            look.letter(axes, len(kinds) * grid.index(row) + kinds.index(kind), name)
        for axes in row:
            scale_inputs(axes, model, shown)
        row[0].set_ylabel(f"Input u ({input_unit(model.robot)})")
        every = [f"$u_{{{i + 1}}}$" for i in range(model.nu)]
        cycle = len(look.INPUTS)
        names = [", ".join(every[i::cycle]) for i in range(min(cycle, model.nu))]
        handles = [look.handle(n, c) for n, c in zip(names, look.INPUTS, strict=False)]
        handles.append(look.handle("bounds", (look.NEUTRAL, look.DOTTED), linewidth=0.8))
        if any(run.failed for run in shown):
            handles.append(look.failed_handle())
        row[-1].legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axes in grid[-1]:
        axes.set_xlabel(look.TIME)
    return figure


def draw_inputs(axes: Axes, run: Run, model: SoftModel) -> None:
    """Every u_i of a run as it was held, and its bounds."""
    for i in range(model.nu):
        colour, dashes = look.INPUTS[i % len(look.INPUTS)]
        held = np.append(run.u[:, i], run.u[-1, i])[: len(run.t)]
        kept = thin(held, bins=600)
        axes.plot(
            run.t[kept], held[kept], color=colour, linestyle=dashes, linewidth=0.9,
            drawstyle="steps-post",
        )  # fmt: skip
    for bound in sorted({*model.u_min, *model.u_max}):
        if np.isfinite(bound):
            axes.axhline(bound, color=look.NEUTRAL, linestyle=look.DOTTED, linewidth=0.8)
    if run.failed:
        axes.plot(run.t[-1], run.u[-1, 0], color=look.NEUTRAL, clip_on=False, **look.FAILED)
    axes.set_xlim(0, run.duration)
    axes.xaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))


def scale_inputs(axes: Axes, model: SoftModel, runs: Sequence[Run]) -> None:
    """A vertical axis that holds the bounds; logarithmic far from 0 if inputs mostly are near it.

    Between bounds that are ten times as large as the usual input a linear axis would show nothing.
    """
    low, high = float(model.u_min.min()), float(model.u_max.max())
    if not np.isfinite(high - low):
        return
    largest = max(-low, high)
    typical = float(np.median(np.concatenate([np.abs(run.u).ravel() for run in runs])))
    if typical < largest / 10:
        linear = 10.0 ** np.floor(np.log10(max(typical, largest / 1000)))
        axes.set_yscale("symlog", linthresh=linear)
        axes.set_ylim(
            *(1.5 * x if x else 0.3 * side * linear for x, side in ((low, -1), (high, 1)))
        )
    else:
        margin = 0.06 * (high - low)
        axes.set_ylim(low - margin, high + margin)


def input_unit(robot: Robot) -> str:
    """What one unit of u is: its tendon's gear in N, or N m where it sums angles."""
    tendons = {tendon.name: tendon for tendon in robot.tendons}
    turns = {joint.name for joint in robot.joints if joint.kind != "prismatic"}
    units = []
    for actuator in robot.actuators:
        terms = tendons[actuator.tendon].terms
        unit = "N m" if any(term.joint in turns for term in terms) else "N"
        gear = abs(actuator.gear)
        units.append(unit if gear == 1 else f"{gear:g} {unit}")
    return ", ".join(dict.fromkeys(units))
