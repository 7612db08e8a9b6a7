from .balance import Disturbance, ForceBalance
from .derivatives import acceleration_derivatives, gravity_stiffness, stiffness, tangent_dynamics
from .discretisation import DiscreteStep, StepError, discrete_step
from .fluid import Fluid
from .forces import Force
from .implicit_step import ImplicitStep
from .integrators import step_implicit, step_rk4
from .stops import Stops
from .winches import Winches
from .wrench import Wrench

__all__ = [
    "DiscreteStep",
    "Disturbance",
    "Fluid",
    "Force",
    "ForceBalance",
    "ImplicitStep",
    "StepError",
    "Stops",
    "Winches",
    "Wrench",
    "acceleration_derivatives",
    "discrete_step",
    "gravity_stiffness",
    "step_implicit",
    "step_rk4",
    "stiffness",
    "tangent_dynamics",
]
