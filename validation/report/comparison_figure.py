"""The figure of a few saved runs: their errors in one panel, the inputs of each in its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from softdyn.validation.loop.log import Log
from softdyn.validation.report import plot_style as look
from softdyn.validation.report.figures import FINEST
from softdyn.validation.report.input_figure import draw_inputs, scale_inputs
from softdyn.validation.report.plot_data import finite_errors, thin


def compare(logs: Sequence[Log], labels: Sequence[str]) -> Figure:
    """‖e‖ (cm, logarithmic) over time of every run, and below it every run's inputs.

    A run that diverged is drawn up to its last finite sample.
    """
    rows = 1 + len(logs)
    figure, grid = look.panels(rows, 1, look.PAGE, 1.5 * rows + 0.3, sharex="col")
    (errors,), *inputs = grid
    for i, (log, label) in enumerate(zip(logs, labels, strict=True)):
        error = np.maximum(finite_errors(log), FINEST)
        kept = thin(error, bins=600)
        colour, dashes = look.INPUTS[i % len(look.INPUTS)]
        name = f"{label} (failed)" if log.failed else label
        t = log.t[: len(error)]
        errors.semilogy(t[kept], error[kept], color=colour, linestyle=dashes, label=name)
    errors.set_ylabel("‖e‖ (cm)")
    errors.legend()
    for (axes,), log, label in zip(inputs, logs, labels, strict=True):
        if log.u.size:
            draw_inputs(axes, log)
            scale_inputs(axes, [log])
        axes.set_ylabel(f"u ({log.u_unit})")
        axes.set_title(label, loc="left")
    errors.set_xlim(0, max(log.duration for log in logs))
    grid[-1][0].set_xlabel(look.TIME)
    return figure
