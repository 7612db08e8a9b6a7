"""Step times of another checkout compared with this one, in alternating processes (ABBA).

The order is old, new, new, old, …, so that a linear drift affects both alike. A process is one
sample. Its memory layout shifts all its step times together, so more steps in one process do not
average this out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError
from softdyn.validation.tables import Table
from tests.proof.timing import checkout

HERE = Path(softdyn.__file__).resolve().parents[1]
LIMIT = 1.03  # of the ratio of new to old
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
COLUMNS = (
    ("robot", "robot", ""),
    ("controller", "controller", ""),
    ("against", "against", ""),
    ("µs", "base_us", ".1f"),
    ("new µs", "new_us", ".1f"),
    ("ratio", "ratio", ".3f"),
    ("95 % from", "low", ".3f"),
    ("to", "high", ".3f"),
    ("limit", "limit", "g"),
    ("", "verdict", ""),
)
VERDICTS = {True: "", False: "slower"}
Sample = dict[str, dict[str, float]]


def compare(
    old: Path,
    states: Mapping[str, Path],
    laws: Sequence[str],
    *,
    pairs: int = 10,
    rounds: int = 5,
    tick: Callable[[], Any] = lambda: None,
) -> list[dict[str, Any]]:
    """A row per robot and controller.

    Parameters
    ----------
    old : Path
        A checkout.
    states : dict of Path
        Robot → a file by `RecordedStates.save`, with the states for both checkouts.
    laws : sequence of str
    pairs : int
        Number of processes of each checkout, after one of each that only warms file caches.
    rounds : int
        Number of passes over all states in each process.
    tick : callable
        Called after each pair.

    Raises
    ------
    InputError
        `old` is no checkout, or lacks a robot or controller.
    """

    if not (old / "softdyn" / "__init__.py").is_file():
        raise InputError(str(old), "a checkout of softdyn", "no softdyn/__init__.py in it")
    found: dict[Path, list[Sample]] = {old: [], HERE: []}
    for k in range(pairs + 1):
        for root in (old, HERE) if k % 2 else (HERE, old):
            found[root].append(measure(root, states, laws, rounds))
        tick()

    def times(root: Path, robot: str, law: str) -> np.ndarray:
        return np.array([sample[robot][law] for sample in found[root][1:]])

    rows = []
    for robot in states:
        for law in laws:
            one, two = (times(root, robot, law) for root in (old, HERE))
            rows.append({"robot": robot, "controller": law, "against": "old"}
                        | ratio(one, two, LIMIT))  # fmt: skip
    return rows


def measure(root: Path, states: Mapping[str, Path], laws: Sequence[str], rounds: int) -> Sample:
    """One process of a checkout: {robot: {law: median µs}}."""
    command = [sys.executable, "-P", checkout.__file__, str(rounds), ",".join(laws)]
    command += [f"{robot}={path.resolve()}" for robot, path in states.items()]
    environment = os.environ | THREADS | {"PYTHONPATH": str(root.resolve())}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise InputError(str(root), "a checkout whose steps can be timed", said)
    return json.loads(done.stdout)


def ratio(base: np.ndarray, new: np.ndarray, limit: float, draws: int = 10_000) -> dict[str, Any]:
    """The ratio of two medians with its 95 % bootstrap interval; pairs (n,) are drawn together."""
    chosen = np.random.default_rng(0).integers(len(base), size=(draws, len(base)))
    ratios = np.median(new[chosen], axis=1) / np.median(base[chosen], axis=1)
    low, high = (float(x) for x in np.percentile(ratios, (2.5, 97.5)))
    base_us, new_us = float(np.median(base)), float(np.median(new))
    return {
        "base_us": base_us, "new_us": new_us, "ratio": new_us / base_us,
        "low": low, "high": high, "limit": limit, "passed": low <= limit,
    }  # fmt: skip


def comparison_table(rows: Sequence[dict[str, Any]]) -> Table:
    """The rows with their verdicts in words."""
    return Table.of(COLUMNS, [row | {"verdict": VERDICTS[row["passed"]]} for row in rows])
