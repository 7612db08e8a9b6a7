"""Statics: a robot's equilibria, their stability, and the inputs that hold its tip at a point.

Everything is analytic, from Pinocchio's gravity derivatives and the tendons' Hessians. Nothing is
simulated.

    from softdyn import load, statics

    model = load("finger")
    print(statics.diagnose(model))                              # explains the robot's file
    rest = statics.rest(model)                                  # under the least input
    here = statics.settle(model, u=[-0.2, -0.1])                # always a stable one
    search = statics.inputs_for_tip(model, [0.13, 0.0, -0.13])  # many starts
    search.nearest.u, search.nearest.stable, search.nearest.eigenvalues[0]

For a controller: `approach` moves from one equilibrium to the next along a path of targets. The
equilibrium's `u` is the feed-forward input, and its `tip_sensitivity` is ∂y/∂u. `stiffness`
linearises the forces.

Files
-----
equilibrium
    An equilibrium: balance, stiffness, stability, poles, sensitivities.
equilibria
    Solvers: `settle`, `balance`, `ramp`, `rest`.
branch
    `approach`: follows a branch of equilibria until the tip is near a point.
cable_edges
    Joint angles at which a cable enters a round body or flips.
friction
    Rests after a stated motion, and along a slow path, of robots whose cables rub.
unknown_inputs
    Equilibria at or near a target, from arbitrary shapes, with unknown inputs.
samples
    Random inputs and shapes, and stable equilibria from them.
reachable
    Targets that a robot can reach: points, paths, rates; directions of the tip in each cell.
target_search
    The search for inputs that hold a target: `inputs_for_tip`, `inputs_for_tips`,
    `inputs_for_tasks`.
zero_dynamics
    Rank of B, stiffness against gravity in directions without an input, poles of the zero dynamics.
suspicious_values
    Numbers in a file that look wrong.
diagnosis
    `diagnose`: the findings of the last two files as a text.
"""

from softdyn.dynamics.derivatives import gravity_stiffness, stiffness
from softdyn.statics.branch import approach
from softdyn.statics.diagnosis import Diagnosis, diagnose
from softdyn.statics.equilibria import balance, ramp, rest, settle
from softdyn.statics.equilibrium import (
    Equilibrium,
    NoEquilibrium,
    StaticsError,
    potential,
    residual,
)
from softdyn.statics.friction import StuckRest, follow, rest_after, rest_interval
from softdyn.statics.reachable import (
    Loop,
    ReachCell,
    loop_around,
    reach_by_direction,
    spread_rests,
)
from softdyn.statics.samples import random_inputs, random_shapes, sample_between, sample_rests
from softdyn.statics.target_search import (
    TaskSearch,
    TipSearch,
    inputs_for_tasks,
    inputs_for_tip,
    inputs_for_tips,
)
from softdyn.statics.unknown_inputs import explore
from softdyn.statics.zero_dynamics import zero_spectrum

__all__ = [
    "Diagnosis", "Equilibrium", "Loop", "NoEquilibrium", "ReachCell", "StaticsError",
    "StuckRest", "TaskSearch", "TipSearch", "approach", "balance", "diagnose", "explore",
    "follow", "gravity_stiffness", "inputs_for_tasks", "inputs_for_tip", "inputs_for_tips",
    "loop_around",
    "potential", "ramp", "random_inputs", "random_shapes", "reach_by_direction", "residual",
    "rest", "rest_after", "rest_interval", "sample_between", "sample_rests", "settle",
    "spread_rests", "stiffness", "zero_spectrum",
]  # fmt: skip
