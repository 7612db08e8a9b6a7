from .controllers import check_controller
from .forces import check_force
from .functions import check_barrier, check_reference, check_task
from .kinds import KINDS, check, kind_of
from .observers import check_observer
from .report import Conformance, RuleResult
from .rigs import check_driver, check_plant

__all__ = [
    "KINDS",
    "Conformance",
    "RuleResult",
    "check",
    "check_barrier",
    "check_controller",
    "check_driver",
    "check_force",
    "check_observer",
    "check_plant",
    "check_reference",
    "check_task",
    "kind_of",
]
