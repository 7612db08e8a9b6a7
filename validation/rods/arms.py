"""A model built from an arm's numbers, and figures of this arm."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import softdyn
from softdyn import InputError, SoftModel, design, statics
from softdyn.description.urdf import MAX_DOF


def model_of(arm: design.Arm) -> SoftModel:
    """The model of an arm; its temporary URDF is deleted."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(design.urdf(arm), encoding="utf-8")
        return softdyn.load(file)


def refined(arm: design.Arm, segments: int) -> design.Arm:
    """The same arm with the given number of joints in each section."""
    return replace(arm, sections=tuple(replace(s, segments=segments) for s in arm.sections))


def counts_for(arm: design.Arm, counts: Sequence[int]) -> tuple[int, ...]:
    """The numbers of joints that a file may have, ascending.

    Raises
    ------
    InputError
        Fewer than two are left.
    """
    freedoms = sum(len(section.freedoms) for section in arm.sections)
    found = tuple(sorted({n for n in counts if n * freedoms <= MAX_DOF}))
    if len(found) < 2:
        expected = f"two numbers up to {MAX_DOF // freedoms}, {MAX_DOF} degrees of freedom"
        raise InputError("--segments", expected, " ".join(map(str, counts)))
    return found


def frequencies(model: SoftModel, count: int) -> np.ndarray:
    """Natural frequencies (count,) of the straight, weightless arm (Hz); equal ones once."""
    # 1/ω² are the largest eigenvalues, so that rounding is relative to the slowest mode
    root = np.linalg.inv(np.linalg.cholesky(model.tangent_stiffness(model.q0)))
    M = model.state(model.q0, np.zeros(model.nv)).M
    squares = np.linalg.eigvalsh(root @ M @ root.T)[::-1]
    found: list[float] = []
    for value in 1 / (2 * math.pi * np.sqrt(np.maximum(squares, 1e-300))):
        if not found or value > found[-1] * (1 + 1e-6):
            found.append(float(value))
    return np.array(found[:count])


def tip(model: SoftModel, tensions: Sequence[float] | None = None) -> np.ndarray:
    """Position (3,) of the tip at equilibrium, with slowly raised tensions (m)."""
    if tensions is None:
        return statics.rest(model).y
    return statics.ramp(model, np.array(tensions))[0].y
