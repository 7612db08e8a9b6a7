"""MuJoCo as the judge: the twin, cross-checks, closed loops and their figures.

- `twin`: the MuJoCo plant, built from the URDF by its own path; MuJoCo's solver settings
- `crosschecks`: the model's terms and trajectories against MuJoCo's
- `loop`: the closed loop of a controller and the twin, and its log
- `oracles`: the paper's programmes as printed, the second reading of a file
- `studies`: many closed loops: the paper's grid, sweeps, robustness (delay, noise), tuning
- `timing`: what a control step costs
- `report`: figures and pages
- `fuzzing`: hostile files
- `files`, `arrays`, `processes`, `plain`, `tables`: files that appear whole, NPZ files of anyone,
  runs in processes, values as JSON, tables of text

Imports point one way: report, timing and fuzzing → studies → oracles → loop and crosschecks → twin.
"""

from softdyn.validation.comparison.comparison import compare
from softdyn.validation.crosschecks.crosscheck import crosscheck
from softdyn.validation.loop.closed_loop import simulate
from softdyn.validation.loop.log import Log
from softdyn.validation.studies import paper
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin

__all__ = ["Log", "StateMap", "Twin", "compare", "crosscheck", "paper", "simulate"]
