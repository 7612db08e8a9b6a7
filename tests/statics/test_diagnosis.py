"""The diagnosis of check.py, against pendulums with closed-form answers."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.linalg import eigvalsh

import softdyn
from softdyn import UrdfError, design, parse
from softdyn.commands import check
from softdyn.loading import load_text
from softdyn.statics import diagnose, rest, zero_dynamics
from softdyn.statics.suspicious_values import (
    FLOOR,
    fast_springs,
    suspicious_shapes,
    suspicious_values,
    unbalanced,
)
from softdyn.statics.zero_dynamics import examine, find_boundary, sample_poses
from softdyn.validation import Twin
from tests.support import CORPUS, robots
from tests.support.arms import THREE_SECTIONS
from tests.support.control_cases import robot
from tests.support.refused import refused
from tests.support.robots import WALKER, build, write

MASS, LEVER, STIFFNESS, G = 0.3, 0.2, 0.7, 9.81


def links(count: int, up: bool, stiffness: float, actuated: tuple[int, ...] = ()) -> str:
    """A chain of point masses on hinges, hanging or standing, with springs and some motors."""
    sign, parts = 1 if up else -1, [robots.link("l0")]
    for i in range(1, count + 1):
        parts.append(robots.link(f"l{i}", MASS, f"0 0 {sign * LEVER}", 0))
        parts.append(robots.joint(
            f"j{i}", f"l{i - 1}", f"l{i}", at=f"0 0 {sign * LEVER * (i > 1)}", limit=(-3, 3),
            damping=0.1, stiffness=stiffness,
        ))  # fmt: skip
    cables = [robots.cable(f"t{i}", f"j{i} 1") for i in actuated]
    motors = [robots.motor(f"t{i}", name=f"u{i}") for i in actuated]
    return robots.robot("chain", *parts, block=cables + motors)


# -- stiffness against gravity -------------------------------------------------------------------


@pytest.mark.parametrize("up", [False, True])
@pytest.mark.parametrize("angle", [0.0, 0.4, -1.3, 2.9])
def test_one_pendulum(up: bool, angle: float) -> None:
    # ∂(K + g)/∂q = k ± m g l cos q, minus for an inverted one
    pose = examine(build(links(1, up, STIFFNESS)), np.array([angle]))
    gravity = (1 if up else -1) * MASS * G * LEVER * math.cos(angle)
    np.testing.assert_allclose(pose.stiffness, [STIFFNESS - gravity], rtol=1e-12)
    np.testing.assert_allclose(pose.gravity, [gravity], rtol=1e-12)
    np.testing.assert_allclose(pose.softest, [1.0])
    assert (pose.rank, pose.dominates) == (0, gravity < STIFFNESS)


def test_the_critical_stiffness_of_an_inverted_pendulum_is_m_g_l() -> None:
    for factor, stands in ((0.999, False), (1.001, True)):
        model = build(links(1, True, factor * MASS * G * LEVER))
        assert examine(model, np.zeros(1)).dominates is stands


def test_a_motor_takes_its_direction_out() -> None:
    # two inverted links with a motor at the first joint: ∂g₂/∂q₂ = -m g l cos(q₁ + q₂) remains
    model = build(links(2, True, STIFFNESS, actuated=(1,)))
    pose = examine(model, np.array([0.3, -0.8]))
    assert pose.rank == 1
    np.testing.assert_allclose(np.abs(pose.unactuated), [[0.0, 1.0]], atol=1e-12)
    gravity = MASS * G * LEVER * math.cos(-0.5)
    np.testing.assert_allclose(pose.stiffness, [STIFFNESS - gravity], rtol=1e-12)
    both = examine(build(links(2, True, STIFFNESS)), np.zeros(2))
    G2 = MASS * G * LEVER * np.array([[3.0, 1.0], [1.0, 1.0]])  # of two masses, by hand
    np.testing.assert_allclose(both.gravity, np.linalg.eigvalsh(G2)[::-1], rtol=1e-9)  # falling
    np.testing.assert_allclose(both.stiffness, STIFFNESS - np.linalg.eigvalsh(G2)[::-1], rtol=1e-9)
    full = examine(build(links(2, True, 0.0, actuated=(1, 2))), np.zeros(2))
    assert (full.rank, full.stiffness.size, full.dominates) == (2, 0, True)


def test_where_gravity_begins_to_win(monkeypatch: pytest.MonkeyPatch) -> None:
    # hanging at 0; gravity exceeds its spring beyond cos q = -k / m g l
    stiffness = 0.5 * MASS * G * LEVER
    model = build(links(1, False, stiffness))
    weak = examine(model, np.array([3.0]), "up")
    assert not weak.dominates
    limit = find_boundary(model, weak)
    assert limit is not None
    assert limit[1].coordinates[0] == pytest.approx(math.acos(-0.5), abs=3e-3 * 1.01)
    assert not examine(model, limit[1].coordinates).dominates
    looked = []
    monkeypatch.setattr(zero_dynamics, "examine", lambda *a: looked.append(a) or examine(*a))
    for resolution in (0.3, 1e-3, 1e-8):
        looked.clear()
        share, pose = find_boundary(model, weak, resolution) or (0.0, weak)
        assert pose.coordinates == pytest.approx(share * weak.coordinates)
        assert pose.name == "up"
        # from above, and no farther than that
        assert 0 <= share * 3.0 - math.acos(-0.5) <= 3.0 * resolution
        assert len(looked) == 1 + math.ceil(-math.log2(resolution))  # in halves
    assert find_boundary(model, examine(model, np.array([0.1]))) is None
    inverted = build(links(1, True, stiffness))
    assert find_boundary(inverted, examine(inverted, np.array([0.1]))) is None


def test_rank_drops_where_three_cables_meet() -> None:
    found = diagnose(robot("spirob"), 6, seed=0)
    seen = found.poses
    assert [pose.rank for pose in seen] == [2, 2, 2, 3, 3, 3, 3, 3, 3]
    for pose in seen:
        B = robot("spirob").state(pose.coordinates, np.zeros(27)).B
        np.testing.assert_allclose(pose.unactuated @ B, 0.0, atol=1e-5 * np.abs(B).max())
        np.testing.assert_allclose(pose.unactuated @ pose.unactuated.T, np.eye(27 - pose.rank),
                                   atol=1e-12)  # fmt: skip

    assert found.rank_drops == list(seen[:3])
    assert "inputs move 3 of 27 directions" in str(found)
    assert "fewer at 3 of 9 poses" in str(found)


def test_poses_where_gravity_wins_are_counted() -> None:
    limit = 0.5 * MASS * G * LEVER
    found = diagnose(build(links(1, True, limit)), 20)
    # an inverted one's gravity exceeds its spring within arccos k / m g l
    falls = [abs(pose.coordinates[0]) < math.pi / 3 for pose in found.poses]
    assert 0 < sum(falls) < len(falls)
    assert [pose in found.gravity_wins for pose in found.poses] == falls
    assert found.to_dict()["poses_where_gravity_wins"] == sum(falls)
    assert f"gravity wins at {sum(falls)} of {len(falls)} poses" in str(found)


def test_where_the_robot_rests_is_said() -> None:
    found = diagnose(build(links(1, True, 2 * MASS * G * LEVER)), 1)
    assert "rests with its tip at 0.0000 0.0000 0.0000 m under no input" in str(found)
    assert found.to_dict()["equilibrium"] == {"u": [], "tip": [0.0, 0.0, 0.0], "stable": True}
    model = build(links(2, True, 0.5 * MASS * G * LEVER, actuated=(1,)))
    found, there = diagnose(model, 1).to_dict()["equilibrium"], rest(model)
    assert abs(there.y[0]) > 0.1  # it falls to one side
    np.testing.assert_allclose(found["tip"], there.y)
    # a slide without a spring falls to its limit
    slide = (
        links(1, False, STIFFNESS)
        .replace('"revolute"', '"prismatic"')
        .replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>')
        .replace("stiffness", "friction")
    )
    found = diagnose(build(slide), 1)
    there = found.to_dict()["equilibrium"]
    assert there["stable"]
    assert there["tip"] == pytest.approx([0.0, 0.0, -3.0])


def test_not_all_is_well_with_a_robot_that_nothing_stops() -> None:
    wheel = (
        links(1, False, STIFFNESS, actuated=(1,))
        .replace('"revolute"', '"continuous"')
        .replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>')
        .replace(f' stiffness="{STIFFNESS}"', ' friction="0"')
        .replace('iyy="0"', 'iyy="1e-3"')
        .replace('ixx="0"', 'ixx="1e-3"')
        .replace('izz="0"', 'izz="1e-3"')
        .replace('lower="-1" upper="1"/>', 'lower="0.5" upper="1"/>')
    )
    found = diagnose(build(wheel), 1)
    assert found.to_dict()["equilibrium"] is None
    assert "NO equilibrium was found" in str(found)
    assert "nothing looks wrong" not in str(found)


FOLLOWS = '<mimic joint="j1" multiplier="0.5" offset="0.2"/></joint></robot>'


def test_a_robot_with_mimic_joints_is_examined_in_its_free_coordinates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """q₂ = q₁ / 2 + 0.2 of a double pendulum with equal springs: k (1 + 1/4), and two weights."""
    path = write(tmp_path, links(2, False, STIFFNESS).replace("</joint></robot>", FOLLOWS))
    model = softdyn.load(path)
    found = diagnose(model, 3)
    # U = -m g l (2 cos q₁ + cos(1.5 q₁ + 0.2))
    gravity = MASS * G * LEVER * (2 + 1.5**2 * math.cos(0.2))
    assert found.rest.least == pytest.approx(1.25 * STIFFNESS + gravity, rel=1e-9)
    assert found.softest == {"j1": 1.0}
    assert found.to_dict()["nv"] == 1
    text = str(found)
    assert "0 inputs move 0 of 1 directions" in text
    assert "= 0.5 j1 +0.2" in text
    q = found.equilibrium.q[0]
    weight = MASS * G * LEVER * (2 * math.sin(q) + 1.5 * math.sin(1.5 * q + 0.2))
    assert weight + STIFFNESS * (1.25 * q + 0.1) == pytest.approx(0, abs=1e-8)
    assert check.main([str(path)]) == 0
    assert "nothing looks wrong" in capsys.readouterr().out


def test_doubts_about_followers_are_doubts_about_their_leaders() -> None:
    """Limits of a follower are not used, and its leader's damper damps its spring."""
    text = links(2, False, STIFFNESS).replace("</joint></robot>", FOLLOWS)
    j2 = text.index('<joint name="j2"')
    ending = text[j2:].replace('lower="-3" upper="3"', 'lower="1" upper="1"')
    ending = ending.replace('damping="0.1"', "")
    assert suspicious_values(build(text[:j2] + ending).robot) == ()
    loose = suspicious_values(build(text.replace('damping="0.1"', "")).robot)
    assert [line.partition(" has a spring and no damping")[0] for line in loose] == [
        "joint 'j1'", "joint 'j2'",
    ]  # fmt: skip


def test_a_floating_base_is_held(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, WALKER)
    floating, fixed = (diagnose(softdyn.load(path, floating=free), 4) for free in (True, False))
    said, known = floating.to_dict(), fixed.to_dict()
    assert said["floating"]
    assert (said["nv"], said["unactuated"]) == (known["nv"] + 6, known["unactuated"] + 6)
    same = ("rank", "stiffness_at_rest", "weakest", "equilibrium", "softest_unactuated", "poses")
    assert [said[key] for key in same] == [known[key] for key in same]
    assert check.main([str(path), "--floating", "--samples", "2"]) == 0
    text = capsys.readouterr().out
    assert "checked with the base held at its pose in the file: poses and equilibrium" in text
    assert f"softdyn crosscheck {path} --floating" in text
    assert "1 input moves 1 of 2 directions" in text


def test_a_free_body_without_joints_is_checked_as_far_as_it_can_be(tmp_path: Path) -> None:
    path = write(tmp_path, robots.robot("stone", robots.solids("a")))
    found = diagnose(softdyn.load(path, floating=True), 4)
    assert "no joint moves then, so no poses" in str(found)
    assert (found.poses, found.equilibrium, found.doubts) == ((), None, ())
    assert found.to_dict()["rank"] == 0
    with refused("<robot>", "none", by=UrdfError):
        softdyn.load(path)


def test_joints_without_limits_are_tried_half_a_turn_either_way() -> None:
    at_zero, lower, upper = sample_poses(robot("sliding and turning"), 0)
    assert not at_zero.coordinates.any()
    np.testing.assert_allclose(lower.coordinates, [-2, -math.pi, -2, -2])
    np.testing.assert_allclose(upper.coordinates, [2, math.pi, 2, 2])


# -- doubtful numbers ------------------------------------------------------------------------------

SOUND = (CORPUS / "base" / "gripper.urdf").read_text()
DOUBTS = [
    (('xyz="0.03 0 0.02"', 'xyz="300 0 20"'), "lengths in mm"),
    (('lower="-0.5" upper="1.2" effort="10" velocity="3"/><dynamics damping="0.05" friction',
      'lower="-30" upper="70" effort="10" velocity="3"/><dynamics damping="0.05" friction'),
     "limits in degrees"),
    (('lower="0" upper="0.01"', 'lower="0" upper="10"'), "limits in mm"),
    (('lower="0" upper="0.01"', 'lower="0.01" upper="0.01"'), "cannot move"),
    (('lower="0" upper="0.01"', 'lower="0.005" upper="0.01"'), "beyond its limits at q = 0"),
    (('<mass value="0.002"/>', '<mass value="2000"/>'), "masses in grams"),
    (('ixx="1e-7" ixy="0" ixz="0" iyy="1e-7" iyz="0" izz="1e-7"',
      'ixx="100" ixy="0" ixz="0" iyy="100" iyz="0" izz="100"'), "inertia in g mm²"),
    (('ixx="1e-7" ixy="0" ixz="0" iyy="1e-7" iyz="0" izz="1e-7"',
      'ixx="1e-11" ixy="0" ixz="0" iyy="1e-11" iyz="0" izz="1e-11"'), "kg/m³"),
    (('<mass value="0.002"/><inertia ixx="1e-7" ixy="0" ixz="0" iyy="1e-7" iyz="0" izz="1e-7"',
      '<mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"'), "default"),
    (("<springReference>-0.1<", "<springReference>2<"), "rests at 2, beyond its limits"),
    (('<dynamics damping="2"/>', ""), "a spring and no damping"),
    (('gear="50"', 'gear="0"'), "can do nothing"),
    (('gear="-1"', 'gear="1"'), "cables carry a gear < 0"),
    (('lower="0" upper="30"', 'lower="-30" upper="30"'), "may push its cable"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "doubt"), DOUBTS, ids=[doubt for _, doubt in DOUBTS])
def test_what_looks_wrong_is_named(change: tuple[str, str], doubt: str, tmp_path: Path) -> None:
    path = robots.write(tmp_path, SOUND)
    assert suspicious_values(parse(path)) == ()
    assert SOUND.count(change[0]) == 1
    path.write_text(SOUND.replace(*change))
    found = suspicious_values(parse(path))
    assert any(doubt in text for text in found), found


def test_a_robot_of_no_length_has_no_size() -> None:
    """Its tip is at the base; if a joint slides, it moves nevertheless."""
    robot = build(links(1, False, STIFFNESS)).robot
    assert robot.length == 0
    (doubt,) = suspicious_values(robot)
    assert doubt.startswith("the tip 'l1' sits at the base, no joint offset is on the way to it")
    slides = links(1, False, STIFFNESS).replace("revolute", "prismatic").replace('"3"', '"0.3"')
    assert suspicious_values(build(slides.replace('"-3"', '"-0.3"')).robot) == ()


def test_how_dense_a_body_may_be() -> None:
    """A solid ball of density ρ has ρ = m / (4/3 π r³) and moments 2/5 m r²."""
    for density, wrong in ((0.96, True), (1.04, False), (24_000.0, False), (26_000.0, True)):
        mass = density * 4 / 3 * math.pi * 0.05**3
        text = links(1, False, STIFFNESS)
        start, end = text.index("<inertial>"), text.index("</link>", text.index("<inertial>"))
        ball = robots.inertial(mass, f"0 0 {-LEVER}", 0.4 * mass * 0.05**2)
        text = text[:start] + ball + text[end:]
        doubts = suspicious_values(build(text).robot)
        assert any("kg/m³" in found for found in doubts) is wrong, density


def test_a_robot_whose_tip_is_its_only_joint_has_no_length() -> None:
    """The body's centre tells its size, so that its inertia is not called too wide."""

    def doubts(com: float, moment: float) -> tuple[str, ...]:
        return suspicious_values(build(robots.hinge(0.2, f"0 0 {com}", moment)).robot)

    for com in (-0.1, 0):
        (line,) = doubts(com, 1e-4)
        assert line.startswith("the tip 'arm' sits at the base, no joint offset is on the way")
    assert any("the robot is 0.1 m long" in line for line in doubts(-0.1, 0.2))
    assert any("100 m away from its joint" in line for line in doubts(-100, 1e-4))


@pytest.mark.parametrize("name", softdyn.bundled_names())
def test_bundled_robots_look_right(name: str) -> None:
    assert suspicious_values(robot(name).robot) == ()


def test_springs_pulls_and_weight_that_do_not_fit_each_other() -> None:
    """An arm of three sections is plausible; with springs × 0.001 or pulls × 1000 it is not."""
    arm = load_text(design.read(tomllib.loads(THREE_SECTIONS)).text, path=Path("arm.urdf"))
    assert diagnose(arm, 3).doubts == ()
    robot = arm.robot
    soft = tuple(replace(one, stiffness=1e-3 * one.stiffness) for one in robot.joints)
    strong = tuple(replace(one, upper=1e3 * one.upper) for one in robot.actuators)
    found = unbalanced(softdyn.build(replace(robot, joints=soft)))
    assert sum("times the stiffness" in line for line in found) == 1
    pulls = list(unbalanced(softdyn.build(replace(robot, actuators=strong))))
    assert len(pulls) == len(strong)
    assert pulls[0].startswith(f"actuator {strong[0].name!r}: its full pull bends the arm by ")


def test_an_arm_without_inputs_that_gravity_overcomes_everywhere() -> None:
    text = links(1, True, 1e-3).replace('lower="-3" upper="3"', 'lower="-1" upper="1"')
    doubts = diagnose(build(text), 3).doubts
    assert any("gravity wins at all 6 poses, and no input holds" in line for line in doubts)
    hangs = diagnose(build(links(2, False, STIFFNESS)), 3).doubts
    assert not any("gravity wins" in line for line in hangs)


@pytest.mark.parametrize("damping", [0.0, 0.1, 5.0])
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_spring_too_fast_for_the_plant(share: float, damping: float) -> None:
    """k h² reaches 4 m l² + 2 h d, where MuJoCo's own step of 0.5 ms starts to grow."""
    h = 5e-4
    bound = (4 * MASS * LEVER**2 + 2 * h * damping) / h**2
    text = links(1, False, share * bound).replace('damping="0.1"', f'damping="{damping}"')
    model = build(text)
    found = diagnose(model, 1).doubts
    assert any("too fast for plant steps of 0.0005 s" in line for line in found) is (share > 1)
    twin = Twin(model, timestep=h, limits=False)
    twin.data.qpos[0] = 1e-9
    mujoco.mj_step(twin.model, twin.data, 100)
    # the roots z of (m + h d) z² + (h² k - h d - 2 m) z + m have |z| < 1 below the bound only
    assert bool(abs(twin.data.qpos[0]) > 1e-7) is (share > 1)


@pytest.mark.parametrize("segments", [5, 25])
def test_an_arm_of_many_segments_that_its_damping_calms(segments: int) -> None:
    """Its fastest mode is beyond an explicit step, and MuJoCo's damping is implicit."""
    model = load_text(
        design.read(tomllib.loads(MAST.format(modulus=2.0, segments=segments))).text,
        path=Path("mast.urdf"),
    )
    state = model.state(model.q0, np.zeros(model.nv))
    squares = eigvalsh(np.diag(model.stiffness), state.M)
    assert bool(squares[-1] * 5e-4**2 > 4) is (segments > 5)
    assert fast_springs(model, state) is None
    loose = replace(
        model.robot, joints=tuple(replace(j, damping=1e-3 * j.damping) for j in model.robot.joints)
    )
    undamped = softdyn.build(loose)
    said = fast_springs(undamped, undamped.state(undamped.q0, np.zeros(model.nv)))
    assert (said is not None) is (segments > 5)


MAST = """
name = "mast"
unusual = true
[material]
youngs_modulus_MPa = {modulus}
density_kg_m3 = 1100
[[section]]
length_mm = 300
radius_mm = 10
segments = {segments}
[mount]
direction = [0, 0, 1]
[[cable]]
count = 3
offset_mm = 8
routing = "channel"
max_tension_N = 2
"""


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_an_upright_rod_that_falls_under_its_own_weight(share: float) -> None:
    """Greenhill (1881): a rod of length L, radius r stands if E > 4 ρ g L³ / (7.8373 r²)."""
    critical = 4 * 1100 * 9.81 * 0.3**3 / (7.8373 * 0.01**2) / 1e6
    text = design.read(tomllib.loads(MAST.format(modulus=share * critical, segments=12))).text
    found = diagnose(load_text(text, path=Path("mast.urdf")), 3)
    assert (found.least < 0, found.falls) == (share < 1, share < 1)
    assert found.rest.dominates  # in the directions without an input, two of 24 are bends with one
    assert found.to_dict()["stiffness_of_all_directions_at_rest"] == found.least
    assert ("stiffness dominates" in str(found)) is (share > 1)
    assert ("gravity wins unless an input holds the robot" in str(found)) is (share < 1)
    assert found.equilibrium is not None
    assert bool(abs(found.equilibrium.y[:2]).max() > 0.01) is (share < 1)


def test_a_motor_that_has_to_hold_a_pendulum_up() -> None:
    """Two inverted links, ∂(K + g)/∂q = k - m g l [[3, 1], [1, 1]] over all directions."""
    lean = links(2, True, 1.4, actuated=(1,))
    found = diagnose(build(lean), 2)
    least = 1.4 - MASS * G * LEVER * (2 + math.sqrt(2))
    assert found.least == pytest.approx(least)
    assert found.falls
    assert found.rest.dominates


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_robot_below_mujocos_floor_is_named(share: float) -> None:
    """MuJoCo calls an inertia m l² below 1e-15 kg m² singular."""
    assert mujoco.mjMINVAL == FLOOR
    model = build(links(1, False, STIFFNESS).replace(
        f'mass value="{MASS}"', f'mass value="{share * FLOOR / LEVER**2}"'))  # fmt: skip
    (note,) = diagnose(model, 1).notes or ("",)
    assert ("1e-15" in note and "'j1'" in note) is (share < 1)
    twin = Twin(model, limits=False)
    mujoco.mj_forward(twin.model, twin.data)
    warned = twin.data.warning[mujoco.mjtWarning.mjWARN_INERTIA].number
    assert bool(warned) is (share < 1)


def test_a_body_below_mujocos_floor_is_named(tmp_path: Path) -> None:
    text = '"1e-7" ixy="0" ixz="0" iyy="1e-7" iyz="0" izz="1e-7"'
    path = robots.write(tmp_path, SOUND.replace(text, text.replace("1e-7", "1e-17")))
    notes = diagnose(softdyn.load(path), 1).notes
    assert any("1e-17 kg m²" in note for note in notes)


def test_what_no_spring_holds_and_no_actuator_pulls() -> None:
    soft = build(links(2, False, STIFFNESS, actuated=(1,))).robot
    assert not [x for x in suspicious_values(soft) if "springs" in x or "tendon" in x]
    bare = build(links(2, False, 0.0, actuated=(1,))).robot
    (line,) = [x for x in suspicious_values(bare) if "springs" in x]
    assert line.startswith("no springs at all: ")
    assert "--annotations" in line
    idle = replace(soft.tendons[0], name="spare")
    found = suspicious_values(replace(soft, tendons=(*soft.tendons, idle)))
    assert "tendon 'spare' does nothing: no actuator, no stiffness, no damping" in found


def test_a_mesh_in_millimetres(tmp_path: Path) -> None:
    corners = "v 0 0 0\nv 80 0 0\nv 0 10 0\nv 0 0 10\nf 1 2 3\nf 1 2 4\n"
    (tmp_path / "finger.obj").write_text(corners)
    shape = '<visual><geometry><mesh filename="{}" {}/></geometry></visual>'
    path = tmp_path / "chain.urdf"
    for scale, name, found in (
        ("", "finger.obj", (1, 0)),
        ('scale="0.001 0.001 0.001"', "finger.obj", (0, 0)),
        ("", "none.obj", (0, 1)),
    ):
        base = f'<link name="l0">{shape.format(name, scale)}</link>'
        path.write_text(links(1, False, STIFFNESS).replace('<link name="l0"/>', base))
        found_wrong, unreadable = suspicious_shapes(parse(path))
        assert (len(found_wrong), len(unreadable)) == found
        assert all("a mesh in mm" in text for text in found_wrong)
    (tmp_path / "small.obj").write_text(corners.replace("80", "20"))
    two = shape.format("finger.obj", "") + shape.format("small.obj", "")
    path.write_text(
        links(1, False, STIFFNESS).replace('<link name="l0"/>', f'<link name="l0">{two}</link>')
    )
    ((wide,), _) = suspicious_shapes(parse(path))  # the widest of a link counts, in any order
    assert "its mesh is 80 m wide" in wide


# -- the command -----------------------------------------------------------------------------------


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check.main(["finger", "--samples", "3"]) == 0
    text = capsys.readouterr().out
    assert "4 degrees of freedom, 2 inputs" in text
    assert "4 with a spring: 0.01" in text
    assert "2 inputs move 2 of 4 directions" in text
    assert "stiffness dominates" in text
    assert "nothing looks wrong" in text
    path = robots.write(tmp_path, links(2, True, STIFFNESS, actuated=(1,)), "chain.urdf")
    assert check.main([str(path), "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["nv"], report["nu"], report["rank"], report["unactuated"]) == (2, 1, 1, 1)
    assert report["stiffness_at_rest"] == pytest.approx(STIFFNESS - MASS * G * LEVER)
    assert report["dominates_at_rest"]
    assert report["softest_unactuated"] == {"j2": pytest.approx(1.0)}
    path.write_text(SOUND.replace('gear="-1"', 'gear="1"'))
    assert check.main([str(path)]) == 1
    assert "doubtful: actuator 'pull' pushes its cable" in capsys.readouterr().out
    path.write_text("<robot")
    assert check.main([str(path)]) == 2
    assert check.main(["finger", "--floating"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 2)


BASES = sorted((CORPUS / "base").glob("*.urdf"))


@pytest.mark.parametrize("path", BASES, ids=lambda path: path.stem)
def test_the_command_on_all_kinds_of_robots(path: Path) -> None:
    found = diagnose(softdyn.load(path), 3)
    assert f"{found.model.nv} degrees of freedom" in str(found)
    lines = [line for line in str(found).splitlines() if line.startswith("  ")]
    said = dict(line.split(maxsplit=1) for line in lines)
    for tendon in found.model.robot.tendons:
        assert ("elastic" in said[tendon.name]) == bool(tendon.stiffness)
    report = found.to_dict()
    assert report["rank"] + report["unactuated"] == report["nv"]
