"""Statics: where a robot rests, how firmly, and which inputs hold its tip at a given point.

Everything is analytic: Pinocchio's gravity derivatives and the tendons' Hessians, no simulation.

    from softdyn import load, statics

    model = load("finger")
    rest = statics.rest(model)                                  # under the least input
    here = statics.settle(model, u=[-0.2, -0.1])                # downhill, always stable
    search = statics.inputs_for_tip(model, [0.13, 0.0, -0.13])  # many starts
    search.nearest.u, search.nearest.stable, search.nearest.eigenvalues[0]

For a controller: `approach` moves from one equilibrium to the next along a path of targets (the
feed-forward input is its `u`, ∂y/∂u its `tip_sensitivity`), `stiffness` linearises the forces.
"""

from softdyn.dynamics.derivatives import gravity_stiffness, stiffness
from softdyn.statics.diagnosis import Diagnosis, diagnose
from softdyn.statics.equilibria import (
    Barrier,
    Equilibrium,
    StaticsError,
    balance,
    potential,
    ramp,
    residual,
    rest,
    settle,
)
from softdyn.statics.tip_search import (
    TipSearch,
    approach,
    explore,
    inputs_for_tip,
    random_inputs,
    random_shapes,
    scatter,
    spread,
)

__all__ = [
    "Barrier",
    "Diagnosis",
    "Equilibrium",
    "StaticsError",
    "TipSearch",
    "approach",
    "balance",
    "diagnose",
    "explore",
    "gravity_stiffness",
    "inputs_for_tip",
    "potential",
    "ramp",
    "random_inputs",
    "random_shapes",
    "residual",
    "rest",
    "scatter",
    "settle",
    "spread",
    "stiffness",
]
