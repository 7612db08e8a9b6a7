"""softdyn: analytic models and controllers for underactuated soft robots.

    model = softdyn.load("finger")
    state = model.state(q, v)
    command = softdyn.controllers.SoftIdClfQp(model)(state, softdyn.SetPoint(y))

- `description`: a robot's file as data: links, joints, springs (`annotations`), looks;
- `dynamics`: every term of the equations of motion, J̇ (`kernels`), moment arms of
  tendons (`tendons`), derivatives, time steps;
- `actuation`: winches, which command a free length of cable;
- `sensing`: the sensors' readings and their Jacobians;
- `tasks`: what is to be controlled, its error and Jacobian, and references for it;
- `safety`: distances between links and obstacles, as barriers; `estimation`: the observer;
- `statics`: equilibria, their stability, the inputs that hold the tip at a point;
- `view`: the robot in the browser;
- `design`: from a few parameters to a robot's file and meshes;
- `identification`: from measurements to parameters;
- `controllers`: the paper's controllers and ours; `validation`: the closed loop and checks in
  MuJoCo; `testing`: tests of a user's own class; `commands`: the command line;
- `plausible`: rules for numbers that are valid and not plausible;
- `references`: set points and ellipses; `loading`: `load`; `checks`, `exceptions`: checks of
  arguments, and errors; `installed`: that the engines are the installed ones; `copies`: copies
  that stay read-only, and share nothing that changes; `files`: files written whole or not at all;
  `toml_table`, `csv_table`, `arrays`: the readers of TOML, CSV and NPZ; `compiled`: kernels with
  and without Numba.

The public names are imported when they are used, as `__init__.pyi` lists them, so that the command
line answers `--help` without loading an engine.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
