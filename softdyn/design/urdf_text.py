"""Annotated URDF as text: numbers, elements, and a robot that grows link by link."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.sax.saxutils import quoteattr

Vector = Sequence[float]
ORIGIN = (0.0, 0.0, 0.0)
CREDIT = """
  Source of the numbers: the paper's reference implementation, CyPhiLab/tendon_clf (MIT license),
  of Pham & Patterson, "Control Lyapunov Functions for Underactuated Soft Robots", collected in
  source/reference_models.json.
"""


def num(x: float) -> str:
    """Return the shortest text that reads back as ``x``; CAD noise below 1e-12 is written as 0."""
    if isinstance(x, int) or abs(x) < 1e-12:
        return str(round(x))
    return repr(float(x)).removesuffix(".0")


def vec(values: Vector) -> str:
    """Return numbers separated by blanks."""
    return " ".join(num(v) for v in values)


def rotation(quat: Vector) -> list[list[float]]:
    """Return the 3x3 rotation matrix of a quaternion (w, x, y, z) of any length."""
    norm = math.sqrt(sum(c * c for c in quat))
    w, x, y, z = (c / norm for c in quat)
    return [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]


def rpy(quat: Vector) -> list[float]:
    """Return roll, pitch, yaw [rad] of a quaternion (w, x, y, z) that turns about one axis.

    Every body of the reference turns about a single axis, some by 90 degrees of pitch, where a
    general conversion would lose half of the digits.
    """
    w, *axis = quat
    turning = [i for i, c in enumerate(axis) if abs(c) > 1e-12]
    if len(turning) > 1:
        raise ValueError(f"expected a rotation about one coordinate axis, got quaternion {quat}")
    return [2 * math.atan2(c, w) if i in turning else 0.0 for i, c in enumerate(axis)]


def tensor(principal: Vector, quat: Vector) -> list[list[float]]:
    """Return the inertia tensor R diag(principal) R^T [kg m^2], exactly symmetric.

    Entries below 1e-12 of the largest moment are rounding of the quaternion, and become 0.
    """
    r = rotation(quat)
    noise = 1e-12 * max(principal)
    full = [[0.0] * 3 for _ in range(3)]
    for i in range(3):
        for j in range(i, 3):
            entry = sum(r[i][k] * principal[k] * r[j][k] for k in range(3))
            # 15 digits: 3e-06 stays 3e-06 whatever the last bit of the quaternion's norm is
            full[i][j] = full[j][i] = float(f"{entry:.15g}") if abs(entry) > noise else 0.0
    return full


# --- URDF text ----------------------------------------------------------------------------------


def origin(xyz: Vector = ORIGIN, angles: Vector = ORIGIN) -> str:
    """Return an ``<origin>``; it is empty for the identity."""
    if not any((*xyz, *angles)):
        return ""
    turn = f' rpy="{vec(angles)}"' if any(angles) else ""
    return f'<origin xyz="{vec(xyz)}"{turn}/>'


def box(x: float, y: float, z: float) -> str:
    """Return a box with edge lengths [m]."""
    return f'<box size="{vec((x, y, z))}"/>'


def cylinder(radius: float, length: float) -> str:
    """Return a cylinder about local z [m]."""
    return f'<cylinder radius="{num(radius)}" length="{num(length)}"/>'


def sphere(radius: float) -> str:
    """Return a sphere [m]."""
    return f'<sphere radius="{num(radius)}"/>'


def mesh(name: str, scale: Vector) -> str:
    """Return a mesh of ``urdf/meshes``, stretched along its local axes."""
    return f'<mesh filename="meshes/{name}.stl" scale="{vec(scale)}"/>'


def visual(shape: str, material: str, xyz: Vector = ORIGIN, angles: Vector = ORIGIN) -> str:
    """Return a ``<visual>`` with a named material."""
    where = origin(xyz, angles)
    return f'<visual>{where}<geometry>{shape}</geometry><material name="{material}"/></visual>'


def collision(shape: str, xyz: Vector = ORIGIN, angles: Vector = ORIGIN) -> str:
    """Return a ``<collision>``; shapes are primitives, used only with link contacts on."""
    return f"<collision>{origin(xyz, angles)}<geometry>{shape}</geometry></collision>"


def inertial(mass: float, com: Vector, inertia: Sequence[Vector]) -> str:
    """Return an ``<inertial>``: mass [kg], centre of mass [m], tensor there [kg m^2]."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    entries = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), (xx, xy, xz, yy, yz, zz), strict=True)
    # not num(): the moments of the smallest segments are themselves near 1e-9
    text = " ".join(f'{name}="{value!r}"' for name, value in entries)
    return f'<inertial>{origin(com)}<mass value="{num(mass)}"/><inertia {text}/></inertial>'


def body_inertial(body: dict[str, Any]) -> str:
    """Return the ``<inertial>`` of a body of the facts."""
    principal, quat = body["inertia_principal"], body["inertia_quat_wxyz"]
    return inertial(body["mass"], body["com"], tensor(principal, quat))


@dataclass(frozen=True)
class Joint:
    """One compliant degree of freedom.

    Parameters
    ----------
    name : joint name
    axis : unit vector in the child's frame
    stiffness : [N m/rad], or [N/m] of a prismatic joint
    damping : [N m s/rad], or [N s/m]
    kind : ``revolute`` or ``prismatic``
    limits : lower and upper [rad] or [m]; a joint of the reference without a range gets +-pi
    armature : added to the diagonal of the mass matrix [kg m^2] or [kg]
    """

    name: str
    axis: Vector
    stiffness: float
    damping: float
    kind: str = "revolute"
    limits: Vector = (-math.pi, math.pi)
    armature: float = 0.0


@dataclass
class Robot:
    """URDF text in the making; lines are kept in the order of the calls."""

    name: str
    comment: str
    colors: Mapping[str, Vector]
    lines: list[str] = field(default_factory=list)
    annotations: list[str] = field(default_factory=list)

    def link(self, name: str, *parts: str) -> None:
        """Add a link; without parts it is massless and invisible."""
        if not parts:
            self.lines.append(f'  <link name="{name}"/>')
            return
        self.lines += [f'  <link name="{name}">', *(f"    {p}" for p in parts), "  </link>"]

    def fixed(self, parent: str, child: str, xyz: Vector = ORIGIN, angles: Vector = ORIGIN) -> None:
        """Weld ``child`` to ``parent``."""
        tree = f'<parent link="{parent}"/><child link="{child}"/>'
        self.lines.append(
            f'  <joint name="{child}_joint" type="fixed">{origin(xyz, angles)}{tree}</joint>'
        )

    def chain(
        self, parent: str, child: str, joints: Sequence[Joint], xyz: Vector, angles: Vector
    ) -> None:
        """Connect two links by one-DOF joints in series, over massless links in between."""
        for i, joint in enumerate(joints):
            last = i == len(joints) - 1
            target = child if last else f"{child}_{joint.name}"
            if not last:
                self.link(target)
            lower, upper = joint.limits
            where = origin(xyz, angles) if i == 0 else ""
            self.lines += [
                f'  <joint name="{joint.name}" type="{joint.kind}">',
                f'    {where}<parent link="{parent}"/><child link="{target}"/>',
                f'    <axis xyz="{vec(joint.axis)}"/><dynamics damping="{num(joint.damping)}"/>',
                f'    <limit lower="{num(lower)}" upper="{num(upper)}"'
                ' effort="100" velocity="100"/>',
                "  </joint>",
                f'  <gazebo reference="{joint.name}"><springStiffness>{num(joint.stiffness)}'
                "</springStiffness><springReference>0</springReference></gazebo>",
            ]
            if joint.armature:
                self.annotations.append(
                    f'<joint name="{joint.name}" armature="{num(joint.armature)}"/>'
                )
            parent = target

    def tendon(self, name: str, parts: Iterable[str]) -> None:
        """Add a tendon over joints (:func:`over`) or sites (:func:`site`)."""
        self.annotations += [f'<tendon name="{name}">', *(f"  {p}" for p in parts), "</tendon>"]

    def actuator(self, name: str, tendon: str, gear: float, bounds: Vector) -> None:
        """Add one bounded input on a tendon."""
        low, high = map(num, bounds)
        self.annotations.append(
            f'<actuator name="{name}" tendon="{tendon}" gear="{num(gear)}"'
            f' lower="{low}" upper="{high}"/>'
        )

    def text(self) -> str:
        """Return the whole file."""
        materials = [
            f'  <material name="{name}"><color rgba="{vec((*color, 1.0))}"/></material>'
            for name, color in self.colors.items()
        ]
        head = ['<?xml version="1.0" encoding="utf-8"?>', f"<!--{self.comment}-->"]
        block = [*self.annotations, '<task frame="tip"/>']
        return "\n".join(
            [
                *head,
                f"<robot name={quoteattr(self.name)}>",
                *materials,
                *self.lines,
                '  <softdyn version="1">',
                *(f"    {line}" for line in block),
                "  </softdyn>",
                "</robot>",
                "",
            ]
        )


def over(joint: str, coef: float = 1.0) -> str:
    """Return one joint of a fixed tendon."""
    return f'<joint name="{joint}" coef="{num(coef)}"/>'


def site(link: str, xyz: Vector) -> str:
    """Return one point [m] of a spatial tendon, in the link's frame."""
    return f'<site link="{link}" xyz="{vec(xyz)}"/>'


def begin(name: str, comment: str, colors: Mapping[str, Vector], *base: str) -> Robot:
    """Start a robot: root link ``world``, and ``base`` welded to it at the origin."""
    generated = "  Generated by scripts/make_robots.py: change that, not this file.\n"
    robot = Robot(name, f"\n{comment.strip(chr(10))}\n{CREDIT}{generated}", colors)
    robot.link("world")
    robot.link("base", *base)
    robot.fixed("world", "base")
    return robot
