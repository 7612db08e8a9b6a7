"""Controllers: each a class C(model, gains=None) that maps (State, Reference) → Command."""

from softdyn.controllers.clf_qp import ClfQp
from softdyn.controllers.controller import Command, Controller, InputGuard, Status
from softdyn.controllers.gains import Gains
from softdyn.controllers.id_clf_qp import IdClfQp
from softdyn.controllers.impedance import Impedance, UnderactuatedImpedance
from softdyn.controllers.impedance_qp import ImpedanceQp
from softdyn.controllers.mpc import Mpc, MpcParameters
from softdyn.controllers.registry import BEYOND, CONTROLLERS, find_controller
from softdyn.controllers.schedule import Schedule, Stage
from softdyn.controllers.soft_id_clf_qp import SoftIdClfQp
from softdyn.controllers.staged import Staged

__all__ = [
    "BEYOND",
    "CONTROLLERS",
    "ClfQp",
    "Command",
    "Controller",
    "Gains",
    "IdClfQp",
    "Impedance",
    "ImpedanceQp",
    "InputGuard",
    "Mpc",
    "MpcParameters",
    "Schedule",
    "SoftIdClfQp",
    "Stage",
    "Staged",
    "Status",
    "UnderactuatedImpedance",
    "find_controller",
]
