#!/usr/bin/env python3
"""Write the four bundled robots below ``urdf/``: annotated URDF files and their meshes.

``finger helix spirob spirob48`` are pure functions that return URDF text; the numbers come from
``urdf/source/reference_models.json``. Run without arguments to write every file, or with
``--check`` to compare what is committed with what would be written.

Units are SI and radians. Numbers are printed with ``repr``, so no digit is lost.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

URDF = Path(__file__).resolve().parents[1] / "urdf"
SOURCE = "source/reference_models.json"
Vector = Sequence[float]
ORIGIN = (0.0, 0.0, 0.0)
CREDIT = """
  Source of the numbers: the paper's reference implementation, CyPhiLab/tendon_clf (MIT license),
  of Pham & Patterson, "Control Lyapunov Functions for Underactuated Soft Robots", collected in
  source/reference_models.json.
"""


# --- numbers ------------------------------------------------------------------------------------


def facts(robot: str) -> dict[str, Any]:
    """Return the collected numbers of one reference robot."""
    collected: dict[str, dict[str, Any]] = json.loads((URDF / SOURCE).read_text())
    return collected[robot]


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


# --- finger -------------------------------------------------------------------------------------

X_TO_Z = (0.0, math.pi / 2, 0.0)
"""Turns a cylinder, which lies along z, to x."""
Y_TO_Z = (math.pi / 2, 0.0, 0.0)
"""Turns a cylinder to y."""


def finger() -> str:
    """Return the tendon-driven finger: 4 hinges about y, 2 signed inputs, along +x."""
    data = facts("finger")
    *links, tip = data["bodies"]
    robot = begin(
        "finger",
        """
  finger: the tendon-driven finger, four rigid links in series, 4 DOF, 2 inputs. At rest it points
  along +x and the tip is at (0.24, 0, 0).
  The paper prints the number of links and tendon pairs, and the controllers' gains. Masses,
  inertias, offsets, joint ranges, stiffness, damping, gear and input bounds are the reference
  implementation's. There each pair is two antagonistic tendons; here it is one signed input.
""",
        {"dark": (0.18, 0.2, 0.24), "bone": (0.78, 0.75, 0.69), "pad": (0.9, 0.45, 0.3)},
        visual(cylinder(0.026, 0.01), "dark", (-0.021, 0.0, 0.0), X_TO_Z),
        visual(cylinder(0.0075, 0.016), "dark", (-0.008, 0.0, 0.0), X_TO_Z),
    )
    parent = "base"
    for i, body in enumerate(links, 1):
        length, r = 0.06, 0.0095 - 0.0007 * i
        # the last bone ends at the tip, the others just before the next knuckle
        bone = length if i == len(links) else length - 0.004
        robot.link(
            f"link{i}",
            body_inertial(body),
            visual(cylinder(r + 0.0012, 0.02), "dark", ORIGIN, Y_TO_Z),
            visual(mesh("phalanx", (bone, r, r)), "bone"),
            visual(
                mesh("phalanx", (0.62 * bone, 0.8 * r, 0.6 * r)),
                "pad",
                (0.2 * bone, 0.0, -0.62 * r),
            ),
            collision(cylinder(0.0075, 0.04), (length / 2, 0.0, 0.0), X_TO_Z),
        )
        (joint,) = body["joints"]
        # only the first offset is seen from the world, where the reference lifts its base
        lift = data["base_height"] if i == 1 else 0.0
        position = (body["pos"][0], body["pos"][1], body["pos"][2] - lift)
        hinge = Joint(
            joint["name"],
            joint["axis"],
            data["stiffness"],
            data["damping"],
            limits=joint["range"],
        )
        robot.chain(parent, f"link{i}", [hinge], position, rpy(body["quat_wxyz"]))
        parent = f"link{i}"
    robot.link("tip")
    robot.fixed(parent, "tip", tip["pos"], rpy(tip["quat_wxyz"]))
    for name, joints in (("tendon_a", ("joint1", "joint2")), ("tendon_b", ("joint3", "joint4"))):
        robot.tendon(name, map(over, joints))
    for i, (name, bounds) in enumerate(
        zip(("tendon_a", "tendon_b"), data["input_bounds"], strict=True), 1
    ):
        robot.actuator(f"u{i}", name, 0.1, bounds)
    return robot.text()


# --- helix --------------------------------------------------------------------------------------

HELIX_SEGMENTS = 12
HELIX_KINDS = ("bend", "lat", "comp")
HELIX_BOUNDS = {"bend": (-25, 25), "lat": (-25, 25), "comp": (0, 25)}
"""Bounds of one module's inputs: torques [N m] and the shortening force [N]."""


def helix_parts(i: int) -> list[str]:
    """Return the looks and the contact shape of helix segment ``i`` (1 to 12).

    Odd segments are one helicoid cell tall, even ones three cells between plates; the last one
    reaches to the tip in two cells. Contact shapes leave more than 15 mm between neighbours, the
    stroke by which a joint can be compressed.
    """
    plates: Vector = ()
    last = i == HELIX_SEGMENTS
    if last:
        length, cells, disc, plates = 0.04, 2, (0.037, 0.018), (0.04,)
    elif i % 2:
        length, cells, disc = 0.02, 1, (0.037, 0.009)
    else:
        length, cells, disc, plates = 0.0525, 3, (0.045, 0.032), (0.0, 0.0525)
    # segments extend towards -y of their frame, but the last frame is turned over
    side = 1.0 if last else -1.0
    lattice = mesh("helicoid", (0.042, length / cells, 0.042))
    bottoms = [(k if last else k - cells) * length / cells for k in range(cells)]
    return [
        *(visual(lattice, f"module_{(i + 3) // 4}", (0.0, y, 0.0)) for y in bottoms),
        *(visual(cylinder(0.046, 0.003), "plate", (0.0, side * y, 0.0), Y_TO_Z) for y in plates),
        collision(cylinder(*disc), (0.0, side * length / 2, 0.0), Y_TO_Z),
    ]


def helix() -> str:
    """Return the trimmed-helicoid arm: 3 modules of 4 three-DOF joints, 9 inputs, hanging down."""
    data = facts("helix")
    *bodies, tip = data["bodies"]
    robot = begin(
        "helix",
        """
  helix: the trimmed-helicoid continuum arm, 3 modules of 4 segments, 36 DOF (bend, lateral bend and
  compression per joint; a positive compression shortens the arm), 9 inputs. At rest it hangs down
  and the tip is 0.4425 m below the base.
  The paper prints the DOF, the modules and the inputs. Masses, inertias, offsets, the compression's
  range, stiffness, damping and input bounds are the reference implementation's. Two traits are kept
  as found there: the last segment's frame is turned over, so that its bend has the opposite sense
  and its centre of mass lies 10 mm above its joint, and every input acts with coefficient 1 on the
  four joints of its module.
""",
        {
            "plate": (0.2, 0.22, 0.26),
            "module_1": (0.8, 0.3, 0.2),
            "module_2": (0.85, 0.55, 0.2),
            "module_3": (0.6, 0.65, 0.7),
        },
        visual(cylinder(0.058, 0.012), "plate", (0.0, 0.0, 0.006)),
        visual(mesh("helicoid", (0.042, 0.02, 0.042)), "module_1", (0.0, 0.0, -0.02), Y_TO_Z),
    )
    stiffness = {
        "bend": data["stiffness"]["bending (revolute)"],
        "lat": data["stiffness"]["bending (revolute)"],
        "comp": data["stiffness"]["extension (prismatic)"],
    }
    parent = "base"
    for i, body in enumerate(bodies, 1):
        robot.link(f"segment_{i}", body_inertial(body), *helix_parts(i))
        joints = [
            Joint(
                f"{kind}{i}",
                joint["axis"],
                stiffness[kind],
                data["damping"],
                *(("prismatic", joint["range"]) if kind == "comp" else ()),
            )
            for kind, joint in zip(HELIX_KINDS, body["joints"], strict=True)
        ]
        lift = data["base_height"] if i == 1 else 0.0
        position = (body["pos"][0], body["pos"][1], round(body["pos"][2] - lift, 12))
        robot.chain(parent, f"segment_{i}", joints, position, rpy(body["quat_wxyz"]))
        parent = f"segment_{i}"
    robot.link("tip")
    robot.fixed(parent, "tip", tip["pos"], rpy(tip["quat_wxyz"]))
    inputs = [(module, kind) for module in range(3) for kind in HELIX_KINDS]
    for module, kind in inputs:
        members = [f"{kind}{4 * module + j}" for j in range(1, 5)]
        robot.tendon(f"module{module + 1}_{kind}", map(over, members))
    for i, (module, kind) in enumerate(inputs, 1):
        robot.actuator(f"u{i}", f"module{module + 1}_{kind}", 1.0, HELIX_BOUNDS[kind])
    return robot.text()


# --- the two log-spiral arms --------------------------------------------------------------------

CABLE_RADIUS = 0.0251
"""Distance of the cables from the backbone at the base [m], of the reference's first segment."""
SPIRAL_BLOCKS = 2
"""Blocks drawn per segment of the 27-DOF arm, whose segments are long."""
CABLE_GEAR = -10.0
CABLE_BOUNDS = (0, 100)
"""Tensions; with the negative gear a positive input pulls."""
SPIRAL_COLORS = {"mount": (0.2, 0.22, 0.26), "even": (0.08, 0.42, 0.48), "odd": (0.3, 0.64, 0.62)}


def cable_direction(degrees: float) -> tuple[float, float]:
    """Return the unit vector (y, z) from the backbone to a cable, in a segment's frame."""
    angle = math.radians(degrees)
    # 15 digits: -0.5 stays -0.5 whatever the C library's last bit is
    return round(-math.sin(angle), 15), round(math.cos(angle), 15)


def spiral_parts(
    length: float,
    radius: float,
    shade: str,
    angles: Vector = ORIGIN,
    blocks: int = 1,
    taper: float = 1.0,
) -> list[str]:
    """Return the looks and the contact shape of one log-spiral segment.

    Parameters
    ----------
    length : of the segment, along local x [m]
    radius : of the cables at the segment's base [m]
    shade : material name
    angles : roll, pitch, yaw from the segment's frame to one with the segment along +x and the
        first cable towards +z
    blocks : number of similar blocks drawn
    taper : radius of the next segment relative to this one
    """
    along = -1.0 if angles[2] else 1.0
    ratio = taper ** (1 / blocks)
    sizes = [ratio**k for k in range(blocks)]
    first = length / sum(sizes)
    starts = [along * first * sum(sizes[:k]) for k in range(blocks)]
    looks = [
        visual(mesh("spiral", (first * k, radius * k, radius * k)), shade, (x, 0.0, 0.0), angles)
        for k, x in zip(sizes, starts, strict=True)
    ]
    middle = (along * 0.58 * length, 0.0, 0.0)
    return [*looks, collision(cylinder(0.96 * radius, 0.6 * length), middle, X_TO_Z)]


def spirob() -> str:
    """Return the log-spiral arm of the paper: 27 DOF, 3 cables, hanging down."""
    data = facts("spirob")
    count, ratio = data["segments"], data["segment_length_ratio"]
    powers = [1.0]  # products, because ** may round differently elsewhere
    while len(powers) < count:
        powers.append(powers[-1] * ratio)
    first = data["length_m"] / sum(powers)
    heaviest = data["total_mass_kg"] / sum(p * p * p for p in powers)
    robot = begin(
        "spirob",
        """
  spirob: the logarithmic-spiral arm of the paper, 10 self-similar segments, 9 compliant joints of
  bend, bend and twist, 27 DOF, 3 cables. At rest it hangs down and the tip is 0.5 m below the base.
  The paper prints 27 DOF, 3 cables and a length of 0.50 m and nothing else of this arm; the
  reference implementation's has 24 universal joints (spirob48.urdf). Here that arm's law is scaled
  to 9 joints: its length ratio, to the power 2.5, its total mass, cable radius, sites, stiffness,
  damping, armature, gear and bounds; masses go with the cube of the length ratio, inertias are
  those of solid cylinders with the cables' radius at the segment's base.
""",
        SPIRAL_COLORS,
        visual(cylinder(0.04, 0.012), "mount", (0.0, 0.0, 0.006)),
    )
    fractions = data["site_fractions_along_segment"]
    cables: list[list[str]] = [[] for _ in data["cable_angles_deg"]]
    y, z = cable_direction(data["cable_angles_deg"][0])
    roll = math.atan2(-y, z)
    parent, offset = "base", ORIGIN
    for i, power in enumerate(powers):
        name = f"segment_{i}"
        length, radius, mass = first * power, CABLE_RADIUS * power, heaviest * power * power * power
        across = mass * (3 * radius * radius + length * length) / 12
        moments = (mass * radius * radius / 2, across, across)
        solid = [[m if i == j else 0.0 for j in range(3)] for i, m in enumerate(moments)]
        robot.link(
            name,
            inertial(mass, (length / 2, 0.0, 0.0), solid),
            *spiral_parts(
                length, radius, "odd" if i % 2 else "even", (roll, 0.0, 0.0), SPIRAL_BLOCKS, ratio
            ),
        )
        if i == 0:
            robot.fixed(parent, name, offset, (0.0, math.pi / 2, 0.0))
        else:
            joints = [
                Joint(
                    f"{kind}_{i}",
                    axis,
                    data["stiffness_Nm_per_rad"],
                    data["damping_Nms_per_rad"],
                    armature=data["armature_kgm2"],
                )
                for kind, axis in (
                    ("bend_z", (0, 0, 1)),
                    ("bend_y", (0, 1, 0)),
                    ("twist", (1, 0, 0)),
                )
            ]
            robot.chain(parent, name, joints, offset, ORIGIN)
        for cable, degrees in zip(cables, data["cable_angles_deg"], strict=True):
            y, z = cable_direction(degrees)
            for fraction in fractions:
                r = radius * (1 + fraction * (ratio - 1))
                cable.append(site(name, (fraction * length, r * y, r * z)))
        parent, offset = name, (length, 0.0, 0.0)
    finish_spiral(robot, parent, offset, ORIGIN, cables)
    return robot.text()


def spirob48() -> str:
    """Return the reference's own log-spiral arm: 24 universal joints, 3 cables, hanging down."""
    data = facts("spirob48")
    *bodies, tip = data["bodies"]
    robot = begin(
        "spirob48",
        """
  spirob48: the logarithmic-spiral arm as the reference implementation has it, 25 segments, 24
  universal joints, 48 DOF, 3 cables. At rest it hangs down and the tip is 0.4804 m below the base.
  The paper describes a 27-DOF arm (spirob.urdf); every number here is the reference
  implementation's. Its dry friction of 0.1 N m per joint is left out. Its first frame is pitched by
  1.5708 rad instead of pi/2, which moves the tip sideways by 2e-6 m: kept.
""",
        SPIRAL_COLORS,
        visual(cylinder(0.04, 0.012), "mount", (0.0, 0.0, 0.006)),
    )
    home: dict[str, tuple[str, Vector]] = {}  # site of the facts: its link and position
    parent = "base"
    ends = [*bodies[1:], tip]  # a segment reaches to the next one's frame
    for i, (body, end) in enumerate(zip(bodies, ends, strict=True)):
        name = f"segment_{i}"
        home |= {point["name"]: (name, point["pos"]) for point in body["sites"]}
        reach = end["pos"][0]
        radius = max(math.hypot(*point["pos"][1:]) for point in body["sites"])
        robot.link(
            name,
            body_inertial(body),
            *spiral_parts(
                abs(reach),
                radius,
                "odd" if i % 2 else "even",
                (0.0, 0.0, math.pi) if reach < 0 else (math.pi, 0.0, 0.0),
            ),
        )
        lift = data["base_height"] if i == 0 else 0.0
        position = (body["pos"][0], body["pos"][1], body["pos"][2] - lift)
        angles = rpy(body["quat_wxyz"])
        if i == 0:
            robot.fixed(parent, name, position, angles)
        else:
            joints = [
                Joint(
                    f"{kind}_{i}",
                    joint["axis"],
                    data["stiffness"],
                    data["damping"],
                    armature=data["armature"],
                )
                for kind, joint in zip(("bend_z", "bend_y"), body["joints"], strict=True)
            ]
            robot.chain(parent, name, joints, position, angles)
        parent = name
    cables = [[site(*home[point]) for point in tendon["path"]] for tendon in data["tendons"]]
    finish_spiral(robot, parent, tip["pos"], rpy(tip["quat_wxyz"]), cables)
    return robot.text()


def finish_spiral(
    robot: Robot, last: str, offset: Vector, angles: Vector, cables: Sequence[Sequence[str]]
) -> None:
    """Add what both arms share: the tip, the cables and their inputs."""
    robot.link("tip")
    robot.fixed(last, "tip", offset, angles)
    for i, sites in enumerate(cables, 1):
        robot.tendon(f"cable_{i}", sites)
    for i in range(1, len(cables) + 1):
        robot.actuator(f"u{i}", f"cable_{i}", CABLE_GEAR, CABLE_BOUNDS)


# --- meshes -------------------------------------------------------------------------------------


def grid_triangles(grid: np.ndarray) -> np.ndarray:
    """Return the triangles of a grid of points that is closed along its second axis.

    Parameters
    ----------
    grid : (rows, columns, 3); seen from outside, columns run counter-clockwise about the rows

    Returns
    -------
    (n, 3, 3) corners; triangles without area (at a pole) are left out
    """
    right = np.roll(grid, -1, axis=1)
    a, b, c, d = grid[:-1], right[:-1], right[1:], grid[1:]
    triangles = np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)])
    triangles = triangles.reshape(-1, 3, 3)
    return triangles[np.linalg.norm(normals(triangles), axis=1) > 1e-9]


def normals(triangles: np.ndarray) -> np.ndarray:
    """Return the cross product of two edges of each triangle, (n, 3)."""
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def stl(triangles: np.ndarray) -> bytes:
    """Return a binary STL file. Rounding makes its bytes independent of the C library."""
    # adding 0 turns -0 into 0
    corners = np.round(triangles, 6) + 0.0
    facing = normals(corners)
    facing = np.round(facing / np.linalg.norm(facing, axis=1, keepdims=True), 4) + 0.0
    record = np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    data = np.zeros(len(corners), record)
    data["vectors"] = np.concatenate([facing[:, None], corners], axis=1)
    return b"\0" * 80 + np.array(len(corners), "<u4").tobytes() + data.tobytes()


def helicoid_mesh(strips: int = 4, inner: float = 0.6, thickness: float = 0.16) -> np.ndarray:
    """Return one cell of a trimmed helicoid: strips of both hands about y, of radius and height 1.

    A helicoid sweeps a radial line up a screw; trimmed, only its outer part is left, and two
    opposite hands make a lattice. A strip turns by 1/``strips`` of a circle, so cells fit together.

    Parameters
    ----------
    strips : number of strips per hand
    inner : radius inside which the helicoid is cut away
    thickness : of a strip, along y
    """
    up = np.linspace(0.0, 1.0, 13)
    parts = []
    for start in 2 * np.pi * np.arange(strips) / strips:
        for hand in (1, -1):
            angle = start + hand * 2 * np.pi / strips * up
            section = [(inner, -0.5), (1.0, -0.5), (1.0, 0.5), (inner, 0.5)][::-hand]
            grid = np.array(
                [
                    [(r * np.sin(t), y + thickness * h, r * np.cos(t)) for r, h in section]
                    for t, y in zip(angle, up, strict=True)
                ]
            )
            # a collapsed row at either end closes the strip
            first, last = (np.broadcast_to(g.mean(axis=0), g.shape) for g in (grid[0], grid[-1]))
            parts.append(grid_triangles(np.concatenate([[first], grid, [last]])))
    return np.concatenate(parts)


def lathe(profile: np.ndarray, outline: np.ndarray | float = 1.0, columns: int = 72) -> np.ndarray:
    """Return the body that a profile sweeps about x.

    Parameters
    ----------
    profile : (rows, 2), radius and x, from the near to the far end
    outline : factor of the radius at each angle (columns,), or at each row and angle; the angle
        turns from +z towards -y, as :func:`cable_direction` does
    """
    around = np.linspace(0.0, 2 * np.pi, columns, endpoint=False)
    radius = profile[:, :1] * np.ones_like(around) * outline
    x = np.broadcast_to(profile[:, 1:], radius.shape)
    return grid_triangles(np.stack([x, -radius * np.sin(around), radius * np.cos(around)], axis=-1))


def spiral_mesh(taper: float = 0.92258) -> np.ndarray:
    """Return one block of the log-spiral arm, along +x, of length and cable radius 1.

    Three lobes carry a groove each for the cables, at :func:`cable_direction` of 0, 120 and 240
    degrees. The ends are conical, so that blocks touch at the backbone only and the arm can curl.

    Parameters
    ----------
    taper : radius at the far end relative to the near end
    """
    around = np.linspace(0.0, 2 * np.pi, 72, endpoint=False)
    to_cable = (around + np.pi / 3) % (2 * np.pi / 3) - np.pi / 3
    lobes = 1.1 + 0.1 * np.cos(3 * around) - 0.22 * np.exp(-((to_cable / 0.11) ** 2))
    # radius and x; the rim covers the sites at 23 % and 93 %
    profile = np.array(
        [
            (0.0, 0.0), (0.34, 0.0), (0.34, 0.06), (0.93, 0.22), (1.0, 0.28),
            (1.0, 0.86), (0.93, 0.92), (0.34, 0.98), (0.34, 1.0), (0.0, 1.0),
        ]
    )  # fmt: skip
    # the backbone is round, the rim is not
    outline = np.where(profile[:, :1] > 0.5, lobes, 1.0) * (1 + (taper - 1) * profile[:, 1:])
    return lathe(profile, outline)


def phalanx_mesh() -> np.ndarray:
    """Return a finger bone along +x, of length 1 and radius 1 at its ends, slimmer in between."""
    end = np.linspace(0.0, np.pi / 2, 7)
    x = np.linspace(0.14, 0.86, 11)
    waist = 1.0 - 0.14 * np.sin(np.pi * (x - x[0]) / (x[-1] - x[0])) ** 2
    near = np.stack([np.sin(end), 0.14 * (1 - np.cos(end))], 1)
    far = np.stack([np.cos(end), 1 - 0.14 * (1 - np.sin(end))], 1)
    return lathe(np.concatenate([near[:-1], np.stack([waist, x], 1), far[1:]]), columns=48)


# --- files --------------------------------------------------------------------------------------


def files() -> dict[str, bytes]:
    """Return every generated file, by its path below ``urdf/``."""
    robots = (finger, helix, spirob, spirob48)
    content = {f"{robot.__name__}.urdf": robot().encode() for robot in robots}
    content["meshes/helicoid.stl"] = stl(helicoid_mesh())
    content["meshes/phalanx.stl"] = stl(phalanx_mesh())
    content["meshes/spiral.stl"] = stl(spiral_mesh())
    return content


def main(argv: Sequence[str] | None = None) -> int:
    """Write the files, or compare them with ``--check``; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing, name files that differ"
    )
    check = parser.parse_args(argv).check
    stale = 0
    for name, content in files().items():
        path = URDF / name
        if path.is_file() and path.read_bytes() == content:
            continue
        stale += 1
        if check:
            print(f"{path}: differs from what scripts/make_robots.py writes", file=sys.stderr)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(path.name + ".tmp")
        temporary.write_bytes(content)
        os.replace(temporary, path)
        print(f"wrote {path}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
