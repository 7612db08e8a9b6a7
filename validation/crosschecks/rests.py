"""Whether the twin stays at an equilibrium while the input is held."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from softdyn.checks import number
from softdyn.dynamics.relaxation import without_branches
from softdyn.dynamics.stops import Stops
from softdyn.statics import Equilibrium
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import SimulationError, Twin

SAMPLE = 0.01  # s between two readings of the tip
NUDGE_SEED = 0


@dataclass(frozen=True)
class Drift:
    """Distance of the tip from its starting point (m).

    Attributes
    ----------
    largest, final : float
        The largest over the run, and the one at its end; infinite when the simulation stopped.
    """

    largest: float
    final: float


def hold(
    equilibrium: Equilibrium,
    duration: float = 10.0,
    *,
    timestep: float = 5e-4,
    nudge: float = 0.0,
) -> Drift:
    """Put the twin, with joint limits, at an equilibrium with zero velocity and hold the input.

    Parameters
    ----------
    duration : float
        Length of the run (s).
    timestep : float
        Integration step of the plant (s).
    nudge : float
        Standard deviation of random joint displacements at the start, in rad or in parts of a
        shorter stroke. Without them the robot would leave an unstable equilibrium only through
        rounding.
    """
    model = equilibrium.model
    steps = max(1, round(SAMPLE / number("timestep", timestep, above=0.0)))
    samples = math.ceil(number("duration", duration, above=0.0) / (steps * timestep) - 1e-9)
    twin = Twin(without_branches(model), timestep=timestep)
    at = model.coordinates(equilibrium.q)
    span = np.minimum(model.upper - model.lower, 1.0)
    off = nudge * span * np.random.default_rng(NUDGE_SEED).normal(size=model.nv)
    off = Stops.of(model).within(at + off) - at
    start = model.integrate(equilibrium.q, np.where(equilibrium.held, 0.0, off))
    twin.set_state(*StateMap(model, twin).to_twin(start, np.zeros(model.nv)))
    largest = final = 0.0
    for _ in range(samples):
        try:
            twin.advance(equilibrium.u, steps)
        except SimulationError:
            return Drift(math.inf, math.inf)
        final = float(np.linalg.norm(twin.tip - equilibrium.y))
        largest = max(largest, final)
    return Drift(largest, final)
