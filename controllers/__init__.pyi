from .allocation import allocate
from .barriers import ControlBarrier, JointLimits, LoadedStop, UnsafeStart
from .channels import LogChannel
from .clf_qp import ClfQp
from .controller import Command, Controller, InputGuard, Status, TaskCondition, TaskReport
from .failed_problem import FailedProblem
from .gains import Gains
from .id_clf_qp import IdClfQp
from .impedance import Impedance, UnderactuatedImpedance
from .impedance_qp import ImpedanceQp
from .mpc import Mpc, MpcParameters
from .policy import PolicyController, PolicyNetwork
from .predictive.compensated import Compensated
from .predictive.rest_target import RestTargets
from .registry import BEYOND, CONTROLLERS, find_controller, make_controller
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
    "ControlBarrier",
    "Controller",
    "FailedProblem",
    "Gains",
    "IdClfQp",
    "Impedance",
    "ImpedanceQp",
    "InputGuard",
    "JointLimits",
    "LoadedStop",
    "LogChannel",
    "Mpc",
    "MpcParameters",
    "PolicyController",
    "PolicyNetwork",
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
    "UnsafeStart",
    "allocate",
    "best",
    "find_controller",
    "make_controller",
]
