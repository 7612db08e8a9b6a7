"""MuJoCo as the judge: the twin, cross-checks, closed loops and their figures.

- `twin`: the MuJoCo plant, built from the URDF by its own path; MuJoCo's solver settings
- `loop`: the loop of a controller and a plant, and its log
- `simulate`: one closed loop in one call
- `bench`: a real rig in place of the twin: its driver, the clock, the fail-safe; `drive`
- `rollouts`: motions under given inputs, without a controller
- `mjcf`: MJCF files: compared with a URDF, written, used as the plant
- `crosschecks`: the model's terms, trajectories and equilibria against MuJoCo's
- `studies`: many closed loops: the paper's grid, sweeps
- `paper`: the paper's experiments
- `identification`: what a fit finds in data of twins with known parameters
- `rods`: how many joints an arm needs
- `live`: a plant and a controller in front of live pages; `play`
- `environment`: the loop as a Gymnasium environment, in which policies learn
- `report`: figures and pages
- `inputs`: the files that a command reads
- `channels`: the quantities that a run records
- `files`, `processes`, `plain_data`, `tables`: files that appear whole, runs in processes,
  values as JSON, tables of text

Imports point one way; `[tool.importlinter]` in pyproject.toml has the order. What proves the
toolkit itself (fuzzing, documents, closed forms) is `tests/proof`, not a part of the package.

The public names are imported when they are used, as `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
