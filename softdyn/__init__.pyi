from . import commands, controllers, design, identification, statics, tasks, validation
from ._version import __version__
from .description.library import bundled_names
from .description.robot import Robot
from .description.urdf import parse
from .dynamics.mimic import build
from .dynamics.model import SoftModel, State
from .dynamics.reduced import Basis, reduce
from .exceptions import InputError, SoftdynError, UrdfError
from .loading import load
from .references import Ellipse, Reference, SetPoint
from .statics.diagnosis import diagnose
from .view.show import show

__all__ = [
    "Basis",
    "Ellipse",
    "InputError",
    "Reference",
    "Robot",
    "SetPoint",
    "SoftModel",
    "SoftdynError",
    "State",
    "UrdfError",
    "__version__",
    "build",
    "bundled_names",
    "commands",
    "controllers",
    "design",
    "diagnose",
    "identification",
    "load",
    "parse",
    "reduce",
    "show",
    "statics",
    "tasks",
    "validation",
]
