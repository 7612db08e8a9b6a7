"""The tables and figures of docs/field.md."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.validation.files import write_text
from softdyn.validation.tables import Table
from tests.proof.field.cases import PERIOD
from tests.proof.field.rods import distance


def tables(found: Mapping[str, Any]) -> str:
    """Distances of tips, convergence and times, as Markdown."""
    theirs, ours = found["theirs"], found["ours"]
    others = list(theirs)
    rows = [
        [name, *(None if name == other else 1e3 * distance(tip, theirs[other]) for other in others)]
        for name, tip in {**ours, **theirs}.items()
    ]
    parts = [
        Table(
            [f"rms distance (mm), {found['case'].about}", *others], rows,
            ["", *[".1f"] * len(others)],
        ).markdown()
    ]  # fmt: skip
    for ladder in found["ladders"]:
        columns = [f"{ladder.name} (mm)", *map(str, ladder.counts), "order"]
        row = [["rms error", *(1e3 * x for x in ladder.errors), ladder.order]]
        parts.append(Table(columns, row, ["", *[".2g"] * len(ladder.counts), ".1f"]).markdown())
    if "times" in found:
        walls = found["times"]
        peers = {name: wall for name, wall in walls.items() if not name.startswith("ours")}
        rows = [[name, wall, *(peer / wall for peer in peers.values())]
                for name, wall in walls.items()]  # fmt: skip
        titles = ["wall time of a simulated second", "s", *(f"{name} / this" for name in peers)]
        parts.append(Table(titles, rows, ["", ".3f", *[".1f"] * len(peers)]).markdown())
    return "\n\n".join(parts)


def plain(found: Mapping[str, Any]) -> dict[str, Any]:
    """The figures for JSON."""
    tips = {**found["ours"], **found["theirs"]}
    return {
        "case": found["case"].about,
        "distance_mm": {
            name: {
                other: 1e3 * distance(tip, found["theirs"][other]) for other in found["theirs"]
            }
            for name, tip in tips.items()
        },
        "ladders": [ladder.to_dict() | {"values": None, "limit": None}
                    for ladder in found["ladders"]],
        "wall_s_per_s": found.get("times"),
    }  # fmt: skip


def write(
    path: str | Path, name: str, text: str, theirs: Mapping[str, np.ndarray],
    found: Mapping[str, Any],
) -> None:  # fmt: skip
    """Replace the block of a case in the document, and draw its figure beside it.

    Raises
    ------
    InputError
        The document has no such block.
    """
    picture = Path(path).parent / f"field_{name}.png"
    draw(picture, {**theirs, **found["ours"]})
    replace(path, name, f"{text}\n\n![Tips over time]({picture.name})")


def replace(path: str | Path, name: str, text: str) -> None:
    """Replace the block of a case in the document.

    Raises
    ------
    InputError
        The document has no such block.
    """
    document = Path(path).read_text(encoding="utf-8")
    begin, end = f"<!-- generated: python -m tests.proof field {name} -->", f"<!-- end {name} -->"
    block = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.S)
    if len(block.findall(document)) != 1:
        raise InputError(str(path), f"one block between {begin} and {end}", "none, or several")
    content = f"{begin}\n\n{text}\n\n{end}"
    write_text(path, block.sub(lambda _: content, document))


def draw(path: Path, tips: Mapping[str, np.ndarray]) -> None:
    """Draw the published tips, and ours with 20 joints, over time."""
    from softdyn.validation.loop.pictures import plot_style as look

    drawn = ("PyElastica", "SoRoMoX", "SoRoSim", "ours, 20 joints that bend")
    with look.style():
        figure, grid = look.panels(3, 1, look.PAGE, 4.6, sharex="col")
        for axis, (axes,) in enumerate(grid):
            for name, shown in zip(drawn, look.INPUTS, strict=False):
                tip = tips[name]
                look.line(axes, PERIOD * np.arange(len(tip)), 100 * tip[:, axis], shown, label=name)
            axes.set_ylabel(f"{'xyz'[axis]} (cm)")
        grid[0][0].legend()
        grid[-1][0].set_xlabel(look.TIME)
        look.write_figure(figure, path, dpi=100)
