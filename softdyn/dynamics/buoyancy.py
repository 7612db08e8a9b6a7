"""The buoyancy of links: MuJoCo's compensation of a body's weight.

A link of mass m with the share c = `gravcomp` is lifted by -c m g at its centre of mass. A body of
the density ρ in a fluid of the density ρ_f has c = ρ_f/ρ (Archimedes). The joint force is the
gradient of Σ c m gᵀ r, which is minus the gravity energy of masses c m.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from softdyn.dynamics.engine import ThreadScratch


class Buoyancy:
    """The buoyancy as a force of the model; it meets `softdyn.dynamics.forces.Force`.

    Parameters
    ----------
    engine : pinocchio.Model
        The engine's model of the robot.
    lifted : sequence of (int, float, ndarray)
        A body's number, a mass whose weight is compensated (kg), and its place in the body's frame
        (3,), m.
    """

    name = "buoyancy"

    def __init__(self, engine: pin.Model, lifted: Sequence[tuple[int, float, np.ndarray]]) -> None:
        self._given = engine, lifted
        model = engine.copy()
        for k in range(model.njoints):
            model.inertias[k] = pin.Inertia.Zero()
        for body, mass, place in lifted:
            model.inertias[body] += pin.Inertia(mass, np.array(place), np.zeros((3, 3)))
        self._scratch = ThreadScratch(model)

    def __reduce__(self) -> tuple[Any, ...]:
        return Buoyancy, self._given

    def __call__(self, model: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """F (n,) in the order of v (N m, N)."""
        return np.array(pin.computeGeneralizedGravity(*self._memory, q))

    def derivatives(
        self, model: Any, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n)."""
        n = len(v)
        by_q = pin.computeGeneralizedGravityDerivatives(*self._memory, q)
        return np.reshape(by_q, (n, n)).copy(), np.zeros((n, n))

    def energy(self, model: Any, q: np.ndarray) -> float:
        """The potential (J)."""
        return -float(pin.computePotentialEnergy(*self._memory, q))

    @property
    def _memory(self) -> tuple[pin.Model, pin.Data]:
        return self._scratch.model, self._scratch.data
