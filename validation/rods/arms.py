"""A model straight from an arm's numbers, and what is measured of it."""

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
    """The model of an arm; its file is gone."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(design.urdf(arm), encoding="utf-8")
        return softdyn.load(file)


def refined(arm: design.Arm, segments: int) -> design.Arm:
    """The same arm with so many joints in each section."""
    return replace(arm, sections=tuple(replace(s, segments=segments) for s in arm.sections))


def counts_for(arm: design.Arm, counts: Sequence[int]) -> tuple[int, ...]:
    """The counts that a file may hold, ascending.

    Raises
    ------
    InputError
        For fewer than two.
    """
    freedoms = sum(len(section.freedoms) for section in arm.sections)
    found = tuple(sorted({n for n in counts if n * freedoms <= MAX_DOF}))
    if len(found) < 2:
        expected = f"two numbers up to {MAX_DOF // freedoms}, {MAX_DOF} degrees of freedom"
        raise InputError("--segments", expected, " ".join(map(str, counts)))
    return found


def frequencies(model: SoftModel, count: int) -> np.ndarray:
    """Natural frequencies (count,) of the straight, weightless arm (Hz); equal ones once."""
    # 1/ω² as the largest eigenvalues: rounding is relative to the slowest mode, not to the fastest
    root = np.linalg.inv(np.linalg.cholesky(model.tangent_stiffness(model.q0)))
    M = model.state(model.q0, np.zeros(model.nv)).M
    squares = np.linalg.eigvalsh(root @ M @ root.T)[::-1]
    found: list[float] = []
    for value in 1 / (2 * math.pi * np.sqrt(np.maximum(squares, 1e-300))):
        if not found or value > found[-1] * (1 + 1e-6):
            found.append(float(value))
    return np.array(found[:count])


def tip(model: SoftModel, tensions: Sequence[float] | None = None) -> np.ndarray:
    """Where the tip (3,) rests, under tensions that are raised slowly (m)."""
    if tensions is None:
        return statics.rest(model).y
    return statics.ramp(model, np.array(tensions))[0].y


def tip_under(model: SoftModel, force: np.ndarray) -> np.ndarray:
    """Where the tip (3,) rests under a dead force (3,) on it and no input (N, m).

    Newton's method on K + g - Jᵀf = 0 in ten steps of load; ∂(Jᵀf)/∂q by differences.
    """
    q, still, h = np.array(model.q0), np.zeros(model.nv), 1e-5

    def pull(at: np.ndarray, f: np.ndarray) -> np.ndarray:
        return model.state(at, still).J.T @ f

    for share in np.linspace(0.1, 1, 10):
        f = share * force
        for _ in range(50):
            state = model.state(q, still)
            r = state.K + state.bias - state.J.T @ f
            if np.abs(r).max() < 1e-11 * np.abs(force).max():
                break
            steps = [h * e for e in np.eye(model.nv)]
            turned = [(pull(q + d, f) - pull(q - d, f)) / (2 * h) for d in steps]
            q = q - np.linalg.solve(model.tangent_stiffness(q) - np.transpose(turned), r)
        else:
            raise InputError("force", "one that the arm can hold", force)
    return model.state(q, still).y
