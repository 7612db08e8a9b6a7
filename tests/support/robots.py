"""Small robots as URDF, each with a name and changes, and the pieces from which tests build more.

One joint: `hinge`, `slide`. Two: `two_links` in a plane, with the rigs `BENCH` and `WINCHED`, and
`preloaded`, which hangs. More: `TURRET`, `GRIPPER` with mimic joints, `WALKER` for a floating base,
`chain`. `pair_robots` holds one that is an MJCF, too, and `arms` those of a table.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import softdyn
from softdyn import SoftModel
from softdyn.loading import load_text

CIRCLE = ("continuous", "fixed")  # kinds of joints without limits


def write(folder: Path, text: str, name: str = "robot.urdf") -> Path:
    """Write the file of a robot."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def load(folder: Path, text: str, **options: Any) -> SoftModel:
    """The model of a robot's file."""
    return softdyn.load(write(folder, text), **options)


def build(text: str) -> SoftModel:
    """The model of a text without a file."""
    return load_text(text, path=Path("robot.urdf"))


def changed(text: str, *changes: tuple[str, str]) -> str:
    """A text in which each change, (old, new), stands once at least."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def tag(name: str, inside: str = "", /, **attributes: object) -> str:
    """An element; attributes that are None are left out."""
    words = "".join(f' {k}="{value}"' for k, value in attributes.items() if value is not None)
    return f"<{name}{words}>{inside}</{name}>" if inside else f"<{name}{words}/>"


def inertial(
    mass: float = 1.0, com: str | None = None, moments: object = 1e-3, rpy: str | None = None
) -> str:
    """An inertia: one moment for three equal ones, "xx yy zz" or "xx xy xz yy yz zz"."""
    words = str(moments).split()
    if len(words) < 6:
        x, y, z = words * (3 // len(words))
        words = [x, "0", "0", y, "0", z]
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    place = tag("origin", xyz=com, rpy=rpy) if com or rpy else ""
    tensor = tag("inertia", **dict(zip(names, words, strict=True)))
    return tag("inertial", place + tag("mass", value=mass) + tensor)


def link(
    name: str, mass: float | None = None, com: str | None = None, moments: object = 1e-3,
    inside: str = "",
) -> str:  # fmt: skip
    """A link, without an inertia if it has no mass."""
    return tag("link", ("" if mass is None else inertial(mass, com, moments)) + inside, name=name)


def joint(
    name: str, parent: str, child: str, axis: str | None = "0 1 0", kind: str = "revolute", *,
    at: str | None = None, rpy: str | None = None, limit: tuple[object, object] = (-1, 1),
    effort: object = 9, damping: object = None, stiffness: object = None, inside: str = "",
) -> str:  # fmt: skip
    """A joint; limits are in rad or m."""
    place = tag("origin", xyz=at, rpy=rpy) if at or rpy else ""
    ends = tag("parent", link=parent) + tag("child", link=child)
    axis = tag("axis", xyz=axis) if axis and kind != "fixed" else ""
    room = tag("limit", lower=limit[0], upper=limit[1], effort=effort, velocity=9)
    force = tag("dynamics", damping=damping, stiffness=stiffness)
    if damping is None and stiffness is None:
        force = ""
    more = ("" if kind in CIRCLE else room) + force + inside
    return tag("joint", place + ends + axis + more, name=name, type=kind)


def weld(parent: str, child: str, at: str | None = None, name: str = "end") -> str:
    return joint(name, parent, child, kind="fixed", at=at)


def cable(name: str, *path: str, **attributes: object) -> str:
    """A tendon over "joint coefficient", "link x y z" or whole elements."""
    parts = ""
    for step in path:
        words = step.split()
        if step.startswith("<"):
            parts += step
        elif len(words) == 2:
            parts += tag("joint", name=words[0], coef=words[1])
        else:
            parts += tag("site", link=words[0], xyz=" ".join(words[1:]))
    return tag("tendon", parts, name=name, **attributes)


def motor(
    tendon: str, lower: object = -1, upper: object = 1, gear: object = None, name: str = "u",
    **attributes: object,
) -> str:  # fmt: skip
    return tag(
        "actuator", name=name, tendon=tendon, gear=gear, lower=lower, upper=upper, **attributes
    )


def robot(name: str, *parts: str, block: Iterable[str] = ()) -> str:
    """A robot of these elements and those of its <softdyn> block, if it has one."""
    block = "".join(block)
    return tag("robot", "".join(parts) + (block and f'<softdyn version="1">{block}</softdyn>'),
               name=name)  # fmt: skip


def hinge(
    mass: float = 1.0, com: str | None = "0.1 0 0", moments: object = 1e-3, *,
    tip: str | None = None, pull: tuple[object, object] | None = None, gear: object = 1,
    path: Iterable[str] = (), tendon: dict[str, object] | None = None,
    drive: dict[str, Any] | None = None,
    base: str = "", body: str = "", block: str = "", name: str = "hinge", child: str = "arm",
    called: str = "small", **of_joint: Any,
) -> str:  # fmt: skip
    """An arm on a hinge about y.

    `tip` is the place of a massless link on it. `pull` gives the bounds of an input `u` that pulls
    `cable`, with a unit lever or over `path`; `tendon` and `drive` are attributes of both.
    `base` and `body` stand inside the links. `name` is the joint's, `called` the robot's; the rest
    goes to `joint`.
    """
    parts = [tag("link", base, name="base"), link(child, mass, com, moments, body)]
    parts.append(joint(name, "base", child, **of_joint))
    if tip is not None:
        parts += [link("tip"), weld(child, "tip", tip)]
    if pull is not None:
        drawn = cable("cable", *(path or [f"{name} 1"]), **(tendon or {}))
        block = drawn + motor("cable", *pull, gear, **(drive or {})) + block
    return robot(called, *parts, block=block)


def slide(mass: float = 1.0, moments: object = 1e-3, *, axis: str = "1 0 0", **options: Any) -> str:
    """A block on a slide along x, with the options of `hinge`."""
    places: dict[str, Any] = {"name": "slide", "child": "block", "axis": axis, "kind": "prismatic"}
    return hinge(mass, None, moments, **places | options)


def finger(
    com: str | None = None, tip: str = "0.2 0 0", damping: float = 0.05, block: str = ""
) -> str:
    """A link of 0.1 kg on a hinge, with an input: the small robot of runs and sweeps."""
    return hinge(
        0.1, com, name="turn", child="body", limit=(-2, 2), damping=damping, tip=tip, pull=(-5, 5),
        block=block, called="finger",
    )  # fmt: skip


def two_links(
    name: str, *block: str, mass: float = 0.2, damping: float = 0.1, stiffness: float = 2.0,
    looks: str = "",
) -> str:  # fmt: skip
    """An arm along x in a vertical plane: base, `shoulder`, upper, `elbow`, fore, tip."""
    places: dict[str, Any] = {"limit": (-1.2, 1.2), "damping": damping, "stiffness": stiffness}
    bodies = [
        link(one, mass, "0.1 0 0", "1e-4 1e-3 1e-3", looks) for one in ("base", "upper", "fore")
    ]
    return robot(
        name, *bodies, link("tip"),
        joint("shoulder", "base", "upper", at="0 0 0", **places),
        joint("elbow", "upper", "fore", at="0.2 0 0", **places),
        weld("fore", "tip", "0.2 0 0"), block=block,
    )  # fmt: skip


# on the bench of docs/bench.md: two motors, one of them late; encoders, a load cell, a camera
BENCH = two_links(
    "bench", cable("a", "shoulder 0.05"), cable("b", "elbow 0.05"),
    motor("a", -60, 60, 1, "ua"), motor("b", -60, 60, 1, "ub", lag=0.01), '<task frame="tip"/>',
    '<sensor name="shoulder" type="joint" joint="shoulder" noise="3e-4" lower="-1.1" upper="1.1"/>',
    '<sensor name="elbow" type="joint" joint="elbow" noise="3e-4"/>',
    '<sensor name="load" type="tension" tendon="b" noise="0.5"/>',
    '<sensor name="camera" type="position" link="tip" noise="1e-3" rate="50" latency="0.02"/>',
)  # fmt: skip
# a winch below, a motor on a slack brace above, lag and delay of both, sensors of every kind
WINCHED = two_links(
    "winched",
    cable("below", "base -0.02 0 -0.02", "upper 0.1 0 -0.02", "fore 0.15 0 -0.02"),
    cable("above", "base -0.02 0 0.02", "upper 0.1 0 0.02", "fore 0.15 0 0.02",
          stiffness=50, damping=1, slack="true"),
    motor("below", 0, 60, -1, "flexor", command="length", stiffness=600, damping=4, lag=0.02,
          delay=0.0041),
    motor("above", 0, 60, -1, "extensor", lag=0.01, delay=0.003), '<task frame="tip"/>',
    '<sensor name="wire" type="length" tendon="above"/>',
    '<sensor name="load" type="tension" tendon="above"/>',
    '<sensor name="pull" type="tension" tendon="below"/>',
    '<sensor name="camera" type="pose" link="tip" xyz="0 0.01 0" rpy="0.3 0.2 0.1"/>',
    '<sensor name="mark" type="position" link="upper" xyz="0.05 0 0.01"/>',
    '<sensor name="imu" type="accelerometer" link="tip" rpy="0 0.4 0"/>',
    '<sensor name="gyro" type="gyro" link="tip"/>',
    '<sensor name="encoder" type="joint" joint="elbow"/>',
    mass=0.3, damping=0.02, stiffness=0.5,
    looks='<visual><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.02 0.02"/></geometry>'
    "</visual>",
)  # fmt: skip


PRELOADED_TIP = (0.02, 0.0, -0.199)  # a target of `preloaded`


def preloaded(lower: float = 5.0, upper: float = 5.0, *, elbow: float = -1.0) -> str:
    """A hanging arm with a cable that pulls, and one that keeps a constant preload.

    The preload's bounds are in N, the elbow's lower limit in rad.
    """
    places: dict[str, Any] = {"damping": 0.02, "stiffness": 0.5, "effort": 1}
    return robot(
        "arm", link("base"), link("tip"),
        *(link(name, 0.1, "0 0 -0.1", 1e-4) for name in "ab"),
        joint("j1", "base", "a", **places),
        joint("j2", "a", "b", at="0 0 -0.1", limit=(elbow, 1), **places),
        weld("b", "tip", "0 0 -0.1"),
        block=(
            cable("left", "j1 0.02", "j2 0.01"), cable("right", "j1 -0.02", "j2 -0.02"),
            motor("left", 0, 20, -1, "pull"), motor("right", lower, upper, -1, "preload"),
            '<task frame="tip"/>',
        ),
    )  # fmt: skip


# an arm in a vertical plane on a continuous joint that no spring holds
TURRET = robot(
    "turret", link("base"),
    link("table", 0.3, "0 0 0", "1e-5 1e-4 1e-4"), link("arm", 0.1, "0.06 0 0", "1e-5 1e-4 1e-4"),
    link("hand", 0.05, "0.04 0 0", "1e-5 1e-4 1e-4"), link("tip"),
    joint("pan", "base", "table", "0 0 1", "continuous", damping=0.02),
    joint("tilt", "table", "arm", at="0 0 0.05", limit=(-1.2, 1.2), damping=0.01, stiffness=0.6),
    joint("wrist", "arm", "hand", at="0.12 0 0", limit=(-1.2, 1.2), damping=0.005, stiffness=0.2),
    weld("hand", "tip", "0.08 0 0"),
    block=(
        cable("pan_t", "pan 1"), cable("flex", "tilt 0.02", "wrist 0.015"),
        motor("pan_t", name="pan_m"), motor("flex", -30, 30, name="flex_m"), '<task frame="tip"/>',
    ),
)  # fmt: skip
SOLID = inertial(0.7, "0.05 -0.02 0.1", "2e-3 1e-4 -2e-4 3e-3 3e-4 4e-3", "0.3 -0.8 2")


def oblique(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
    """A joint with an offset, about an oblique axis."""
    return joint(
        name, parent, child, "0.3 -0.4 1.2", kind, at="0.1 0.2 -0.3", rpy="0.4 -1.1 2.5",
        limit=(-0.8, 1.1), effort=1, inside=more,
    )  # fmt: skip


def solids(*names: str) -> str:
    """Links with `SOLID`."""
    return "".join(tag("link", SOLID, name=name) for name in names)


def spring(joint: str, stiffness: float, rest: float = 0.0) -> str:
    """The spring of a joint, as Gazebo writes it."""
    parts = f"<springStiffness>{stiffness}</springStiffness>"
    return tag("gazebo", f"{parts}<springReference>{rest}</springReference>", reference=joint)


DAMPER = '<dynamics damping="0.3"/>'
# an arm with a hinge that a slide and a continuous joint follow, one of them beyond the hinge
GRIPPER = robot(
    "gripper", solids("base", "arm", "finger", "jaw", "wheel"),
    oblique("z_arm", "revolute", "base", "arm", DAMPER),
    oblique("a_lead", "revolute", "arm", "finger", DAMPER),
    oblique("b_slide", "prismatic", "arm", "jaw",
            '<mimic joint="a_lead" multiplier="-0.5" offset="0.02"/><dynamics damping="2"/>'),
    oblique("c_turn", "continuous", "finger", "wheel",
            '<mimic joint="a_lead" multiplier="2" offset="-0.1"/>'),
    spring("b_slide", 30, 0.1), spring("a_lead", 2),
    block=(
        '<joint name="c_turn" armature="0.01"/><joint name="a_lead" armature="0.003"/>'
        '<joint name="z_arm" armature="0.002"/>',
        cable("band", "b_slide 3", "z_arm 0.5", stiffness=4, damping=0.1),
        cable("cable", "arm 0.3 0 0", "jaw 0 0.1 0", "wheel 0.2 0 0.1", stiffness=9),
        motor("band", -1, 3, 2, "u1"), motor("cable", 0, 3, -1, "u2"), motor("band", name="u3"),
        '<task frame="wheel"/>',
    ),
)  # fmt: skip
# for a floating base: a trunk with two legs (one a continuous joint), a spring, a damper, a cable
WALKER = robot(
    "walker", solids("trunk", "pack", "z", "a"),
    oblique("weld", "fixed", "trunk", "pack"),
    oblique("jz", "continuous", "pack", "z", DAMPER),
    oblique("ja", "revolute", "trunk", "a", DAMPER),
    spring("ja", 2, 0.3),
    block=(
        '<joint name="jz" armature="0.01"/>',
        cable("cable", "trunk 0.3 0 0", "z 0 0.1 0", "a 0.2 0 0.1", stiffness=9, rest=0.2),
        motor("cable", 0, 3, -1), '<task frame="a"/>',
    ),
)  # fmt: skip


def chain(axes: str, tendons: Iterable[tuple[float, ...]] = (), bound: float = 1.0) -> str:
    """A serial arm, from the kinds of its joints and the coefficients of its tendons.

    A joint is "x", "y", "z" (revolute), "c" (continuous about y) or "p" (prismatic along z).
    """
    kinds = {"c": "continuous", "p": "prismatic"}
    places = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1", "c": "0 1 0", "p": "0 0 1"}
    parts = [link("world")]
    for i, axis in enumerate(axes):
        parts.append(link(f"l{i}", 0.1, "0.01 0.02 -0.06", "2e-4 2.5e-4 3e-4"))
        parts.append(joint(
            f"j{i}", f"l{i - 1}" if i else "world", f"l{i}", places[axis],
            kinds.get(axis, "revolute"), at=f"0 0 {-0.1 * (i > 0)}", limit=(-2, 2), damping=0.05,
            stiffness=None if axis == "c" else 0.5,
        ))  # fmt: skip
    parts += [link("tip"), weld(f"l{len(axes) - 1}", "tip", "0.02 0.01 -0.1")]
    drawn = [
        cable(f"t{t}", *(f"j{i} {c}" for i, c in enumerate(row) if c))
        for t, row in enumerate(tendons)
    ]
    drawn += [motor(f"t{t}", -bound, bound, 0.5, f"u{t}") for t, _ in enumerate(tendons)]
    return robot("chain", *parts, block=(*drawn, '<task frame="tip"/>'))
