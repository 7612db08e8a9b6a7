"""Controllers: each a class C(model, gains=None) that maps (State, Reference) → Command.

Modules; numbers in brackets are the paper's equations, in their order of appearance:

- `controller`: the contract (`Command`, `reset`), and the guard of a controller's input;
- `law`: the base of the paper's six controllers, which are
- `clf_qp`: CLF-QP (5, 11), input-output linearisation under bounds;
- `soft_id_clf_qp`: Soft ID-CLF-QP (12, 13), the paper's own; horizon and barriers on request;
- `id_clf_qp`: its hard ancestor, with the whole dynamics (1) as the constraint;
- `impedance`: IC (14 to 16) and UIC (17 to 20), in closed form; `impedance_qp`: IC-QP (21, 22);
- `qps`: their QPs and the parts of them, the Lyapunov function (6 to 10) among them;
- `gains`: their parameters, with the paper's table;
- `barriers`: obstacles and limits that `SoftIdClfQp` keeps from;
- `staged`: the same law with the tuned gains of a `schedule`, "best"; `mpc`: predictive control;
- `allocation`: joint torques into bounded inputs, for a law of one's own;
- `registry`: any of them by name, and a user's own class from a file.

The public names are imported when they are used, as `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
