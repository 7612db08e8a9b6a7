"""The generator that tests share; it lives in validation/, where a command needs it too."""

from softdyn.validation.crosschecks.random_robots import random_urdf, write_robot

__all__ = ["random_urdf", "write_robot"]
