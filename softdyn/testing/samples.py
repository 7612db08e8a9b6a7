"""States, references and readings with which a user's class is called."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, State

HOSTILE = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30)
SPEED = 0.5  # rad/s or m/s, times the joint's scale
ROOM = 0.8  # of the range between a joint's limits


def states(model: SoftModel, count: int, seed: int) -> list[State]:
    """Random states between the joint limits, the first one at rest at q = 0."""
    rng = np.random.default_rng(seed)
    lower = np.where(np.isfinite(model.lower), model.lower, -0.5)
    upper = np.where(np.isfinite(model.upper), model.upper, 0.5)
    middle, half = 0.5 * (lower + upper), 0.5 * ROOM * (upper - lower)
    found = [model.state(model.q0, np.zeros(model.nv))]
    for _ in range(count - 1):
        q = model.configuration(middle + half * rng.uniform(-1, 1, model.nv))
        found.append(model.state(q, SPEED * np.minimum(half, 1.0) * rng.normal(size=model.nv)))
    return found


def references(model: SoftModel, count: int, seed: int) -> list[Reference]:
    """Motions of the tip through points that the robot reaches."""
    rng = np.random.default_rng(seed + 1)
    return [
        SetPoint(state.y) if k % 2 else Reference(state.y, *(0.1 * rng.normal(size=(2, 3))))
        for k, state in enumerate(states(model, count, seed + 1))
    ]


def hostile_states(state: State) -> list[tuple[str, State]]:
    """Copies of a state with a number that no sensor should send, in one of its parts."""
    found = []
    for name in ("v", "y", "ydot", "h", "M", "J"):
        for value in HOSTILE:
            part = np.array(getattr(state, name))
            part.flat[0] = value
            change: dict[str, Any] = {name: part}
            found.append((f"state.{name}[0] = {value:g}", replace(state, **change)))
    return found


def hostile_references() -> list[tuple[str, Reference]]:
    """References that a path of one's own may give by mistake."""
    found = []
    for name in ("y", "ydot", "yddot"):
        for value in (1e300, -1e300, 1e30, 5e-324):
            parts: dict[str, Any] = {"y": np.zeros(3)} | {name: np.full(3, value)}
            found.append((f"reference.{name} = {value:g}", Reference(**parts)))
    return found
