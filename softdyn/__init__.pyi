from . import commands, controllers, statics, validation
from ._version import __version__
from .description.library import bundled_names
from .description.robot import Robot
from .description.urdf import parse
from .dynamics.mimic import build
from .dynamics.model import SoftModel, State
from .exceptions import InputError, SoftdynError, UrdfError
from .loading import load
from .references import Ellipse, Reference, SetPoint

__all__ = [
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
    "load",
    "parse",
    "statics",
    "validation",
]
