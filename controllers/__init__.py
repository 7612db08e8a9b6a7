"""Controllers: each a class C(model, gains=None) that maps (State, Reference) → Command.

Where what is; numbers in brackets are the paper's equations, in their order of appearance:

- `controller`: the contract (`Command`, `reset`), and the guard between a law and the robot;
- `law`: what is around each of the paper's six laws, which are
- `clf_qp`: CLF-QP (5, 11), input-output linearisation under bounds;
- `soft_id_clf_qp`: Soft ID-CLF-QP (12, 13), the paper's own; horizon and barriers on request;
- `id_clf_qp`: its hard ancestor, with the whole dynamics (1) as the constraint;
- `impedance`: IC (14 to 16) and UIC (17 to 20), in closed form; `impedance_qp`: IC-QP (21, 22);
- `qps`: what they share, among it the Lyapunov function (6 to 10);
- `gains`: their parameters, with the paper's table;
- `barriers`: what `SoftIdClfQp` may be told not to run into;
- `staged`: the same law with the tuned gains of a `schedule`, "best"; `mpc`: predictive control;
- `allocation`: joint torques into bounded inputs, for a law of one's own;
- `registry`: any of them by name, and a user's own class from a file.
"""

from softdyn.controllers.allocation import allocate as allocate
from softdyn.controllers.clf_qp import ClfQp as ClfQp
from softdyn.controllers.controller import Command as Command
from softdyn.controllers.controller import Controller as Controller
from softdyn.controllers.controller import InputGuard as InputGuard
from softdyn.controllers.controller import Status as Status
from softdyn.controllers.gains import Gains as Gains
from softdyn.controllers.id_clf_qp import IdClfQp as IdClfQp
from softdyn.controllers.impedance import Impedance as Impedance
from softdyn.controllers.impedance import UnderactuatedImpedance as UnderactuatedImpedance
from softdyn.controllers.impedance_qp import ImpedanceQp as ImpedanceQp
from softdyn.controllers.mpc import Mpc as Mpc
from softdyn.controllers.mpc import MpcParameters as MpcParameters
from softdyn.controllers.qps.certificate import Certified as Certified
from softdyn.controllers.registry import BEYOND as BEYOND
from softdyn.controllers.registry import CONTROLLERS as CONTROLLERS
from softdyn.controllers.registry import find_controller as find_controller
from softdyn.controllers.schedule import Schedule as Schedule
from softdyn.controllers.schedule import Stage as Stage
from softdyn.controllers.soft_id_clf_qp import SoftIdClfQp as SoftIdClfQp
from softdyn.controllers.staged import Staged as Staged
