"""Growth of a control step's time with a robot's joints and inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import softdyn
from softdyn import SoftModel
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.validation.loop import setups
from tests.proof.timing.recording import record
from tests.proof.timing.step_time import Subject, measure
from tests.support.long_chains import chain_urdf

JOINTS, INPUTS = (4, 8, 16, 27, 48, 72, 100, 150, 200), (1, 2, 3, 6, 9, 12, 16, 24)
FIXED_INPUTS, FIXED_JOINTS = 3, 48  # along the other axis
GAINS = Gains(Kp=100.0, eps=0.05)
TARGET = np.array([0.04, 0.02, 0.01])  # m, distance of the target from the tip at rest
DURATION = 0.5  # s, duration of the closed loop for the states


def scaling(
    joints: Sequence[int] = JOINTS,
    inputs: Sequence[int] = INPUTS,
    states: int = 60,
    rounds: int = 20,
    tick: Callable[[], Any] = lambda: None,
) -> dict[str, list[dict[str, Any]]]:
    """Rows ``joints`` and ``inputs``: the Soft ID-CLF-QP's step on generated chains.

    Every chain moves to a point near its equilibrium, and its step is timed on states of that loop.
    The chains take turns. `tick` is called after each of the `rounds`.
    """
    asked = {
        "joints": [(n, FIXED_INPUTS) for n in joints],
        "inputs": [(FIXED_JOINTS, m) for m in inputs],
    }
    sizes = sorted({size for sizes in asked.values() for size in sizes})
    with TemporaryDirectory() as folder:
        subjects = {size: _subject(chain(Path(folder), *size), states) for size in sizes}
    times = measure(subjects, rounds, tick)
    return {
        axis: [{"n": n, "m": m, **times[n, m].row()} for n, m in sizes]
        for axis, sizes in asked.items()
    }


def chain(folder: Path, joints: int, inputs: int) -> SoftModel:
    """The model of a generated chain, whose file is written below `folder`."""
    path = folder / f"chain_{joints}_{inputs}.urdf"
    path.write_text(chain_urdf(joints, inputs))
    return softdyn.load(path)


def _subject(model: SoftModel, states: int) -> Subject:
    tip = model.state(model.q0, np.zeros(model.nv)).y
    loop = setups.setup_of(model).target(tip + TARGET)
    recording = record(model, _controller, states, [loop], DURATION)
    return Subject(model, _controller, recording.steps())


def _controller(model: SoftModel) -> SoftIdClfQp:
    return SoftIdClfQp(model, GAINS)
