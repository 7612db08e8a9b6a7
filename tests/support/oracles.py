"""Central differences, the oracle of all analytic derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softdyn import SoftModel


def rate(
    model: SoftModel,
    f: Callable[[np.ndarray], object],
    q: np.ndarray,
    v: np.ndarray,
    step: float = 1e-3,
) -> np.ndarray:
    """df/dt along q̇ = v, with f's shape.

    Central differences at `step` and 2 · `step` are extrapolated (Richardson; error ~ step⁴).
    """

    def central(h: float) -> np.ndarray:
        ahead, behind = (np.asarray(f(model.integrate(q, s * h * v)), float) for s in (1, -1))
        return (ahead - behind) / (2 * h)

    return (4 * central(step) - central(2 * step)) / 3


def gradient(
    model: SoftModel, f: Callable[[np.ndarray], object], q: np.ndarray, step: float = 1e-3
) -> np.ndarray:
    """∂f/∂q along every velocity coordinate, with f's shape and one more axis."""
    return np.stack([rate(model, f, q, axis, step) for axis in np.eye(model.nv)], axis=-1)


def slopes(f: Callable[[np.ndarray], object], size: int, h: float) -> np.ndarray:
    """∂f/∂x at x = 0 along each of `size` axes, with f's shape and one more axis (error ~ h⁴)."""

    def apart(x: np.ndarray) -> np.ndarray:
        return np.asarray(f(x)) - np.asarray(f(-x))

    return np.stack([
        (8 * apart(h * e) - apart(2 * h * e)) / (12 * h) for e in np.eye(size)
    ], axis=-1)  # fmt: skip


def relative(a: np.ndarray, b: np.ndarray, scale: float = 0.0) -> float:
    """max|a - b| divided by the largest of both and `scale`."""
    size = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0), scale)
    return float(np.abs(a - b).max(initial=0.0) / size) if size > 0 else 0.0
