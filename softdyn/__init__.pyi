from . import (
    actuation,
    commands,
    controllers,
    design,
    dynamics,
    estimation,
    identification,
    safety,
    sensing,
    statics,
    tasks,
    testing,
    validation,
)
from ._version import __version__
from .description.library import bundled_names
from .description.robot import Robot
from .description.urdf import parse
from .dynamics.mimic import build
from .dynamics.model import SoftModel, State
from .dynamics.reduced import Basis, reduce
from .exceptions import (
    ForceError,
    FormatError,
    InputError,
    NotIdentifiable,
    OutOfReach,
    SoftdynError,
    UrdfError,
)
from .loading import load
from .references import Ellipse, Reference, SetPoint
from .statics.diagnosis import diagnose
from .view.show import show

__all__ = [
    "Basis",
    "Ellipse",
    "ForceError",
    "FormatError",
    "InputError",
    "NotIdentifiable",
    "OutOfReach",
    "Reference",
    "Robot",
    "SetPoint",
    "SoftModel",
    "SoftdynError",
    "State",
    "UrdfError",
    "__version__",
    "actuation",
    "build",
    "bundled_names",
    "commands",
    "controllers",
    "design",
    "diagnose",
    "dynamics",
    "estimation",
    "identification",
    "load",
    "parse",
    "reduce",
    "safety",
    "sensing",
    "show",
    "statics",
    "tasks",
    "testing",
    "validation",
]
