#!/usr/bin/env python3
"""Write the four bundled robots below ``urdf/``: annotated URDF files and their meshes.

``finger helix spirob spirob48`` are pure functions that return URDF text; the numbers come from
``urdf/source/reference_models.json``. Run without arguments to write every file, or with
``--check`` to compare what is committed with what would be written.

Units are SI and radians. Numbers are printed with ``repr``, so no digit is lost.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from softdyn.commands import cli
from softdyn.design.urdf_text import (
    ORIGIN,
    Joint,
    Robot,
    Vector,
    begin,
    body_inertial,
    collision,
    cylinder,
    inertial,
    mesh,
    over,
    rpy,
    site,
    visual,
)  # fmt: skip

URDF = Path(__file__).resolve().parents[1] / "urdf"
SOURCE = "source/reference_models.json"


# --- numbers ------------------------------------------------------------------------------------


def facts(robot: str) -> dict[str, Any]:
    """Return the collected numbers of one reference robot."""
    collected: dict[str, dict[str, Any]] = json.loads((URDF / SOURCE).read_text())
    return collected[robot]


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


# --- files --------------------------------------------------------------------------------------


def files() -> dict[str, bytes]:
    """Return every generated file, by its path below ``urdf/``."""
    from softdyn.design.robot_meshes import helicoid_mesh, phalanx_mesh, spiral_mesh, stl

    robots = (finger, helix, spirob, spirob48)
    content = {f"{robot.__name__}.urdf": robot().encode() for robot in robots}
    content["meshes/helicoid.stl"] = stl(helicoid_mesh())
    content["meshes/phalanx.stl"] = stl(phalanx_mesh())
    content["meshes/spiral.stl"] = stl(spiral_mesh())
    return content


parser = cli.Parser(__doc__.partition("\n")[0])
parser.add_argument("--check", action="store_true", help="write nothing, name files that differ")


def command(arguments: cli.Arguments) -> int:
    """Write the files that differ, or name them with ``--check``."""
    from softdyn.validation.files import atomic

    different = {
        URDF / name: content
        for name, content in files().items()
        if not (URDF / name).is_file() or (URDF / name).read_bytes() != content
    }
    for path, content in different.items():
        if arguments.check:
            print(f"{path}: differs from what scripts/make_robots.py writes", file=sys.stderr)
            continue
        cli.make_folder(path.parent)
        with atomic(path) as file:
            file.write(content)
        print(f"wrote {path}")
    return cli.FAILED if arguments.check and different else cli.PASSED


main = cli.program(parser, command, __name__)
