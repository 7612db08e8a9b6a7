"""Public reports about other tools, tried with softdyn: the page and the test have one table.

Each row has its own small files, one command with its exit code and words, and the right values
with a call that computes each.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError, SetPoint, SoftModel, design, parse, statics
from softdyn.controllers.registry import make_controller
from softdyn.description.visuals import visuals
from softdyn.exceptions import UrdfError
from softdyn.validation import rollout, simulate
from softdyn.validation.mjcf import export
from softdyn.validation.mjcf.comparison.finding import force
from softdyn.validation.mjcf.comparison.side import Side, neutral
from tests.support import robots

Measure = Callable[[Path], Any]


@dataclass(frozen=True)
class Report:
    """One report.

    Attributes
    ----------
    name : str
        Name of the row, for the test.
    sources : tuple of str
        Threads as project#number; empty for a fault of our own that was found beside the others.
    reported : str
        The fault or the wish that the thread reports.
    files : mapping of str to str or bytes
        Contents of the files that the command reads.
    command : str
        Command line without the program's name, run in the folder of the files.
    code : int
        Its exit code.
    says : tuple of str
        Words of its output; the page quotes the first.
    does : str
        The answer of softdyn, in words.
    values : tuple of (str, callable, value)
        The quantity with its unit, a call that computes it in the folder, and the right value.
    """

    name: str
    sources: tuple[str, ...]
    reported: str
    files: Mapping[str, str | bytes]
    command: str
    code: int
    says: tuple[str, ...]
    does: str
    values: tuple[tuple[str, Measure, Any], ...] = ()
    tolerance: float = 1e-9


# -- small files -----------------------------------------------------------------------------------


def robot(*parts: str, name: str = "robot", version: str = "") -> str:
    """A URDF with a root link ``base``."""
    stated = f' version="{version}"' if version else ""
    return f'<robot name="{name}"{stated}><link name="base"/>{"".join(parts)}</robot>'


def link(
    name: str, mass: float = 0.2, moments: tuple[float, float, float] = (1e-4, 1e-4, 1e-4),
    place: str = 'xyz="0 0 -0.1"', more: str = "",
) -> str:  # fmt: skip
    """A link; `place` are attributes of the origin of its inertia."""
    xx, yy, zz = moments
    return (
        f'<link name="{name}"><inertial><origin {place}/><mass value="{mass}"/><inertia ixx="{xx}" '
        f'iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>{more}</link>'
    )


def joint(
    name: str, parent: str, child: str, kind: str = "revolute", axis: str = "0 1 0",
    origin: str = "", limits: tuple[float, float] = (-1.5, 1.5), more: str = "",
) -> str:  # fmt: skip
    """A joint; `origin` are attributes of its place."""
    place = f"<origin {origin}/>" if origin else ""
    if kind == "fixed":
        moves = ""
    else:
        span = "" if kind == "continuous" else f'lower="{limits[0]}" upper="{limits[1]}" '
        moves = f'<axis xyz="{axis}"/><limit {span}effort="9" velocity="9"/>{more}'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{place}{moves}</joint>"
    )


def block(*parts: str) -> str:
    """The ``<softdyn>`` block."""
    return f'<softdyn version="1">{"".join(parts)}</softdyn>'


def over(tendon: str, joint: str, more: str = "") -> str:
    """A tendon over one joint."""
    return f'<tendon name="{tendon}" {more}><joint name="{joint}" coef="1"/></tendon>'


def mjcf(body: str, more: str = "", head: str = "") -> str:
    """An MJCF with angles in rad."""
    return f'<mujoco><compiler angle="radian" {head}/><worldbody>{body}</worldbody>{more}</mujoco>'


# -- measures --------------------------------------------------------------------------------------


def mass_matrix(file: str) -> Measure:
    """M at q = 0, as a list of rows; a number if there is one joint."""

    def measure(folder: Path) -> Any:
        model = softdyn.load(folder / file)
        M = model.state(model.q0, np.zeros(model.nv)).M
        return M.item() if M.size == 1 else M.tolist()

    return measure


def read(file: str, get: Callable[[Any], Any]) -> Measure:
    """A part of the neutral form of a file."""
    return lambda folder: get(neutral(folder / file))


def bend(file: str, tension: float) -> Measure:
    """Sum of the joints' moves (rad, m) by which a cable alone moves a straight, weightless arm."""

    def measure(folder: Path) -> float:
        model = arm(folder, file)
        q = model.state(model.q0, np.zeros(model.nv)).B[:, 0] * tension / model.stiffness
        return float(np.abs(q).sum())

    return measure


def arm(folder: Path, file: str) -> SoftModel:
    """The model of an arm's table."""
    values = tomllib.loads((folder / file).read_text("utf-8"))
    path = folder / f"{file}.urdf"
    path.write_text(design.urdf(design.make_arm(values, file)))
    return softdyn.load(path)


def polynomial(name: str, x: float) -> Measure:
    """Forces of the URDF's and the MJCF's spring or damper at x."""

    def measure(folder: Path) -> list[float]:
        parts = [neutral(folder / f"hinge.{suffix}").parts[0] for suffix in ("urdf", "xml")]
        curves = [(getattr(part, name), *getattr(part, f"{name}_curve")) for part in parts]
        return [force(name, curve, x) for curve in curves]

    return measure


def drop(folder: Path) -> list[float]:
    """Way ahead and down of the tip of a level rod under a weight at its end, over its length."""
    found = statics.rest(arm(folder, "rod.toml"))
    return [float(found.y[0]) / 0.3, -float(found.y[2]) / 0.3]


def refusal(file: str) -> Measure:
    """The end of the line with which a file is refused."""

    def measure(folder: Path) -> str:
        try:
            softdyn.load(folder / file)
        except UrdfError as error:
            return f"got {error.got}"
        return ""

    return measure


def least_eigenvalue(file: str) -> Measure:
    """The least eigenvalue of the stiffness at the rest under no input."""

    def measure(folder: Path) -> float:
        found, _ = statics.ramp(softdyn.load(folder / file), [0.0])
        return float(found.eigenvalues.min())

    return measure


def readable(file: str) -> Measure:
    """Numbers of visual shapes that are read, and of those that are not."""

    def measure(folder: Path) -> list[int]:
        return [len(found) for found in visuals(parse(folder / file), ("visual",))]

    return measure


def turned_frame(folder: Path) -> float:
    """Largest error of the exported frame's rotation against MuJoCo's."""
    export.write_urdf(folder / "upright.xml", folder / "frame.urdf")
    ours, theirs = (neutral(folder / f).frames["tip"] for f in ("frame.urdf", "upright.xml"))
    return float(np.abs(ours.pose.rotation - theirs.pose.rotation).max())


def speed_from_the_stop(folder: Path) -> float:
    """The speed (m/s) 2 ms after the default start."""
    model = softdyn.load(folder / "slide.urdf")
    log = rollout(model, [0.0], 0.002, timestep=1e-4, integrator="rk4")
    return float(log.v[-1, 0])


def refused_start(folder: Path) -> str:
    """The end of the line with which a start beyond the limit is refused."""
    try:
        rollout(softdyn.load(folder / "slide.urdf"), [0.0], 0.002, q0=np.zeros(1))
    except InputError as error:
        return f"{error.expected}, got {error.got}"
    return ""


def holding_inputs(folder: Path) -> list[float]:
    """The inputs (N) of the equilibrium nearest to the target."""
    found = statics.inputs_for_tip(
        softdyn.load(folder / "arm.urdf"), robots.PRELOADED_TIP, shapes=4
    )
    return [float(value) for value in found.nearest.u]


def steps_not_solved(folder: Path) -> int:
    """The steps of 300 that the controller does not solve."""
    model = softdyn.load(folder / "nearly.urdf")
    law = make_controller("soft-id-clf-qp", model, {"Kp": 100.0, "eps": 0.1})
    return simulate(model, law, SetPoint(robots.PRELOADED_TIP), duration=0.6).not_solved


def pulled_tip(folder: Path) -> float:
    """The cart's position at rest (m) after its rubbing cable was pulled."""
    return float(rollout(softdyn.load(folder / "rope.urdf"), [10.0], 2.0, friction=True).y[-1, 0])


def hung_and_slack(folder: Path) -> list[float]:
    """Length (m) and tension (N) of the cable that carries the load, and its tension once slack."""
    model = softdyn.load(folder / "hoist.urdf")
    log = rollout(model, [[0.5], [1.0]], 4.0, rig="file", commands=["winch"])
    hung = log.steps // 2 - 1
    return [float(x) for x in (-log.y[hung, 2], log.acting[hung, 0], log.acting[-1, 0])]


# -- reports ---------------------------------------------------------------------------------------

TURNED = link("a", 1, (1, 2, 2.5), f'xyz="0 0 0" rpy="0 0 {math.pi / 2!r}"')
SPIN = joint("spin", "base", "a", "continuous", "1 0 0")
SPIN_BODY = (
    '<body name="a"><joint name="spin" axis="1 0 0"/><inertial pos="0 0 0" mass="1" {}/>{}</body>'
)
CROSS_CHILD = (
    '<body name="b" quat="0.7071067811865476 0 0 0.7071067811865476"><inertial pos="0 0 0" '
    'mass="0.5" diaginertia="0.01 0.02 0.025"/></body>'
)
SPRING_BALL = (
    '<body name="a"><joint name="hinge" axis="0 0 1" {}/>'
    '<geom type="sphere" size="0.1" mass="2"/></body>'
)
BALL_LINK = link("a", 2, (0.008, 0.008, 0.008), 'xyz="0 0 0"')
CLASSES = '<default><default class="stiff"><tendon stiffness="12" damping="3"/></default></default>'
GEAR_PLAY = (
    '<body name="a"><joint name="motor" axis="0 1 0" armature="0.01" range="-1.5 1.5"/>'
    '<joint name="play" axis="0 1 0" armature="0.001" range="-0.02 0.02"/>'
    '<inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body>'
)
UPRIGHT = (
    '<body name="a"><joint name="hinge" axis="0 1 0"/>'
    '<inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>'
    '<site name="tip" pos="0 0 -0.2" quat="0.6830127018922194 -0.1830127018922193 '
    '0.6830127018922193 0.1830127018922193"/></body>'
)
STIFF = 0.5e6 * math.pi / 4 * 1e-8  # N m², EI of a rod of 10 mm radius, E = 0.5 MPa
TABLE = "[material]\nyoungs_modulus_MPa = 0.5\ndensity_kg_m3 = {}\n[[section]]\nlength_mm = {}\n"
TABLE += "radius_mm = 10\nsegments = {}\nfreedoms = {}\n"
CABLE = '[[cable]]\nname = "{}"\noffset_mm = {}\nrouting = "channel"\nmax_tension_N = 1\n'
HINGED = link("a")
HINGE = joint("flex", "base", "a", more='<dynamics damping="0.02" stiffness="0.6"/>')
BENT = (
    '<body name="a"><joint name="flex" axis="0 1 0" range="-1.5 1.5" {}/>'
    '<inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body>'
)
ORIENTED = (
    '<body name="a"><joint name="ball" type="ball"/><inertial pos="0 0 -0.1" mass="0.2" '
    'diaginertia="1e-4 1e-4 1e-4"/></body>'
)
AIM = '<actuator><orientation name="aim" joint="ball" kp="{}"/></actuator>'

RIGHT = (
    Report(
        "inertial_rpy",
        ("google-deepmind/mujoco#3559",),
        "The rotation of a URDF's inertial frame is lost, and with it the axes of the inertia.",
        {
            "turned.urdf": robot(TURNED, SPIN),
            "turned.xml": mjcf(SPIN_BODY.format('diaginertia="2 1 2.5"', "")),
        },
        "compare turned.urdf turned.xml",
        0,
        ("the files agree",),
        "reads the rotation; a file with the turned tensor agrees",
        (("M about x (kg m²)", mass_matrix("turned.urdf"), 2.0),),
    ),
    Report(
        "fused_child",
        ("google-deepmind/mujoco#2982",),
        "A turned body without a joint is fused into its parent with its axes not turned.",
        {
            "cross.urdf": robot(
                link("a", 1, (0.1, 0.1, 0.1), 'xyz="0 0 0"'),
                SPIN,
                link("b", 0.5, (0.01, 0.02, 0.025), 'xyz="0 0 0"'),
                joint("weld", "a", "b", "fixed", origin='rpy="0 0 1.5707963267948966"'),
            ),
            "cross.xml": mjcf(
                SPIN_BODY.format('diaginertia="0.1 0.1 0.1"', CROSS_CHILD), head='fusestatic="true"'
            ),
        },
        "compare cross.urdf cross.xml",
        0,
        ("the files agree",),
        "lumps fixed links with their rotations, in both formats",
        (("M about x (kg m²)", mass_matrix("cross.urdf"), 0.12),),
    ),
    Report(
        "springdamper",
        ("newton-physics/newton#3735",),
        "A joint's springdamper, which stands for a stiffness and a damping, is ignored.",
        {
            "ball.xml": mjcf(SPRING_BALL.format('springdamper="0.2 1.5"')),
            "ball.urdf": robot(
                BALL_LINK,
                joint(
                    "hinge",
                    "base",
                    "a",
                    "revolute",
                    "0 0 1",
                    limits=(-9, 9),
                    more=f'<dynamics damping="0.08" stiffness="{0.008 / (0.04 * 2.25)!r}"/>',
                ),
            ),
        },
        "compare ball.xml ball.urdf",
        0,
        ("the files agree",),
        "takes what MuJoCo's compiler makes of it",
        (
            ("stiffness (N m/rad)", read("ball.xml", lambda r: r.parts[0].stiffness), 0.08 / 0.9),
            ("damping (N m s/rad)", read("ball.xml", lambda r: r.parts[0].damping), 0.08),
        ),
    ),
    Report(
        "tendon_class",
        ("newton-physics/newton#3668",),
        "Fixed tendons do not get the values of their default class.",
        {
            "class.xml": mjcf(
                SPRING_BALL.format(""),
                f'{CLASSES}<tendon><fixed name="t" class="stiff" springlength="0">'
                '<joint joint="hinge" coef="1"/></fixed></tendon>',
            ),
            "class.urdf": robot(
                BALL_LINK,
                joint("hinge", "base", "a", "revolute", "0 0 1", limits=(-9, 9)),
                block(over("t", "hinge", 'stiffness="12" damping="3" rest="0"')),
            ),
        },
        "compare class.xml class.urdf",
        0,
        ("the files agree",),
        "takes the values of the class",
        (
            (
                "stiffness, damping of the tendon",
                read("class.xml", lambda r: [r.cables[0].stiffness, r.cables[0].damping]),
                [12.0, 3.0],
            ),
        ),
    ),
    Report(
        "backlash",
        ("google-deepmind/mujoco#3468",),
        "Backlash needs two hinges on one axis, each with an armature, in place of a field of the "
        "actuator.",
        {
            "play.xml": mjcf(GEAR_PLAY),
            "play.urdf": robot(
                HINGED,
                '<link name="gear"/>',
                joint("motor", "base", "gear"),
                joint("play", "gear", "a", limits=(-0.02, 0.02)),
                block('<joint name="motor" armature="0.01"/><joint name="play" armature="0.001"/>'),
            ),
        },
        "compare play.urdf play.xml",
        0,
        ("the files agree",),
        "reads the two hinges with their armatures and stops; a massless link lies between them",
        (("M (kg m²)", mass_matrix("play.urdf"), [[0.0121, 0.0021], [0.0021, 0.0031]]),),
    ),
    Report(
        "encodings",
        ("iory/scikit-robot#864",),
        "A URDF is read in the platform's encoding and not in the one that it declares.",
        {
            "katakana.urdf": (
                '<?xml version="1.0" encoding="shift_jis"?>'
                + robot(HINGED.replace("a", "a"), HINGE.replace("flex", "ｱﾙﾐ"))
            ).encode("shift_jis"),
            "wide.urdf": (
                '<?xml version="1.0" encoding="utf-16"?>'
                + robot(HINGED, HINGE.replace("flex", "ゴム"))
            ).encode("utf-16"),
        },
        "compare katakana.urdf wide.urdf",
        0,
        ("ｱﾙﾐ = ゴム", "the files agree"),
        "reads the declared encoding",
        (("joint", read("katakana.urdf", lambda r: r.parts[0].name), "ｱﾙﾐ"),),
    ),
    Report(
        "hostile_names",
        ("Gepetto/gepetto-viewer#177",),
        "A link with a slash in its name is not shown.",
        {"motor.urdf": robot(HINGED, HINGE).replace('"a"', '"DFKI_Motor_0/axis &lt;1&gt; .."')},
        "export motor.urdf --mjcf motor.xml",
        0,
        ("the files agree",),
        "takes any name, in both formats",
        (("link", read("motor.xml", lambda r: r.parts[0].link), "DFKI_Motor_0/axis <1> .."),),
    ),
    Report(
        "gimbal_lock",
        ("partcad/partcad#518",),
        "The roll, pitch and yaw of an exported rotation are wrong where the pitch is 90°.",
        {"upright.xml": mjcf(UPRIGHT)},
        "export upright.xml --urdf upright.urdf",
        0,
        ("the files agree",),
        "keeps the rotation: the yaw is free there, so it is 0 and the roll carries it",
        (("error of the rotation of a frame at pitch 90°, yaw 30°", turned_frame, 0.0),),
        1e-12,
    ),
    Report(
        "overridden_mass",
        ("ros/solidworks_urdf_exporter#172",),
        "A mass that the user overrode in the drawing, 50 g, is exported as the material's 8 g.",
        {
            "cube.urdf": robot(
                link("a", 0.05, (5.333e-7,) * 3, 'xyz="0 0 -0.1"'),
                '<link name="tip"/>',
                HINGE,
                joint("end", "a", "tip", "fixed", origin='xyz="0 0 -0.2"'),
            )
        },
        "check cube.urdf",
        1,
        ("mass and inertia do not match",),
        "cannot know the drawing; it names a mass that does not fit to its inertia, such as 50 g "
        "with the moments of 8 g",
        (("M (kg m²)", mass_matrix("cube.urdf"), 0.05 * 0.01 + 5.333e-7),),
    ),
    Report(
        "micro_mass",
        ("gazebosim/sdformat#199",),
        "Links without an inertia, and links of 1e-6 kg, are dropped in silence.",
        {
            "mite.urdf": robot(
                link("a", 1e-6, (1e-12,) * 3),
                HINGE,
                '<link name="tip"/>',
                joint("end", "a", "tip", "fixed", origin='xyz="0 0 -0.2"'),
            ),
            "mite.xml": mjcf(
                BENT.format('stiffness="0.6" damping="0.02"').replace(
                    'mass="0.2" diaginertia="1e-4 1e-4 1e-4"',
                    'mass="1e-6" diaginertia="1e-12 1e-12 1e-12"',
                )
            ),
        },
        "compare mite.urdf mite.xml",
        0,
        ("the files agree",),
        "keeps every link; a joint that moves no mass is refused by name",
        (("M (kg m²)", mass_matrix("mite.urdf"), 1e-8 + 1e-12),),
    ),
    Report(
        "static_solution",
        ("GazzolaLab/PyElastica#218",),
        "Can a rod's rest under a load be found without integrating over time?",
        {
            "rod.toml": "unusual = true\n"
            + TABLE.format(0.001, 300, 40, '["bend"]')
            + "[mount]\ndirection = [1, 0, 0]\n[payload]\nradius_mm = 1\n"
            + f"mass_g = {1e3 * STIFF / 0.3**2 / 9.81!r}\n"
        },
        "new rod.toml --out rod.urdf",
        0,
        ("degrees_of_freedom 80",),
        "`statics` and `check` find rests directly; a level rod of 40 joints whose end carries "
        "F L² / EI = 1 against the elastica",
        (("tip ahead, down (over the length)", drop, [0.94357, 0.30172]),),
        3e-4,
    ),
    Report(
        "several_inputs",
        ("MuJoCo 3.12",),
        "Actuators may have several inputs: an orientation servo of a ball joint has three.",
        {"aim.xml": mjcf(ORIENTED, AIM.format(2)), "other.xml": mjcf(ORIENTED, AIM.format(3))},
        "compare aim.xml other.xml",
        1,
        ("the files differ: actuator",),
        "reads them by row; a differing one is named",
        (("inputs", lambda folder: Side.of(folder / "aim.xml").compiled.nu, 3),),
    ),
)

POLYNOMIAL = mjcf(BENT.format('stiffness="0.6 0 4" damping="0.02 0.01"'))
PARALLEL = mjcf(
    '<body name="a"><joint name="sa" type="slide" axis="0 0 1"/>'
    '<inertial pos="0 0 0" mass="1" diaginertia="1e-4 1e-4 1e-4"/></body>'
    '<body name="b" pos="0 1 0"><joint name="sb" type="slide" axis="0 0 1"/>'
    '<inertial pos="0 0 0" mass="2" diaginertia="1e-4 1e-4 1e-4"/></body>',
    '<equality><connect name="together" body1="a" body2="b" anchor="0 1 0"/></equality>',
)


def slides(*more: str) -> str:
    """Masses of 1, 2 and 3 kg on vertical slides; `more` belongs to the joints, then the robot."""
    parts = [
        link(f"l{k}", k, (0.01, 0.01, 0.01), 'xyz="0 0 0"')
        + joint(f"s{k}", "base", f"l{k}", "prismatic", "0 0 1", f'xyz="0 {k} 0"', (-1, 1), inner)
        for k, inner in enumerate(more[:-1], 1)
    ]
    return robot(*parts, more[-1])


def mimic(leader: str, numbers: str) -> str:
    """A ``<mimic>`` with these attributes."""
    return f'<mimic joint="{leader}" {numbers}/>'


def model_at_zero(file: str) -> Measure:
    """M and g of a model with one coordinate, at q = 0."""

    def measure(folder: Path) -> list[float]:
        model = softdyn.load(folder / file)
        state = model.state(model.q0, np.zeros(model.nv))
        return [state.M.item(), state.g.item()]

    return measure


def losses(file: str) -> Measure:
    """The lines on an MJCF's equalities that its export as a URDF lists as lost."""

    def measure(folder: Path) -> str:
        _, lost = export.write_urdf(folder / file, folder / "tree.urdf")
        return "; ".join(line for line in lost if "equality" in line)

    return measure


CONSTRAINT = (
    '<constraint name="together" type="fixed"><parent link="l1"/><parent_origin xyz="0 1 0"/>'
    '<child link="l2"/><child_origin xyz="0 0 0"/></constraint>'
)
LOOP_JOINT = (
    '<loop_joint name="together" type="fixed"><link1 link="l1"/><link2 link="l2"/></loop_joint>'
)
EQUALITY = '<mujoco><equality><connect body1="l1" body2="l2" anchor="0 1 0"/></equality></mujoco>'
GEARS = robot(
    link("a", 0.1, (1e-3, 1e-3, 1e-3), 'xyz="0 0 0"'),
    link("b", 0.1, (2e-3, 2e-3, 2e-3), 'xyz="0 0 0"'),
    joint("ja", "base", "a", "continuous", "0 0 1"),
    joint("jb", "base", "b", "continuous", "0 0 1", 'xyz="0 1 0"',
          more=mimic("ja", 'multiplier="-2"')),
)  # fmt: skip
TILTED = (0.003, 0.0025, 0.0006)
QUATERNION = (
    'xyz="0 0 -0.1" quat_xyzw="0.25881904510252074 0 0 0.9659258262890683"',
    'xyz="0 0 -0.1" rpy="0.5235987755982988 0 0"',
)
CAPSULE = '<visual><geometry><capsule radius="0.02" length="0.2"/></geometry></visual>'
WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
PACKAGED = (
    '<visual><geometry><mesh filename="package://my_arm/meshes/wedge.obj"/></geometry></visual>'
)
SLIDE = robot(
    link("a", 0.03, place='xyz="0 0 0"'),
    joint("reach", "base", "a", "prismatic", "0 0 -1", limits=(0.02, 0.08),
          more='<dynamics damping="0.5" stiffness="60"/>'),
    '<gazebo reference="reach"><springReference>0.05</springReference></gazebo>',
    block(over("t", "reach"), '<actuator name="u" tendon="t" lower="-1" upper="1"/>'),
)  # fmt: skip
DECAY = 0.5 / (2 * 0.03)  # 1/s
SWING = math.sqrt(60 / 0.03 - DECAY**2)  # rad/s
PULLED = robot(
    link("cart", 0.1, place='xyz="0 0 0"'),
    joint("slide", "base", "cart", "prismatic", "1 0 0", 'xyz="0.3 0 0"', (-0.15, 0.15),
          '<dynamics damping="8" stiffness="200"/>'),
    block('<tendon name="rope" friction="0.2" driven="first"><site link="base" xyz="0 0 0.2"/>'
          '<site link="base" xyz="0 0 0"/><site link="cart" xyz="0 0 0"/></tendon><actuator '
          'name="pull" tendon="rope" gear="-1" lower="0" upper="20"/>'),
)  # fmt: skip
HOIST = robot(
    link("load", 0.2, place='xyz="0 0 0"'),
    joint("drop", "base", "load", "prismatic", "0 0 -1", 'xyz="0 0 -0.3"', (-0.2, 0.4),
          '<dynamics damping="3"/>'),
    block('<tendon name="rope"><site link="base" xyz="0 0 0"/><site link="load" xyz="0 0 0"/>'
          '</tendon><actuator name="winch" tendon="rope" gear="-1" lower="0" upper="30" '
          'command="length" stiffness="500" damping="5"/>'),
)  # fmt: skip
FAST = HINGE.replace("<limit ", '<limit acceleration="30" jerk="900" ')
MENDED = (
    Report(
        "constraint",
        ("ros/urdfdom#264",),
        "A URDF states a tree only; <constraint> is proposed for closed loops.",
        {"loop.urdf": slides("", "", CONSTRAINT)},
        "check loop.urdf",
        2,
        ("expected a tree of <joint>s", "got <constraint>: write it so, or remove it"),
        "refuses what closes a loop, by file, line and element, instead of a robot with two free "
        "slides",
    ),
    Report(
        "loop_joint",
        ("stack-of-tasks/pinocchio#2602",),
        "Closed loops of a robot whose file states a tree.",
        {"loop.urdf": slides("", "", LOOP_JOINT), "mimic.urdf": slides("", mimic("s1", ""), "")},
        "check loop.urdf --json -",
        2,
        ("expected a tree of <joint>s", "got <loop_joint>: write it so, or remove it"),
        "refuses every element that states a loop, whatever its tool; a <mimic> joint states this "
        "one",
        (("M of the two masses as one (kg)", mass_matrix("mimic.urdf"), 3.0),),
    ),
    Report(
        "equality",
        ("kevinzakka/mink#43",),
        "A closed loop of an MJCF, <connect>, has no effect in another tool that reads the file.",
        {"loop.urdf": slides("", "", EQUALITY), "loop.xml": PARALLEL},
        "compare loop.xml loop.urdf",
        2,
        ("expected a tree of <joint>s", "got <equality> in <mujoco>: write it so, or remove it"),
        "refuses it in a URDF; of an MJCF, `compare` names it as a coupling, `export --urdf` lists "
        "it as lost, and with `--plant` MuJoCo closes it",
        (("lost", losses("loop.xml"), "equality connect: a and b"),),
    ),
    Report(
        "urdf_1_2",
        ("stack-of-tasks/pinocchio#2893",),
        "URDF 1.2 has capsules and limits of acceleration and jerk.",
        {
            "new.urdf": robot(link("a", more=CAPSULE), FAST, version="1.2"),
            "old.urdf": robot(HINGED, HINGE),
            "next.urdf": robot(HINGED, HINGE, version="2.0"),
        },
        "compare new.urdf old.urdf --strict",
        0,
        ("the files agree",),
        "reads versions 1.0, 1.1 and 1.2, and refuses others by name",
        (
            ("M (kg m²)", mass_matrix("new.urdf"), 0.2 * 0.01 + 1e-4),
            ("version 2.0", refusal("next.urdf"), 'got version="2.0"'),
        ),
    ),
    Report(
        "quaternion",
        ("gazebosim/sdformat#1654",),
        "A converter does not know what newer URDFs may state.",
        {
            "quaternion.urdf": robot(link("a", 0.6, TILTED, QUATERNION[0]), HINGE, version="1.1"),
            "rpy.urdf": robot(link("a", 0.6, TILTED, QUATERNION[1]), HINGE),
            "unsaid.urdf": robot(link("a", 0.6, TILTED, QUATERNION[0]), HINGE),
        },
        "compare quaternion.urdf rpy.urdf --strict",
        0,
        ("the files agree",),
        "reads quat_xyzw where the file's version allows it; elsewhere the line gives the rpy",
        (
            ("M (kg m²)", mass_matrix("quaternion.urdf"), 0.008025),
            (
                "in a file without a version",
                refusal("unsaid.urdf"),
                "got quat_xyzw in a file of URDF 1.0",
            ),
        ),
    ),
    Report(
        "mimic_chain",
        ("google-deepmind/mujoco#3527",),
        "A URDF's <mimic> is dropped in silence, so that followers move freely.",
        {
            "chain.urdf": slides(
                "", mimic("s1", 'multiplier="2" offset="0.1"'), mimic("s2", 'multiplier="0.5"'), ""
            ),
            "flat.urdf": slides(
                "", mimic("s1", 'multiplier="2" offset="0.1"'), mimic("s1", 'offset="0.05"'), ""
            ),
        },
        "compare chain.urdf flat.urdf --strict",
        0,
        ("the files agree",),
        "followers move with their leaders, in chains too",
        (("M (kg), g (N)", model_at_zero("chain.urdf"), [12.0, 8 * 9.81]),),
    ),
    Report(
        "mimic_continuous",
        ("stack-of-tasks/pinocchio#2753",),
        "Mimic joints that are continuous are not read rightly.",
        {"gears.urdf": GEARS},
        "crosscheck gears.urdf --states-only --samples 2",
        0,
        ("the two engines agree",),
        "continuous joints lead and follow",
        (("M (kg m²)", mass_matrix("gears.urdf"), 0.009),),
    ),
    Report(
        "polynomial_spring",
        ("MuJoCo 3.7",),
        "Springs and dampers may have three coefficients; other readers know the first one only.",
        {"hinge.urdf": robot(HINGED, HINGE), "hinge.xml": POLYNOMIAL},
        "compare hinge.urdf hinge.xml",
        1,
        (
            "0.9 against 14.4 N m at 1.5 rad",
            "0.02 against 0.03 N m at 1 rad/s",
            "the files differ: stiffness, damping",
        ),
        "compares the forces of joints and tendons, and states them where they differ most",
        (
            ("spring at 0.8 rad (N m)", polynomial("stiffness", 0.8), [0.48, 2.528]),
            ("damper at 2 rad/s (N m)", polynomial("damping", 2.0), [0.04, 0.08]),
        ),
    ),
    Report(
        "package",
        ("clemense/yourdfpy#13",),
        "Meshes at package://NAME are not found where the folder has another name.",
        {
            "my_arm-main/package.xml": "<package><name>my_arm</name></package>",
            "my_arm-main/meshes/wedge.obj": WEDGE,
            "my_arm-main/urdf/arm.urdf": robot(link("a", more=PACKAGED), HINGE),
        },
        "export my_arm-main/urdf/arm.urdf --mjcf arm.xml",
        0,
        ("the files agree",),
        "finds the package whose package.xml states the name, as a downloaded archive does; the "
        "folder's name is found as well",
        (("shapes that are read", readable("my_arm-main/urdf/arm.urdf"), [1, 0]),),
    ),
    Report(
        "convergent_cable",
        ("SoRoSim/SoRoSim#1",),
        "A cable that starts on the axis and leaves it along a line makes the program stop.",
        {
            "cone.toml": "unusual = true\n"
            + TABLE.format(0.001, 200, 20, '["bend"]')
            + CABLE.format("cone", "[8, 0]"),
            "central.toml": TABLE.format(1070, 200, 5, '["bend", "extension"]')
            + CABLE.format("central", "0"),
        },
        "new cone.toml --out cone.urdf",
        0,
        ("degrees_of_freedom 40, inputs 1",),
        "`offset_mm` may be 0 at a place or everywhere; a cable in a channel that no joint changes "
        "is refused by name",
        (
            (
                "bend of the cone at 0.5 N (rad)",
                bend("cone.toml", 0.5),
                4e-4 / STIFF / math.hypot(1, 0.04),
            ),
            (
                "a central cable at 1 N shortens the arm by (m)",
                bend("central.toml", 1.0),
                0.2 / (50 * math.pi),
            ),
        ),
    ),
    Report(
        "outside_limits",
        ("google-deepmind/mujoco_menagerie#290",),
        "A robot's default pose lies outside its joints' limits, in silence.",
        {"slide.urdf": SLIDE},
        "rollout slide.urdf --seconds 0.002",
        0,
        ("start: at the limits nearest to 0, which is beyond them: reach at 0.02",),
        "the default start moves to the limits, and the log says so; a stated start beyond them is "
        "refused",
        (
            (
                "speed 2 ms after the start (m/s)",
                speed_from_the_stop,
                (60 * 0.03 / 0.03 + 9.81)
                / SWING
                * math.exp(-DECAY * 0.002)
                * math.sin(SWING * 0.002),
            ),
            (
                "with --q0 0",
                refused_start,
                "joint 'reach' within its limits, 0.02 to 0.08, got 0",
            ),
        ),
        1e-6,
    ),
    Report(
        "locked_input",
        ("Simple-Robotics/proxsuite#445",),
        "A solver calls a problem infeasible although its residual is small.",
        {"arm.urdf": robots.preloaded(), "nearly.urdf": robots.preloaded(5.0, 5.0 + 1e-9)},
        "statics arm.urdf --target 0.02 0 -0.199 --hold 0.2 --rays 4",
        0,
        ("u = 9.405 5.000", "0.002 cm away"),
        "bounds may be equal or almost so: the input is a constant preload, no unknown of searches",
        (
            ("inputs (N)", holding_inputs, [9.40461070722609, 5.0]),
            ("steps of 300 not solved, with bounds 1e-9 apart", steps_not_solved, 0),
        ),
        1e-6,
    ),
    Report(
        "cable_friction",
        ("google-deepmind/mujoco#3005",),
        "A cable's friction round a guide, with the tension's exponential of the angle, is wanted.",
        {"rope.urdf": PULLED},
        "rollout rope.urdf --u 10 --seconds 2 --friction",
        0,
        ("tip at the end 0.263",),
        "cables rub on their guides, with `--friction` and with `--rig`; an option that a robot "
        "has no use for says so",
        (("rest of the cart (m)", pulled_tip, 0.3 - 10 / 200 * math.exp(-0.2 * math.pi / 2)),),
        1e-3,
    ),
    Report(
        "free_lengths",
        ("google-deepmind/mujoco#1704",),
        "How does a cable that only pulls change its length, as a crane's does?",
        {"hoist.urdf": HOIST, "lengths.csv": "t,command.winch\n0,0.5\n2,1\n4,1\n"},
        "rollout hoist.urdf --rig --inputs lengths.csv",
        0,
        ("tip at the end 0 0 -0.7 m",),
        "a winch holds a free length; `command.NAME` gives it in open loop",
        (
            (
                "length (m), tension (N), tension once slack (N)",
                hung_and_slack,
                [0.5 + 0.2 * 9.81 / 500, 0.2 * 9.81, 0.0],
            ),
        ),
        1e-6,
    ),
)

DRIVEN = robot(
    link("a"), link("b", 0.1), joint("hip", "base", "a"), '<link name="tip"/>',
    joint("knee", "a", "b", origin='xyz="0 0 -0.2"'),
    joint("end", "b", "tip", "fixed", origin='xyz="0 0 -0.2"'),
    block(over("drive", "hip"), '<actuator name="motor" tendon="drive" lower="-1" upper="1"/>'),
)  # fmt: skip
DRIVEN_MJCF = mjcf(
    '<body name="a"><joint name="hip" axis="0 1 0" range="-1.5 1.5"/><inertial pos="0 0 -0.1" '
    'mass="0.2" diaginertia="1e-4 1e-4 1e-4"/><body name="b" pos="0 0 -0.2"><joint name="knee" '
    'axis="0 1 0" range="-1.5 1.5"/><inertial pos="0 0 -0.1" mass="0.1" '
    'diaginertia="1e-4 1e-4 1e-4"/><site name="tip" pos="0 0 -0.2"/></body></body>',
    '<actuator><motor name="motor" joint="hip" ctrlrange="-1 1"/></actuator>',
)
ROPE = robot(
    link("load", 0.4, place='xyz="0 0 0"'),
    joint("lift", "base", "load", "prismatic", "0 0 1", 'xyz="0.2 0 0"', (-0.1, 0.1)),
    block('<tendon name="rope"><site link="base" xyz="-0.2 0 0"/>{}<site link="base" '
          'xyz="0 0 0.1"/><site link="load" xyz="0 0 0"/></tendon>'),
)  # fmt: skip
DRUM = mjcf(
    '<site name="s" pos="-0.2 0 0"/><site name="side" pos="0 0 0.2"/><geom name="drum" '
    'type="cylinder" size="0.1 0.01" zaxis="0 1 0" contype="0" conaffinity="0" mass="0"/>'
    '<body name="load" pos="0.2 0 0"><joint name="lift" type="slide" axis="0 0 1" '
    'range="-0.1 0.1"/><inertial pos="0 0 0" mass="0.4" diaginertia="1e-4 1e-4 1e-4"/>'
    '<site name="h"/></body>',
    '<tendon><spatial name="rope"><site site="s"/><geom geom="drum" sidesite="side"/>'
    '<site site="h"/></spatial></tendon>',
)
FINE = SPIN_BODY.format('diaginertia="0.123456789 0.2 0.3"', "")
BOX = (
    '<body name="a"><joint name="j" axis="0 1 0"/><geom name="g" type="box" size="0.1 0.1 0.1" '
    'pos="0 0 -0.1" mass="1"/><geom name="v" type="sphere" size="0.05" contype="0" '
    'conaffinity="0" mass="0"/><geom name="e" type="ellipsoid" size="0.1 0.2 0.3" mass="0"/></body>'
)
LEVEL_ARM = robot(
    link("arm", 0.3, (1e-4, 1e-3, 1e-3), 'xyz="0.1 0 0"'), '<link name="tip"/>',
    joint("hinge", "base", "arm", limits=(-3, 3), more='<dynamics damping="0.01"/>'),
    joint("end", "arm", "tip", "fixed", origin='xyz="0.2 0 0"'),
    block(over("t", "hinge"), '<actuator name="u" tendon="t" lower="-1" upper="1"/>',
          '<task frame="tip"/>'),
)  # fmt: skip
BESIDE = (
    Report(
        "no_stiffness",
        (),
        "Statics of a robot without stiffness at q = 0, such as a bare arm held level: “expected "
        "finite numbers, got nan”.",
        {"arm.urdf": LEVEL_ARM},
        "statics arm.urdf --inputs 0.1",
        0,
        ("its tip at -0.0680 0.0000 -0.1881 m", "stable"),
        "no step of the search is infinite; the arm falls to its rest",
        (
            (
                "least eigenvalue of the rest under no input (N m/rad)",
                least_eigenvalue("arm.urdf"),
                0.3 * 9.81 * 0.1,
            ),
        ),
    ),
    Report(
        "check_mimic",
        (),
        "`check` refuses every robot with mimic joints.",
        {"slides.urdf": slides("", mimic("s1", 'multiplier="2" offset="0.1"'), "")},
        "check slides.urdf",
        0,
        ("nothing looks wrong",),
        "examines them in their free coordinates",
        (("M (kg)", mass_matrix("slides.urdf"), 1.0 + 4 * 2.0),),
    ),
    Report(
        "joint_motor",
        (),
        "A motor on a joint against a tendon over this joint alone: IndexError.",
        {"arm.urdf": DRIVEN, "arm.xml": DRIVEN_MJCF},
        "compare arm.urdf arm.xml --engines --samples 2",
        0,
        ("the two engines agree",),
        "compares lengths and springs of the tendons that both files have",
    ),
    Report(
        "idle_site",
        (),
        "One more site on the straight line between two of its link: “another number of points”.",
        {
            "plain.urdf": ROPE.format(""),
            "more.urdf": ROPE.format('<site link="base" xyz="-0.1 0 0.05"/>'),
        },
        "compare plain.urdf more.urdf --strict",
        0,
        ("the files agree",),
        "leaves out sites that change neither length nor bend",
    ),
    Report(
        "wrapped_cable",
        (),
        "A cable around a shape: “another number of points”.",
        {"plain.urdf": ROPE.format(""), "drum.xml": DRUM},
        "compare plain.urdf drum.xml",
        1,
        ("2 sites, cylinder of radius 0.1", "around a shape in one file only"),
        "names the shape",
    ),
    Report(
        "six_digits",
        (),
        "A file that MuJoCo saved with six digits differs from its source.",
        {"exact.xml": mjcf(FINE), "saved.xml": mjcf(FINE.replace("123456789", "123457"))},
        "compare exact.xml saved.xml",
        0,
        ("the files agree; differences within 1e-05: 1, the largest ",),
        "agrees within the rounding, and states the largest difference; `--tolerance` sets another "
        "limit",
    ),
    Report(
        "tip_at_its_joint",
        (),
        "A tip at its last joint: “the robot is 1e-06 m long”.",
        {"arm.urdf": robot(HINGED, HINGE)},
        "check arm.urdf",
        1,
        ("the tip 'a' sits at the base",),
        "says that the tip is at its joint; the centres of mass tell the size",
    ),
    Report(
        "shapes",
        (),
        "An MJCF's shapes vanish from the exported URDF in silence.",
        {"box.xml": mjcf(BOX)},
        "export box.xml --urdf box.urdf",
        0,
        ("lost: shapes of body 'a': 1 ellipsoid",),
        "writes boxes, spheres, cylinders and capsules, and lists the others as lost",
        (("visual shapes", lambda folder: (folder / "box.urdf").read_text().count("<visual"), 2),),
    ),
)
REPORTS = (*RIGHT, *MENDED, *BESIDE)
