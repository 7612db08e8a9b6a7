"""Controllers: each a class C(model, gains=None) that maps (State, Reference) → Command."""

from controllers.clf_qp import ClfQp
from controllers.controller import Command, Controller, InputGuard, Status
from controllers.gains import Gains
from controllers.id_clf_qp import IdClfQp, SoftIdClfQp
from controllers.impedance import Impedance, UnderactuatedImpedance
from controllers.impedance_qp import ImpedanceQp
from controllers.mpc import Mpc, Tuning
from controllers.registry import BEYOND, CONTROLLERS, find_controller
from controllers.schedule import Schedule, Stage
from controllers.staged import Staged

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
    "Schedule",
    "SoftIdClfQp",
    "Stage",
    "Staged",
    "Status",
    "Tuning",
    "UnderactuatedImpedance",
    "find_controller",
]
