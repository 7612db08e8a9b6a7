"""The others' programs, timed beside ours in one run, in an environment of their own."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError
from tests.proof.field import published, rods
from tests.proof.field.cases import BENDS, SECONDS, Case

HERE = Path(__file__).parent
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}


def run(python: str, program: str, *arguments: str) -> None:
    """Run a program in the peers' environment.

    Raises
    ------
    InputError
        The interpreter cannot be started, or the program fails; the error has its last line.
    """
    words = [python, str(HERE / program), *arguments]
    try:
        done = subprocess.run(
            words, env={**os.environ, **ONE_THREAD, "JAX_PLATFORMS": "cpu"}, capture_output=True,
            text=True,
        )  # fmt: skip
    except OSError as error:
        raise InputError("--peers", "an interpreter", error.strerror or error) from None
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["no word"])[-1]
        raise InputError("--peers", f"{program} to end without an error", said)


def refined(case: Case, python: str) -> dict[str, np.ndarray]:
    """Tips (samples, 3) of PyElastica's rod with what ours has, by the name of the series (m)."""
    with tempfile.TemporaryDirectory() as place:
        numbers, out = Path(place) / "case.json", Path(place) / "out.npz"
        numbers.write_text(json.dumps(case.refined(SECONDS)))
        run(python, "pyelastica_rod.py", str(numbers), str(out))
        with np.load(out) as found:
            return {f"{published.PYELASTICA}, clamp and stretch as ours": found["tip"][:, 1:]}


def times(case: Case, python: str, folder: str, runs: int, seconds: float) -> dict[str, Any]:
    """Wall times (s) for a simulated second: `runs` of every code, in turn.

    Compiling is left out: each program first makes a run that is not counted. Ours has no threads.
    """
    script = published.section(folder) / "code" / "soromox" / f"{case.script}.py"
    found: dict[str, list[float]] = {}
    twins = {n: rods.twin_of(case, case.arm(n, BENDS, case.time_constant), rods.STEP)
             for n in rods.JOINTS}  # fmt: skip
    with tempfile.TemporaryDirectory() as place:
        numbers, out = Path(place) / "case.json", Path(place) / "out.npz"
        numbers.write_text(json.dumps(case.for_pyelastica(seconds, runs)))
        _ours(case, twins, found, runs, seconds)
        run(python, "pyelastica_rod.py", str(numbers), str(out))
        found[f"{published.PYELASTICA}, {case.elements} elements"] = _seconds(out, seconds)
        _ours(case, twins, found, runs, seconds)
        run(python, "soromox_rod.py", str(script), str(seconds), str(runs), str(out))
        found[published.SOROMOX] = _seconds(out, seconds)
        _ours(case, twins, found, runs, seconds)
    return {"times": {name: float(np.median(each)) for name, each in found.items()}}


def _ours(
    case: Case, twins: dict[int, Any], found: dict[str, list[float]], runs: int, seconds: float
) -> None:
    for n, twin in twins.items():
        twin.reset()
        rods.roll(case, twin, seconds)
        for _ in range(runs):
            twin.reset()
            wall = rods.roll(case, twin, seconds)[1]
            found.setdefault(f"ours, {n} joints that bend", []).append(wall / seconds)


def _seconds(out: Path, seconds: float) -> list[float]:
    with np.load(out) as found:
        return (found["wall"] / seconds).tolist()
