"""Poses, and spatial inertias of rigid bodies: change of frame, sum, whether one is physical."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softdyn.checks import read_only

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)

# Files hold rounded decimals. A flat plate (a + b = c) or a point mass must still pass, so the
# test has a slack relative to the largest moment, plus the moment of the mass at a micrometre.
SLACK = 1e-6
MICROMETRE = 1e-6
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""A tensor's upper triangle, row by row, as URDF names it."""
ORDERS = (("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), ("ixx", "ixy", "iyy", "ixz", "iyz", "izz"))
"""MuJoCo's order of `fullinertia`, and the lower triangle, row by row."""


@dataclass(frozen=True)
class Origin:
    """The pose of a frame in another one: `xyz` (m), and `rpy`, its roll, pitch and yaw (rad)."""

    xyz: Vector = ZERO
    rpy: Vector = ZERO

    @cached_property
    def translation(self) -> np.ndarray:
        """(3,)."""
        return read_only(self.xyz)

    @cached_property
    def rotation(self) -> np.ndarray:
        """(3, 3)."""
        return read_only(rotation_rpy(self.rpy))


IDENTITY = Origin()


@dataclass(frozen=True)
class Inertia:
    """Mass (kg), centre of mass (m) and rotational inertia about it (kg·m²), in one frame."""

    mass: float
    com: np.ndarray
    tensor: np.ndarray

    @staticmethod
    def zero() -> Inertia:
        """No body."""
        return Inertia(0.0, np.zeros(3), np.zeros((3, 3)))

    @staticmethod
    def cylinder(mass: float, radius: float, length: float, x: float = 0.0) -> Inertia:
        """A solid cylinder along the axis x, centred at `x` (m)."""
        axial, across = mass * radius * radius / 2, mass * (3 * radius * radius + length * length)
        return Inertia(mass, np.array([x, 0.0, 0.0]), np.diag([axial, across / 12, across / 12]))

    @property
    def moments(self) -> tuple[float, ...]:
        """`MOMENTS` of the tensor."""
        return tuple(self.tensor[np.triu_indices(3)].tolist())

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> Inertia:
        """The same body in another frame; this frame has the pose (rotation, translation) in it."""
        return Inertia(
            self.mass, rotation @ self.com + translation, rotation @ self.tensor @ rotation.T
        )

    def __add__(self, other: Inertia) -> Inertia:
        """Both bodies welded together (parallel-axis theorem)."""
        mass = self.mass + other.mass
        if mass == 0.0:
            return Inertia(0.0, np.zeros(3), self.tensor + other.tensor)
        com = (self.mass * self.com + other.mass * other.com) / mass
        tensor = self.tensor + other.tensor
        for body in (self, other):
            d = body.com - com
            tensor = tensor + body.mass * (d @ d * np.eye(3) - np.outer(d, d))
        return Inertia(mass, com, tensor)

    def defect(self) -> str | None:
        """Say why no rigid body can have this inertia; None if one can.

        A real mass distribution has principal moments a ≤ b ≤ c with a ≥ 0 and a + b ≥ c.
        """
        if self.mass < 0:
            return f"mass {self.mass:g} kg"
        a, b, c = np.linalg.eigvalsh(self.tensor)
        slack = SLACK * max(abs(a), abs(c)) + MICROMETRE**2 * self.mass
        moments = f"principal moments {a:.6g}, {b:.6g}, {c:.6g} kg m^2"
        if a < -slack:
            return f"{moments}: not positive"
        if a + b < c - slack:
            return f"{moments}: {a:.6g} + {b:.6g} < {c:.6g}"
        if self.mass == 0.0 and slack > 0.0:
            return f"{moments} without mass"
        return None

    def nearest_physical(self) -> Inertia:
        """The physical inertia nearest in the Frobenius norm, mass and centre unchanged.

        The conditions on a tensor are conditions on its eigenvalues, so the nearest one has the
        same principal axes and the nearest principal moments. Without mass all moments are zero.
        """
        moments, axes = np.linalg.eigh(self.tensor)
        nearest = _project(moments) if self.mass > 0 else np.zeros(3)
        return Inertia(self.mass, self.com, (axes * nearest) @ axes.T)


def written_in_another_order(numbers: Sequence[float]) -> str:
    """Words for six numbers that are a possible inertia in another order; empty if none.

    Parameters
    ----------
    numbers : sequence of float, (6,)
        Numbers in the order of `MOMENTS`, which are no possible inertia.
    """
    for order in ORDERS:
        moments = [numbers[order.index(name)] for name in MOMENTS]
        least, most = np.linalg.eigvalsh(symmetric(moments))[[0, -1]]
        if least > SLACK * most and not Inertia(1.0, np.zeros(3), symmetric(moments)).defect():
            words = ", ".join(name.removeprefix("i") for name in order)
            return f"the order {words}? "
    xx, xy, xz, yx, yy, yz = numbers
    if xy == yx and min(xx, yy) > max(map(abs, (xy, xz, yz))):
        return "the first six numbers of a matrix, row by row? "
    return ""


def _project(moments: np.ndarray) -> np.ndarray:
    """Nearest (3,) with every moment at most the sum of the others; then none is negative.

    These moments form a cone. Its 8 faces are intersections of the planes a + b = c, a + c = b and
    b + c = a. The function projects on each face and takes the nearest point inside the cone.
    """
    planes = 1.0 - 2.0 * np.eye(3)
    best, distance = np.zeros(3), float(np.linalg.norm(moments))
    for face in range(7):  # the eighth is the apex, zero
        active = planes[[bool(face >> k & 1) for k in range(3)]]
        point = moments - np.linalg.pinv(active) @ (active @ moments)
        gap = float(np.linalg.norm(point - moments))
        inside = (planes @ point >= -1e-12 * np.abs(moments).max()).all()
        if inside and gap < distance:
            best, distance = point, gap
    return best


def rotation_rpy(rpy: Sequence[float] | np.ndarray) -> np.ndarray:
    """Rotation matrix of URDF's roll, pitch, yaw (rad): Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def symmetric(moments: Sequence[float]) -> np.ndarray:
    """The tensor (3, 3) of six `MOMENTS`."""
    xx, xy, xz, yy, yz, zz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
