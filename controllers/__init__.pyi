from .allocation import allocate
from .clf_qp import ClfQp
from .controller import Command, Controller, InputGuard, Status, TaskCondition, TaskReport
from .gains import Gains
from .id_clf_qp import IdClfQp
from .impedance import Impedance, UnderactuatedImpedance
from .impedance_qp import ImpedanceQp
from .mpc import Mpc, MpcParameters
from .predictive.compensated import Compensated
from .predictive.rest_target import RestTargets
from .registry import BEYOND, CONTROLLERS, find_controller
from .safety_filter import SafetyFilter
from .schedule import Schedule, Stage
from .soft_id_clf_qp import SoftIdClfQp
from .staged import Staged, best

__all__ = [
    "BEYOND",
    "CONTROLLERS",
    "ClfQp",
    "Command",
    "Compensated",
    "Controller",
    "Gains",
    "IdClfQp",
    "Impedance",
    "ImpedanceQp",
    "InputGuard",
    "Mpc",
    "MpcParameters",
    "RestTargets",
    "SafetyFilter",
    "Schedule",
    "SoftIdClfQp",
    "Stage",
    "Staged",
    "Status",
    "TaskCondition",
    "TaskReport",
    "UnderactuatedImpedance",
    "allocate",
    "best",
    "find_controller",
]
