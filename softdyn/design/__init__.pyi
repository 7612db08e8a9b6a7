from .arm_file import urdf
from .attachment import attach
from .cables import ArmSensor, Cable, CableMotor, Chamber
from .finger import Finger, FingerTendon
from .layout import FREEDOMS, Layout, lay_out
from .log_spiral import LogSpiral
from .quadrature import gauss_legendre, midpoint
from .rods import Arm, Damping, Material, Mount, Payload, Plate, Section
from .source import Design, design, make_arm, read
from .strains import strain_basis

__all__ = [
    "FREEDOMS", "Arm", "ArmSensor", "Cable", "CableMotor", "Chamber", "Damping", "Design", "Finger",
    "FingerTendon", "Layout", "LogSpiral", "Material", "Mount", "Payload", "Plate", "Section",
    "attach", "design", "gauss_legendre", "lay_out", "make_arm", "midpoint", "read",
    "strain_basis",
    "urdf",
]  # fmt: skip
