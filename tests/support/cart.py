"""A cart on a spring, small enough for closed forms, and two controllers for it."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from softdyn import SetPoint, SoftModel
from tests.support.robots import build, hinge

MASS, STIFFNESS, DAMPING = 0.5, 8.0, 0.3
LENGTH = 0.4
TARGET = SetPoint([LENGTH + 0.5, 0.0, 0.0])


def text(
    lower: float = -9, upper: float = 9, *, damping: float = DAMPING, stiffness: float = STIFFNESS,
    limit: tuple[float, float] = (-9, 9), block: str = "",
) -> str:  # fmt: skip
    """A cart along x with the tip 0.4 m ahead of it, so that gravity does no work."""
    return hinge(
        MASS, None, name="x", child="body", axis="1 0 0", kind="prismatic", limit=limit,
        damping=damping, stiffness=stiffness, tip=f"{LENGTH} 0 0", pull=(lower, upper), block=block,
    )  # fmt: skip


def cart(*bounds: float, **changes: Any) -> SoftModel:
    """The model of `text`, without a file."""
    return build(text(*bounds, **changes))


def step_response(t: np.ndarray, force: float) -> np.ndarray:
    """Position of the cart after a force on it at rest, t in s."""
    rate, natural = DAMPING / (2 * MASS), STIFFNESS / MASS
    omega = np.sqrt(natural - rate**2)
    wave = np.cos(omega * t) + rate / omega * np.sin(omega * t)
    return force / STIFFNESS * (1 - np.exp(-rate * t) * wave)


def push(force):
    return lambda state, reference: SimpleNamespace(u=np.array([force]))


def steer(state, reference):
    """Computed torque with both poles at -5: the error obeys ë + 10 ė + 25 e = 0."""
    a = reference.yddot[0] - 10 * (state.ydot - reference.ydot)[0] - 25 * (state.y - reference.y)[0]
    return SimpleNamespace(u=(state.M[0] * a + state.h) / state.B[0])
