"""softdyn: analytic models and controllers for underactuated soft robots.

    model = softdyn.load("finger")
    state = model.state(q, v)
    command = softdyn.controllers.SoftIdClfQp(model)(state, softdyn.SetPoint(y))

- `description`: what a file says: links, joints, a spring's stiffness (`annotations`), looks;
- `dynamics`: every term of the equations of motion, J̇ (`kernels`), moment arms of
  tendons (`tendons`), derivatives, time steps;
- `statics`: where a robot rests, how firmly, which inputs hold its tip at a point;
- `view`: the robot in the browser;
- `design`: from a few parameters to a robot's file and meshes;
- `identification`: from measurements to parameters;
- `controllers`: the paper's laws and ours; `validation`: MuJoCo as the judge; `commands`: the
  command line;
- `references`: set points and ellipses; `loading`: `load`; `checks`, `exceptions`: arguments and
  what is raised; `files`: files that appear whole; `compiled`: kernels with and without Numba.

The public names are imported when they are used, as `__init__.pyi` lists them: the command line
answers `--help` without an engine.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
