"""Annotated URDF as text: numbers, elements, and a serial robot that grows link by link."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

Vector = Sequence[float]
ORIGIN = (0.0, 0.0, 0.0)
X_TO_Z = (0.0, math.pi / 2, 0.0)
"""Turns a cylinder, which lies along z, to x."""


def num(x: float) -> str:
    """Return the shortest text that reads back as ``x``; CAD noise below 1e-12 is written as 0."""
    if isinstance(x, int) or abs(x) < 1e-12:
        return str(round(x))
    return repr(float(x)).removesuffix(".0")


def vec(values: Vector) -> str:
    """Return numbers separated by blanks."""
    return " ".join(num(v) for v in values)


def rpy(quat: Vector) -> list[float]:
    """Return roll, pitch, yaw [rad] of a quaternion (w, x, y, z) that turns about one axis.

    Some turn by 90 degrees of pitch, where a general conversion would lose half of the digits.

    Raises
    ------
    ValueError
        For a quaternion that turns about another axis.
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
    # written out: the committed files hold its last digits, which SciPy's Rotation rounds otherwise
    norm = math.sqrt(sum(c * c for c in quat))
    w, x, y, z = (c / norm for c in quat)
    r = (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
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


def sphere(radius: float) -> str:
    """Return a sphere [m]."""
    return f'<sphere radius="{num(radius)}"/>'


def cylinder(radius: float, length: float) -> str:
    """Return a cylinder about local z [m]."""
    return f'<cylinder radius="{num(radius)}" length="{num(length)}"/>'


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


@dataclass(frozen=True)
class Joint:
    """One compliant degree of freedom.

    Attributes
    ----------
    name : str
        Of the joint.
    axis : sequence of float, (3,)
        Unit vector in the child's frame.
    stiffness : float
        N m/rad, or N/m of a prismatic joint.
    damping : float
        N m s/rad, or N s/m.
    kind : str
        ``revolute`` or ``prismatic``.
    limits : sequence of float, (2,)
        Lower and upper, rad or m.
    armature : float
        Added to the diagonal of the mass matrix, kg m^2 or kg.
    rest : float
        Where the spring rests, rad or m.
    """

    name: str
    axis: Vector
    stiffness: float
    damping: float
    kind: str = "revolute"
    limits: Vector = (-math.pi, math.pi)
    armature: float = 0.0
    rest: float = 0.0


@dataclass(frozen=True)
class Input:
    """A bounded input on a tendon: force per unit, and lower and upper bound."""

    gear: float
    bounds: Vector


@dataclass
class Robot:
    """URDF text in the making; lines are kept in the order of the calls.

    It begins with the links ``world`` and, welded to it, ``base`` with these `parts`. Every further
    link is joined to the last one. A color is red, green, blue and, where it is given, opacity.
    """

    name: str
    comment: str
    colors: Mapping[str, Vector]
    parts: Sequence[str]
    last: str = "world"
    lines: list[str] = field(default_factory=list)
    annotations: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._link("world")
        self.add("base", self.parts)

    def add(
        self,
        name: str,
        parts: Sequence[str] = (),
        joints: Sequence[Joint] = (),
        xyz: Vector = ORIGIN,
        angles: Vector = ORIGIN,
    ) -> None:
        """Add a link at a pose in the last one, on one-DOF joints in series, or welded to it.

        Between joints there are massless links.
        """
        self._link(name, *parts)
        where, parent = origin(xyz, angles), self.last
        if not joints:
            tree = f'<parent link="{parent}"/><child link="{name}"/>'
            self.lines.append(f'  <joint name="{name}_joint" type="fixed">{where}{tree}</joint>')
        for joint in joints:
            target = name if joint is joints[-1] else f"{name}_{joint.name}"
            if target != name:
                self._link(target)
            lower, upper = joint.limits
            self.lines += [
                f'  <joint name="{joint.name}" type="{joint.kind}">',
                f'    {where}<parent link="{parent}"/><child link="{target}"/>',
                f'    <axis xyz="{vec(joint.axis)}"/><dynamics damping="{num(joint.damping)}"/>',
                f'    <limit lower="{num(lower)}" upper="{num(upper)}"'
                ' effort="100" velocity="100"/>',
                "  </joint>",
                f'  <gazebo reference="{joint.name}"><springStiffness>{num(joint.stiffness)}'
                f"</springStiffness><springReference>{num(joint.rest)}</springReference></gazebo>",
            ]
            if joint.armature:
                self.annotations.append(
                    f'<joint name="{joint.name}" armature="{num(joint.armature)}"/>'
                )
            where, parent = "", target
        self.last = name

    def finish(
        self, xyz: Vector, angles: Vector, tendons: Mapping[str, Iterable[str]], *inputs: Input
    ) -> str:
        """Add the tip and the inputs, one a tendon, and return the whole file.

        Parameters
        ----------
        xyz, angles : sequence of float, (3,)
            Pose of the tip in the last link.
        tendons : mapping of str to str
            Their joints (`over`) or sites (`site`).
        inputs : Input
            In the tendons' order.
        """
        self.add("tip", (), (), xyz, angles)
        for name, parts in tendons.items():
            self.annotations += [f'<tendon name="{name}">', *(f"  {p}" for p in parts), "</tendon>"]
        for i, (tendon, given) in enumerate(zip(tendons, inputs, strict=True), 1):
            low, high = map(num, given.bounds)
            self.annotations.append(
                f'<actuator name="u{i}" tendon="{tendon}" gear="{num(given.gear)}"'
                f' lower="{low}" upper="{high}"/>'
            )
        materials = [
            f'  <material name="{name}"><color rgba="{vec((*color, 1.0)[:4])}"/></material>'
            for name, color in self.colors.items()
        ]
        return "\n".join(
            [
                '<?xml version="1.0" encoding="utf-8"?>',
                f"<!--{self.comment}-->",
                f"<robot name={quoteattr(self.name)}>",
                *materials,
                *self.lines,
                '  <softdyn version="1">',
                *(f"    {line}" for line in (*self.annotations, '<task frame="tip"/>')),
                "  </softdyn>",
                "</robot>",
                "",
            ]
        )

    def _link(self, name: str, *parts: str) -> None:
        """A link; without parts it is massless and invisible."""
        if parts:
            self.lines += [f'  <link name="{name}">', *(f"    {p}" for p in parts), "  </link>"]
        else:
            self.lines.append(f'  <link name="{name}"/>')


def over(joint: str, coef: float = 1.0) -> str:
    """Return one joint of a fixed tendon."""
    return f'<joint name="{joint}" coef="{num(coef)}"/>'


def site(link: str, xyz: Vector) -> str:
    """Return one point [m] of a spatial tendon, in the link's frame."""
    return f'<site link="{link}" xyz="{vec(xyz)}"/>'
