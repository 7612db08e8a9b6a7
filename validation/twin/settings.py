"""MuJoCo's settings: solver, stiffness of stops and of mimic joints, disable flags.

Every setting that decides a result is set here and not left to MuJoCo's defaults.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from softdyn.checks import number
from softdyn.description.robot import EARTH, NO_FLUID, Fluid, Vector
from softdyn.validation.twin.integrators import Integrator

# MuJoCo's default stops are so soft that a hanging arm sinks centimetres through them, and its
# default dry friction creeps.
STIFF_SOLREF = (0.002, 1.0)
STIFF_SOLIMP = (0.99, 0.999, 1e-4, 0.5, 2.0)


@dataclass(frozen=True)
class Settings:
    """The settings of a twin that a user can choose; `apply` sets these and all others.

    Attributes
    ----------
    timestep : float
        Integration step (s).
    integrator : Integrator
        The scheme.
    limits, contacts, friction : bool
        Whether joint limits act, links touch, and joints have their dry friction.
    gravity : tuple of float, (3,)
        Acceleration of gravity (m/s²).
    fluid : Fluid
        The fluid around the robot.

    Raises
    ------
    InputError
        For a step that is not positive.
    """

    timestep: float
    integrator: Integrator
    limits: bool
    contacts: bool
    friction: bool
    gravity: Vector = EARTH
    fluid: Fluid = NO_FLUID

    def __post_init__(self) -> None:
        number("timestep", self.timestep, above=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        """Set MuJoCo's options, and set the compiler so that it changes no number of the file."""
        compiler, option = spec.compiler, spec.option
        compiler.degree = False
        compiler.autolimits = False
        compiler.boundmass = compiler.boundinertia = 0.0
        compiler.balanceinertia = compiler.fusestatic = compiler.discardvisual = False
        compiler.alignfree = False
        compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        option.gravity = self.gravity
        option.density, option.viscosity = self.fluid.density, self.fluid.viscosity
        option.wind = (0.0, 0.0, 0.0)
        option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.iterations, option.tolerance = 100, 1e-12
        option.ls_iterations, option.ls_tolerance = 50, 1e-3
        option.enableflags = int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        option.timestep = self.timestep
        option.integrator = self.integrator.mujoco
        option.disableflags = disabled(
            limits=self.limits, contacts=self.contacts, friction=self.friction
        )


def disabled(*, limits: bool, contacts: bool, friction: bool) -> int:
    """MuJoCo's disable flags; it never resets a state by itself."""
    flags = mujoco.mjtDisableBit
    acting = {
        flags.mjDSBL_AUTORESET: False,
        flags.mjDSBL_LIMIT: limits,
        flags.mjDSBL_CONTACT: contacts,
        flags.mjDSBL_FRICTIONLOSS: friction,
    }
    return sum(int(flag) for flag, acts in acting.items() if not acts)


def silence() -> None:
    """Stop MuJoCo from printing and from writing MUJOCO_LOG.TXT into the working directory.

    This holds for the whole process, because MuJoCo has one log per process. Messages about a state
    are counted in ``data.warning`` too, see `check_warnings`. The other messages, for example of a
    line search on a flat cost, do not concern the result.
    """
    log = mujoco.MjLogConfig.get()
    log.logto_console = log.logto_file = False
    log.set()
