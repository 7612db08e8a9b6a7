"""Statics: where a robot rests, how firmly, and which inputs hold its tip at a given point.

Everything is analytic: Pinocchio's gravity derivatives and the tendons' Hessians, no simulation.

    from softdyn import load, statics

    model = load("finger")
    print(statics.diagnose(model))                              # what its file amounts to
    rest = statics.rest(model)                                  # under the least input
    here = statics.settle(model, u=[-0.2, -0.1])                # downhill, always stable
    search = statics.inputs_for_tip(model, [0.13, 0.0, -0.13])  # many starts
    search.nearest.u, search.nearest.stable, search.nearest.eigenvalues[0]

For a controller: `approach` moves from one equilibrium to the next along a path of targets (the
feed-forward input is its `u`, ∂y/∂u its `tip_sensitivity`), `stiffness` linearises the forces.

Which file holds what
---------------------
equilibrium
    An equilibrium: balance, stiffness, stability, poles, sensitivities.
stops
    Joint limits, hard and soft.
equilibria
    Solvers: `settle`, `balance`, `ramp`, `rest`.
branch
    `approach`: along a branch of equilibria towards a point for the tip.
explore
    Equilibria near a point from arbitrary shapes.
samples
    Random inputs and shapes; where a robot can rest at all.
reachable
    Targets that a robot can reach: points, paths, rates.
tip_search
    `inputs_for_tip`: all of these together.
zero_dynamics
    Rank of B, stiffness against gravity where no input acts; the zero dynamics' poles.
suspicious_values
    Numbers in a file that look wrong.
diagnosis
    `diagnose`: both of these as a text.
"""

from softdyn.dynamics.derivatives import gravity_stiffness, stiffness
from softdyn.statics.branch import approach
from softdyn.statics.diagnosis import Diagnosis, diagnose
from softdyn.statics.equilibria import balance, ramp, rest, settle
from softdyn.statics.equilibrium import Equilibrium, StaticsError, potential, residual
from softdyn.statics.explore import explore
from softdyn.statics.reachable import Loop, loop_around, spread_rests
from softdyn.statics.samples import random_inputs, random_shapes, sample_between, sample_rests
from softdyn.statics.stops import HardStops, SoftStops
from softdyn.statics.tip_search import TipSearch, inputs_for_tip
from softdyn.statics.zero_dynamics import zero_spectrum

__all__ = [
    "Diagnosis", "Equilibrium", "HardStops", "Loop", "SoftStops", "StaticsError", "TipSearch",
    "approach", "balance", "diagnose", "explore", "gravity_stiffness", "inputs_for_tip",
    "loop_around", "potential", "ramp", "random_inputs", "random_shapes", "residual", "rest",
    "sample_between", "sample_rests", "settle", "spread_rests", "stiffness",
    "zero_spectrum",
]  # fmt: skip
