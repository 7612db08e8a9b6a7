"""A real tentacle, identified from its published poses.

The unknowns are chosen by the rms of rows left out, among the rows that are fitted alone. The other
rows are scored once.
"""

from __future__ import annotations

import csv
import json
import re
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from softdyn.commands import cli, identify

CASE = "paper_results/secVa_system_identification"
ARM = """\
name = "tentacle"
unusual = true
[material]
youngs_modulus_MPa = 0.505
poissons_ratio = 0.45
density_kg_m3 = 1500
[[section]]
name = "long"
length_mm = 305
radius_mm = [15.41, 6.42]
segments = 8
freedoms = ["bend", "twist"]
[[section]]
name = "end"
length_mm = 55
radius_mm = [6.42, 4.80]
segments = 2
[[cable]]
name = "m1"
angle_deg = -60
offset_mm = [11.4, 2.4025]
routing = "channel"
to = "long"
max_tension_N = 20
[[cable]]
name = "m2"
angle_deg = 60
offset_mm = [11.4, 2.4025]
routing = "channel"
to = "long"
max_tension_N = 20
"""
MARKERS = {
    "p1": (129.1, (0, 0, 25)), "p2": (219.5, (0, 0, -21)), "p3": (280, (0, 0, 20)),
    "p4": (360, (8, 0, 0)),
}  # fmt: skip
CAMERA = "-0.03 -0.013 0 1.5707963267948966 0 0"  # the authors' frame, from their script
PULLEY = 0.0325  # m, tension = torque / PULLEY
TORQUES = {  # N m, by the ends of the files' names; the authors' script states them
    "005": 0.05, "01": 0.1, "012": 0.12, "015": 0.15, "018": 0.18, "02": 0.2, "025": 0.25,
}  # fmt: skip
BOTH = {
    "001": (0.1, 0.1), "002": (0.2, 0.2), "001002": (0.1, 0.2), "0015002": (0.15, 0.2),
    "002001": (0.2, 0.1), "0020015": (0.2, 0.15), "00100005": (0.1, 0.05),
    "00050010": (0.05, 0.1),
}  # fmt: skip
FITTED = 8  # the authors' poses for their identification come first in their script
PHYSICS = (
    "--shared youngs_modulus density",
    "--shared youngs_modulus density offset.2",
    "--shared youngs_modulus density offset.2 input_loss",
    "--shared youngs_modulus density offset.2 input_loss --free s.point offset.point",
)
FOLDS = {8: 8, 11: 11, 22: 7}


def command(arguments: cli.Arguments) -> int:
    """Measure, report, write."""
    from softdyn.validation.tables import Table
    from tests.proof.field import page

    names, inputs, seen = poses(arguments.data)
    with TemporaryDirectory() as folder:
        rows = measured(Path(folder), inputs, seen)
    table = Table(
        ["fitted to", "unknowns", "rms (mm)", "left out", "other poses", "CPU (s)"], rows,
        ["", "", ".1f", ".1f", ".1f", ".0f"],
    )  # fmt: skip
    if arguments.write is not None:
        page.replace(arguments.write, "tentacle", table.markdown())
    cli.write_report({"poses": names, "rows": rows}, arguments.json, table.text())
    return cli.PASSED


def poses(data: str) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names of the files, tensions (N, 2), and markers (N, 4, 3) from the base's marker (m)."""
    from softdyn import InputError

    folder = Path(data)
    folder = folder / CASE if (folder / CASE).is_dir() else folder
    script = folder / "code" / "identify_soft_tentacle_residual.py"
    if not script.is_file():
        raise InputError("--data", f"a checkout with {CASE}", data)
    names, inputs, seen = [], [], []
    pattern = r'"(m\w+)\.csv", header=None\)(.*?)_transform_points'
    for found in re.finditer(pattern, script.read_text(encoding="utf-8"), re.DOTALL):
        columns = {one: int(k) for one, k in re.findall(r"(p\w) = filtered\[(\d+):", found[2])}
        mean = np.loadtxt(folder / "data" / f"{found[1]}.csv", delimiter=",")[:, 2:].mean(0)
        place = {one: mean[k : k + 3] for one, k in columns.items()}
        motors, _, end = found[1].partition("_u")
        pair = BOTH[end] if motors == "m12" else (TORQUES[end], 0.0)
        names.append(found[1])
        inputs.append(pair[::-1] if motors == "m2" else pair)
        seen.append([place[one] - place["pb"] for one in MARKERS])
    return names, np.array(inputs) / PULLEY, np.array(seen)


def measured(folder: Path, inputs: np.ndarray, seen: np.ndarray) -> list[list[Any]]:
    """The rows of the table."""
    (folder / "tentacle.toml").write_text(ARM)
    (folder / "points.toml").write_text("".join(
        f'[[point]]\nname = "{name}"\ns_mm = {along}\noffset_mm = {list(offset)}\n'
        for name, (along, offset) in MARKERS.items()
    ))  # fmt: skip
    every, rows = np.arange(len(inputs)), []
    for title, fitted, several in (
        (f"the authors' {FITTED}", every[:FITTED], PHYSICS[:3]),  # 8 poses for few unknowns
        ("every other of 22", every[::2], PHYSICS[2:]),
    ):
        rest = np.setdiff1d(every, fitted)
        for name, some in (("fit", fitted), ("test", rest)):
            written(folder / f"{name}.csv", inputs[some], seen[some])
        tried = [identified(folder, words, FOLDS[len(fitted)], test=True) for words in several]
        best = min(range(len(tried)), key=lambda k: tried[k][0]["rms_left_out"])
        for k, (found, cpu) in enumerate(tried):
            # only the chosen unknowns are scored on the other poses
            other = 1e3 * found["rms_held_out"] if k == best else None
            left = 1e3 * found["rms_left_out"]
            rows.append([title, several[k], 1e3 * found["rms"], left, other, cpu])
    written(folder / "fit.csv", inputs, seen)
    found, cpu = identified(folder, PHYSICS[-1], FOLDS[len(every)])
    rms, left = 1e3 * found["rms"], 1e3 * found["rms_left_out"]
    rows.append(["all 22", PHYSICS[-1], rms, left, None, cpu])
    return rows


def written(path: Path, inputs: np.ndarray, seen: np.ndarray) -> None:
    """Write poses as `softdyn identify` reads them; the cables were pulled in."""
    columns = [f"point.{one}.{axis}" for one in MARKERS for axis in "xyz"]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["u.m1", "u.m2", "direction.m1", "direction.m2", *columns])
        for u, places in zip(inputs, seen, strict=True):
            writer.writerow([*u, 1, 1, *places.ravel()])


def identified(
    folder: Path, words: str, folds: int, test: bool = False
) -> tuple[dict[str, Any], float]:
    """The report of `softdyn identify` and its CPU time (s)."""
    camera = [] if "--camera" in words else ["--camera", *CAMERA.split()]
    extra = ["--test", f"{folder}/test.csv"] if test else ["--hold-out", "0"]
    arguments: Sequence[str] = (
        f"{folder}/tentacle.toml", f"{folder}/fit.csv", "--static",
        "--points", f"{folder}/points.toml", *words.split(), *camera, *extra,
        "--folds", str(folds),
        "--json", f"{folder}/report.json",
    )  # fmt: skip
    begin = time.process_time()
    identify.main(list(arguments))
    cpu = time.process_time() - begin
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report, cpu
