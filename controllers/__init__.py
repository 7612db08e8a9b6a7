"""Controllers: each a class C(model, gains=None) that maps (State, Reference) → Command.

Modules; numbers in brackets are the paper's equations, in their order of appearance:

- `controller`: the contract (`Command`, `reset`), and the guard of a controller's input;
- `failed_problem`: the problem behind a fallback;
- `channels`: the channels of a log that a controller declares, and their values in its commands;
- `law`: the base class of the paper's six controllers, and what the package knows of each;
- `clf_qp`: CLF-QP (5, 11), input-output linearisation under bounds;
- `soft_id_clf_qp`: Soft ID-CLF-QP (12, 13), the paper's own; horizon and barriers are options;
- `id_clf_qp`: ID-CLF-QP, its hard ancestor, with the whole dynamics (1) as the constraint;
- `impedance`: IC (14 to 16) and UIC (17 to 20), in closed form; `impedance_qp`: IC-QP (21, 22);
- `qps`: the QPs and their parts, among them the Lyapunov function (6 to 10);
- `gains`: the controllers' parameters, with the paper's table; `proposed_gains`: for any robot;
- `barriers`: limits and `softdyn.safety.obstacles` for `SoftIdClfQp`;
- `safety_filter`: barriers for any other controller;
- `mpc`: predictive control, whose parts are in `predictive`;
- `staged`: `SoftIdClfQp` with the tuned gains of a `schedule`; `best`, the recommended controller;
- `policy`: a learned policy, from a NumPy file or any callable;
- `allocation`: joint torques into bounded inputs, for a user's own controller;
- `registry`: any of them by name, and a user's own class from a file.

The public names are imported when they are used, as `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
