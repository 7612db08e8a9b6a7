"""MuJoCo's integrators by their names."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from softdyn.exceptions import InputError

if TYPE_CHECKING:
    import mujoco


class Integrator(StrEnum):
    """MuJoCo's schemes: three of first order, and Runge-Kutta of fourth order."""

    IMPLICITFAST = "implicitfast"
    IMPLICIT = "implicit"
    EULER = "euler"
    RK4 = "rk4"

    @property
    def mujoco(self) -> mujoco.mjtIntegrator:
        """MuJoCo's own value."""
        import mujoco  # the commands' parsers list the schemes without it

        return getattr(mujoco.mjtIntegrator, f"mjINT_{self.name}")


def integrator_of(value: Integrator | str) -> Integrator:
    """The scheme that an argument means.

    Raises
    ------
    InputError
        For an unknown one.
    """
    try:
        return Integrator(value)
    except ValueError:
        raise InputError("integrator", " or ".join(Integrator), repr(value)) from None
