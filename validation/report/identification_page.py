"""A page about an identification: parameters, fit, residuals and their whiteness."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from softdyn.identification import Identified
from softdyn.identification.data import spread
from softdyn.identification.hints import PARTS, where
from softdyn.identification.result import NOT_WHITE
from softdyn.validation.loop.pictures.plot_style import style
from softdyn.validation.report.document_page import document_page, picture, wide
from softdyn.validation.tables import Table

TITLES = ("parameter", "value", "95 %", "file", "unit")
SHOWN = 4  # number of outputs shown, those with the worst fit


def page(name: str, found: Identified) -> str:
    """One HTML page, which needs no network.

    Parameters
    ----------
    name : str
        Name of the robot.
    found : Identified
    """
    rows = []
    for one in found.estimates:
        shown: list[Any] = ["not identified", ""]
        if one.identified:
            shown = [one.value, "{:.6g} … {:.6g}".format(*one.interval)]
        rows.append([one.parameter.label, *shown, one.parameter.nominal, one.parameter.unit])
    table = Table(TITLES, rows, ("", ".6g", "", ".6g", ""))
    bad = [() if one.identified else range(len(TITLES)) for one in found.estimates]
    held_out = (
        f"In the part of the data held out the residuals are {found.held_out:.3g} times the fit's."
    )
    notes = [
        *([held_out] if np.isfinite(found.held_out) else []),
        *(f"Not identifiable from these data: {text}." for text in found.unidentifiable),
    ]
    if not found.static:
        white = "white" if found.white >= 0.01 else f"not white: {NOT_WHITE}"
        notes += [
            f"They are {white} (Ljung–Box p = {found.white:.2g}); the intervals account for it.",
            f"Half the step of the simulation would move an estimate by {found.moved:.2g} of its"
            " standard deviation, at most.",
        ]
    with style():
        pictures = [_outputs(found)] + ([] if found.static else [_correlation(found)])
        images = [picture(f"data:image/svg+xml;base64,{_svg(f)}") for f in pictures]
    words = [f"<p>{escape(note)}</p>" for note in notes]
    parts = [wide(table, bad), *words, *images, *_places(found)]
    return document_page(f"Identification of {name}", parts)


def _places(found: Identified) -> list[str]:
    """Tables of the residuals by output, time and input."""
    rows = where(found)
    outputs = [[row["of"], row["rms"]] for row in rows if row["by"] == "output"]
    quarters: dict[str, list[Any]] = {}
    for row in rows:
        if row["by"] != "output":
            quarters.setdefault(row["by"], [f"by {row['by']}"]).append(row["rms"])
    titles = ["residuals, in deviations", *(f"quarter {k + 1}" for k in range(PARTS))]
    tables = (
        Table(["output", "rms residual"], outputs, ("", ".3g")),
        Table(titles, list(quarters.values()), ("", *[".2f"] * PARTS)),
    )
    return [wide(table) for table in tables]


def _outputs(found: Identified) -> Figure:
    """Measured and simulated values, and residuals, of the outputs that fit worst."""
    count = min(SHOWN, len(found.names))
    data = found.data
    wide = np.maximum(spread(data.outputs), 1e-12)
    worst = np.argsort(-found.noise / wide)[:count]
    figure = Figure(figsize=(9, 1.9 * count), layout="constrained")
    axes = figure.subplots(count, 2, squeeze=False, sharex=True)
    for (left, right), k in zip(axes, worst, strict=True):
        times, values = data.t, data.outputs[:, k]
        left.plot(times, values, ".", ms=2, color="0.6", label="measured")
        left.plot(times, values - found.residuals[:, k], lw=1, label="fitted")
        left.set_ylabel(found.names[k])
        right.plot(data.t, found.residuals[:, k], ".", ms=2)
        right.axhline(0, color="0.7", lw=0.8)
        right.set_ylabel("residual")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    for axis in axes[-1]:
        axis.set_xlabel("Row" if found.static else "Time (s)")
    return figure


def _correlation(found: Identified) -> Figure:
    """Autocorrelation of all residuals, and the band of white ones."""
    figure = Figure(figsize=(9, 2.4), layout="constrained")
    axes = figure.subplots()
    lags = np.arange(1, len(found.autocorrelation) + 1)
    axes.plot(lags, found.autocorrelation, ".", color="C0")
    axes.axhspan(-2 / np.sqrt(len(found.residuals)), 2 / np.sqrt(len(found.residuals)), alpha=0.2)
    axes.set(xlabel="Lag (samples)", ylabel="Autocorrelation of the residuals")
    return figure


def _svg(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg")
    return base64.b64encode(buffer.getvalue()).decode()
