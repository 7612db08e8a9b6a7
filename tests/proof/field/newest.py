"""The newest versions of the others beside the published tips and ours, in one run."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.commands import cli
from softdyn.validation.tables import Table
from tests.proof.field import page, peers, published, rods
from tests.proof.field.cases import BENDS, CASES, SECONDS, Case

STEPS = (1e-3, 1e-4)  # s: ours is shown with its usual step, and with PyElastica's
CONSTANT = ("planar", "spatial")  # SoRoMoX's rods of constant strains
SECONDS_TIMED = 0.3


def command(arguments: cli.Arguments) -> int:
    """Measure every rod, write one table."""
    rows = [row for name, case in CASES.items() for row in measure(name, case, arguments)]
    text = Table(
        ["rod", "code", "to its published tip (mm)", "to ours, 20 joints, 0.1 ms (mm)",
         "wall time of a simulated second (s)"],
        rows, ["", "", ".2f", ".1f", ".3f"],
    ).markdown()  # fmt: skip
    if arguments.write is not None:
        page.replace(arguments.write, "newest", text)
    cli.write_report({"rows": rows}, arguments.json, text)
    return cli.PASSED


def measure(name: str, case: Case, arguments: cli.Arguments) -> list[list[Any]]:
    """The rows of a rod: ours with two steps, and the others' newest versions."""
    given, rows = published.read(arguments.data, case), []
    twins = {step: rods.twin_of(case, case.arm(rods.USUAL, BENDS, case.time_constant), step)
             for step in STEPS}  # fmt: skip
    ours = {step: rods.roll(case, twin)[0] for step, twin in twins.items()}
    finest = ours[STEPS[-1]]
    theirs = {published.PYELASTICA: _pyelastica(case, arguments)}
    if name in CONSTANT:
        theirs[published.SOROMOX] = _soromox(name, arguments)
    for step, twin in twins.items():
        walls = []
        for _ in range(arguments.runs):
            twin.reset()
            walls.append(rods.roll(case, twin, SECONDS_TIMED)[1] / SECONDS_TIMED)
        code = f"ours, {rods.USUAL} joints, {1e3 * step:g} ms"
        far = None if step == STEPS[-1] else 1e3 * rods.distance(ours[step], finest)
        rows.append([name, code, None, far, float(np.median(walls))])
    for code, (version, tip, wall) in theirs.items():
        gaps = [1e3 * rods.distance(tip, other) for other in (given[code], finest)]
        rows.append([name, f"{code} {version}", *gaps, wall])
    return rows


def _pyelastica(case: Case, arguments: cli.Arguments) -> tuple[str, np.ndarray, float]:
    with tempfile.TemporaryDirectory() as place:
        numbers, out = Path(place) / "case.json", Path(place) / "out.npz"
        numbers.write_text(json.dumps(case.for_pyelastica(SECONDS, 1)))
        peers.run(arguments.peers, "pyelastica_rod.py", str(numbers), str(out))
        return _read(out, 1)


def _soromox(name: str, arguments: cli.Arguments) -> tuple[str, np.ndarray, float]:
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "out.npz"
        words = (name, str(SECONDS), "1", str(out))
        peers.run(arguments.peers, "soromox_newest.py", *words)
        return _read(out, 0)


def _read(out: Path, first: int) -> tuple[str, np.ndarray, float]:
    """Version, tips (samples, 3) (m), wall time of a simulated second (s)."""
    with np.load(out) as found:
        wall = float(np.median(found["wall"])) / SECONDS
        return str(found["version"]), found["tip"][:, first:], wall
