"""MuJoCo as the judge: the twin, cross-checks, closed loops and their figures.

- `twin`: the MuJoCo plant, built from the URDF by its own path; MuJoCo's solver settings
- `crosschecks`: the model's terms and trajectories against MuJoCo's
- `comparison`: two files of one robot; `exchange`: robots written in the other
  format; `pairs`: both files in both engines, and public pairs
- `scene`: a user's own MJCF as the plant
- `loop`: the closed loop of a controller and the twin, and its log
- `oracles`: the paper's programmes as printed, the second reading of a file
- `identification`: what a fit finds in data of twins with known parameters
- `studies`: many closed loops: the paper's grid, sweeps, robustness (delay, noise), tuning
- `timing`: what a control step costs
- `live`: a robot in the browser while it runs; `play`
- `report`: figures and pages; `film`: pages as pictures
- `fuzzing`: hostile files
- `files`, `arrays`, `processes`, `plain`, `tables`: files that appear whole, NPZ files of anyone,
  runs in processes, values as JSON, tables of text

Imports point one way: report, timing and fuzzing → live → studies → oracles → loop and
crosschecks → twin.

The public names are imported when they are used, as `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
