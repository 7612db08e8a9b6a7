"""The MuJoCo twin: exact bodies, working switches, errors instead of silent resets."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import UrdfError
from softdyn.validation.twin.twin import SimulationError, Twin
from tests.support import robots
from tests.support.random_robots import write_robot
from tests.support.refused import refused


def urdf(folder: Path, body: str, block: str = "") -> Path:
    """A file with these elements and this <softdyn> block."""
    return robots.write(folder, robots.robot("micro", body, block=block))


def link(name: str, mass: float = 0.0, moments: str = "0 0 0", com: str = "0 0 0") -> str:
    return robots.link(name, mass or None, com, moments)


def joint(name: str, parent: str, child: str, kind: str = "revolute", **place: object) -> str:
    """A joint; revolute and prismatic ones with wide limits."""
    return robots.joint(name, parent, child, kind=kind, **{"limit": (-3, 3), **place})


def mass_matrix(twin: Twin) -> np.ndarray:
    matrix = np.zeros((twin.model.nv,) * 2)
    mujoco.mj_fullM(twin.model, twin.data, matrix)
    return matrix


# -- bodies ------------------------------------------------------------------------------------


def test_point_mass_pendulum_has_the_textbook_inertia(tmp_path):
    body = link("base") + link("bob", 2.0, com="0 0 -0.5") + joint("j", "base", "bob")
    twin = Twin(urdf(tmp_path, body, '<joint name="j" armature="0.25"/>'))
    assert mass_matrix(twin)[0, 0] == 2.0 * 0.5**2 + 0.25
    twin.set_state([0.3], [0.0])
    # turning about +y moves the bob below the origin towards -x; gravity pulls it back
    np.testing.assert_allclose(twin.data.qfrc_bias, 2 * 9.81 * 0.5 * np.sin(0.3), rtol=1e-15)


def test_flat_plate_keeps_its_moments_to_the_last_digit(tmp_path):
    moments = np.array([0.1, 0.2, 0.3])  # 0.1 + 0.2 > 0.3 in doubles, but 0.1 + 0.2 < 0.30000001
    body = link("base") + link("plate", 1.0, "0.1 0.2 0.30000001") + joint("j", "base", "plate")
    twin = Twin(urdf(tmp_path, body))
    np.testing.assert_allclose(np.sort(twin.model.body_inertia[1]), moments, rtol=1e-7)
    assert mass_matrix(twin)[0, 0] == pytest.approx(0.2, rel=1e-15)


def test_massless_link_that_branches(tmp_path):
    body = link("base") + link("hub") + link("a", 1.0, com="0.1 0 0") + link("b", 3.0)
    body += joint("turn", "base", "hub", axis="0 0 1") + joint("ja", "hub", "a", axis="0 0 1")
    body += joint("jb", "hub", "b", axis="1 0 0", kind="prismatic")
    twin = Twin(urdf(tmp_path, body, '<joint name="jb" armature="0.5"/>'))
    twin.set_state([0.0, 0.0, 0.2], [0.0, 0.0, 0.0])
    a, b = 1.0 * 0.1**2, 3.0 * 0.2**2
    expected = [[a + b, a, 0], [a, a, 0], [0, 0, 3.5]]
    np.testing.assert_allclose(mass_matrix(twin), expected, atol=1e-16)
    assert twin.joint_names == ("turn", "ja", "jb")


def test_fixed_links_are_lumped_even_when_one_alone_is_unphysical(tmp_path):
    body = link("base") + link("arm", 1.0, "0.1 0.1 0.1") + joint("j", "base", "arm")
    body += link("odd", 0.0) + link("impossible", 0.5, "-0.01 0.02 0.02", com="0.1 0 0")
    body += joint("f1", "arm", "odd", "fixed", at="0.2 0 0")
    body += joint("f2", "odd", "impossible", "fixed", at="0 0.3 0")
    twin = Twin(urdf(tmp_path, body))
    assert twin.model.nbody == 2
    assert mass_matrix(twin)[0, 0] == pytest.approx(0.1 + 0.02 + 0.5 * 0.3**2, rel=1e-15)


def test_root_of_any_name_with_inertia_and_a_moving_link_called_world(tmp_path):
    body = link("plinth", 50.0, "1 1 1") + link("mount", 5.0, "1 1 1") + link("world", 1.0)
    body += joint("f", "plinth", "mount", "fixed", at="0.1 0.2 0.3")
    body += joint("slide", "mount", "world", "prismatic", axis="0 0 2", at="0 0 0.4")
    twin = Twin(urdf(tmp_path, body, '<task frame="world"/>'))
    assert mass_matrix(twin)[0, 0] == 1.0
    twin.set_state([0.25], [0.0])
    np.testing.assert_allclose(twin.tip, [0.1, 0.2, 0.3 + 0.4 + 0.25], rtol=1e-15)


@pytest.mark.parametrize("seed", range(6))
def test_mass_matrix_and_bias_are_pinocchios(seed, tmp_path):
    path = write_robot(seed, tmp_path)
    twin = Twin(path, limits=False)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    robot = softdyn.parse(path)
    armature = {j.name: j.armature for j in robot.joints}
    model.armature = np.array([armature[name] for name in model.names[1:]])
    order = [twin.joint_names.index(name) for name in model.names[1:]]
    rng = np.random.default_rng(seed)
    qpos, qvel = rng.uniform(-1, 1, (2, model.nv))
    q = pin.integrate(model, pin.neutral(model), qpos[order])
    twin.set_state(qpos, qvel)
    M = pin.crba(model, data, q).copy()
    bias = pin.nonLinearEffects(model, data, q, qvel[order])
    np.testing.assert_allclose(mass_matrix(twin)[np.ix_(order, order)], M, atol=1e-14 * M.max())
    np.testing.assert_allclose(
        twin.data.qfrc_bias[order], bias, atol=1e-13 * max(M.max(), np.abs(bias).max())
    )


# -- annotations -------------------------------------------------------------------------------

ARM = link("base") + link("arm", 1.0, "0.1 0.1 0.1", com="0.2 0 0")


def test_nothing_acts_that_the_file_does_not_name(tmp_path):
    model = Twin(urdf(tmp_path, ARM + joint("j", "base", "arm"))).model
    names = "dof_damping dof_dampingpoly dof_armature dof_frictionloss jnt_stiffness qpos_spring"
    for name in [*names.split(), "jnt_stiffnesspoly", "jnt_margin", "body_gravcomp"]:
        assert not np.any(getattr(model, name)), name
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -9.81])
    assert model.opt.density == model.opt.viscosity == 0
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_spring_damper_and_armature_of_a_joint(tmp_path):
    body = ARM + joint("j", "base", "arm", damping=0.7) + robots.spring("j", 3, 0.5)
    twin = Twin(urdf(tmp_path, body, '<joint name="j" armature="2"/>'), limits=False)
    twin.set_state([0.2], [1.5])
    np.testing.assert_allclose(twin.data.qfrc_spring, 3 * (0.5 - 0.2))
    np.testing.assert_allclose(twin.data.qfrc_damper, -0.7 * 1.5)
    assert mass_matrix(twin)[0, 0] == pytest.approx(0.1 + 0.04 + 2)


@pytest.mark.parametrize(("rest", "expected"), [(-1, -1.0), (None, 0.0), (2, 2.0)])
def test_rest_of_a_fixed_tendon(rest, expected, tmp_path):
    """MuJoCo reads -1 as "the length at the joint springs' rest", which this file does not mean."""
    tendon = robots.cable("t", "j 2", stiffness=4, rest=rest)
    body = ARM + joint("j", "base", "arm") + robots.spring("j", 0.1, 0.5)
    twin = Twin(urdf(tmp_path, body, tendon))
    np.testing.assert_array_equal(twin.model.tendon_lengthspring[0], [expected, expected])
    for q in (-1.0, 1.0):  # it acts both ways
        twin.set_state([q], [0.0])
        force = -4 * (2 * q - expected) * 2 - 0.1 * (q - 0.5)
        np.testing.assert_allclose(twin.data.qfrc_spring, force, rtol=1e-14)


def test_spatial_tendon_rests_at_its_length_at_zero(tmp_path):
    body = ARM + link("hand") + joint("j", "base", "arm")
    body += joint("f", "arm", "hand", "fixed", at="0.4 0 0")
    body += robots.spring("j", 1, 1)
    block = robots.cable("t", "base 0 0 0.3", "hand 0 0 0.3", stiffness=4, damping=0.2)
    block += robots.motor("t", 0, 5, -3)
    twin = Twin(urdf(tmp_path, body, block))
    assert twin.model.tendon_lengthspring[0] == pytest.approx([0.4, 0.4], rel=1e-15)
    assert twin.model.actuator_gear[0, 0] == -3
    np.testing.assert_array_equal(twin.model.actuator_ctrlrange[0], [0, 5])


def test_offsets_below_a_micrometre_count(tmp_path):
    body = link("base") + link("arm", 2.0, "1 1 1", com="3e-07 0 0") + joint("j", "base", "arm")
    twin = Twin(urdf(tmp_path, body, robots.cable("t", "base 0.3 0 0", "arm 3e-07 0 0")))
    twin.set_state([0.0], [0.0])
    assert twin.data.ten_length[0] == pytest.approx(0.3 - 3e-7, rel=1e-15)
    weight = -twin.model.opt.gravity[2] * 2.0
    assert twin.data.qfrc_bias[0] == pytest.approx(-3e-7 * weight, rel=1e-12)


def test_input_is_a_force_along_the_tendon_held_to_its_bounds(tmp_path):
    block = robots.cable("t", "j 2") + robots.motor("t", -1, 4, -3)
    twin = Twin(urdf(tmp_path, ARM + joint("j", "base", "arm"), block))
    for u, force in ((1.5, 1.5), (9.0, 4.0), (-9.0, -1.0)):
        twin.reset()
        twin.advance([u])
        np.testing.assert_allclose(twin.data.qfrc_actuator, 2 * -3 * force)


def test_input_range_and_limits_of_a_single_point(tmp_path):
    block = robots.cable("t", "j 1") + robots.motor("t", 0, 0)
    limit = None, None  # both default to zero
    twin = Twin(urdf(tmp_path, ARM + joint("j", "base", "arm", limit=limit), block))
    twin.advance([0.0], 1000)
    assert abs(twin.qpos[0]) < 1e-4


# -- switches ----------------------------------------------------------------------------------


def test_helix_hangs_on_its_stops_only_with_limits():
    robot = softdyn.load("helix")
    slides = [n for n in robot.joint_names if n.startswith("comp")]
    sunk = {}
    for limits in (True, False):
        twin = Twin(robot, limits=limits)
        twin.advance(np.zeros(9), 2000)
        where = [twin.joint_names.index(name) for name in slides]
        sunk[limits] = -0.001 - twin.qpos[where].min()
    assert 0 < sunk[True] < 5e-5
    assert sunk[False] > 5e-3


def test_dry_friction_holds_an_arm_only_when_on(tmp_path):
    body = ARM + joint("j", "base", "arm", inside='<dynamics friction="5"/>')
    held, free = (Twin(urdf(tmp_path, body), friction=on) for on in (True, False))
    for twin in (held, free):
        twin.advance([], 200)
    assert abs(held.qpos[0]) < 1e-3 < 0.01 < abs(free.qpos[0])


def ball(name: str, size: str = '<sphere radius="0.06"/>') -> str:
    return robots.link(name, 1, None, 0.1, f"<collision><geometry>{size}</geometry></collision>")


def test_links_touch_only_with_contacts_and_neighbours_never(tmp_path):
    body = ball("base", '<box size="0.1 0.1 0.1"/>') + ball("a") + link("hub") + ball("b")
    body += ball("c", '<cylinder radius="0.06" length="0.1"/>')
    body += joint("ja", "base", "a", at="0.1 0 0") + joint("jh", "a", "hub", at="0 0.1 0")
    body += joint("jb", "hub", "b", axis="1 0 0") + joint("jc", "b", "c", at="-0.1 0 0")
    on, off = (Twin(urdf(tmp_path, body), contacts=contacts) for contacts in (True, False))
    touching = {
        frozenset(on.model.body(on.model.geom_bodyid[geom]).name for geom in contact.geom)
        for contact in on.data.contact
    }
    assert touching == {frozenset(("world", "c"))}  # though a overlaps both the base and b
    assert off.data.ncon == 0
    assert on.skipped == off.skipped == ()


def test_collision_meshes_are_skipped_and_reported(tmp_path):
    body = link("base") + ball("a", '<mesh filename="/etc/passwd"/>') + joint("j", "base", "a")
    body += ball("b", '<box size="0.1 0 0.1"/>') + joint("k", "a", "b")
    twin = Twin(urdf(tmp_path, body), contacts=True)
    assert twin.model.ngeom == 0
    assert len(twin.skipped) == 2
    assert "'a': mesh" in twin.skipped[0]
    assert "without extent" in twin.skipped[1]


@pytest.mark.parametrize("name", ["implicitfast", "implicit", "euler", "rk4"])
def test_integrators_follow_a_pendulum(name, tmp_path):
    twin = Twin(urdf(tmp_path, ARM + joint("j", "base", "arm")), timestep=1e-4, integrator=name)
    twin.set_state([math.pi / 2], [0.1])  # near the lower equilibrium: the arm points down
    twin.advance([], 100)
    rate = math.sqrt(9.81 * 0.2 / 0.14)
    swing = 0.1 / rate * math.sin(rate * twin.time)
    assert twin.time == pytest.approx(0.01)
    assert twin.qpos[0] - math.pi / 2 == pytest.approx(swing, rel=1e-2)


# -- state and errors --------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e11])
def test_a_bad_state_is_an_error_not_a_reset(bad):
    twin = Twin("finger")
    for place, state in (
        ("qpos", ([bad, 0, 0, 0], np.zeros(4))), ("qvel", (np.zeros(4), [0, 0, 0, bad])),
    ):  # fmt: skip
        with refused(place):
            twin.set_state(*state)
    with refused("qpos", "shape (5,)"):
        twin.set_state(np.zeros(5), np.zeros(4))


@pytest.mark.parametrize("bad", [[math.nan, 0], [0], [0, 0, 0], "up"])
def test_a_bad_input_is_an_error(bad):
    with refused("u"):
        Twin("finger").advance(bad)


def test_a_blow_up_is_an_exception_with_time_and_reason(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    twin = Twin("finger", integrator="rk4", timestep=5e-3)  # far beyond RK4's stability
    twin.set_state(np.full(4, 0.1), np.ones(4))
    with pytest.raises(SimulationError, match=r"t = .* s: .*finite") as caught:
        twin.advance(np.zeros(2), 1000)
    assert 0 < caught.value.time <= 5
    assert caught.value.time == twin.time  # not reset
    assert "finite" in caught.value.reason
    assert not list(tmp_path.glob("MUJOCO_LOG*"))
    assert capfd.readouterr().err == ""
    twin.reset()
    twin.advance(np.zeros(2))


def test_mujoco_neither_prints_nor_writes_a_file(tmp_path, monkeypatch, capfd):
    """By default it writes a line to stderr and MUJOCO_LOG.TXT into the working directory."""
    monkeypatch.chdir(tmp_path)
    twin = Twin("finger")
    twin.data.qpos[0] = math.nan
    mujoco.mj_step(twin.model, twin.data)
    assert twin.data.warning.number.any()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_set_state_is_all_there_is_to_a_state():
    """Two rollouts from one state are equal bit by bit, whatever ran in between."""
    twin = Twin("helix")
    start = np.linspace(-0.01, 0.01, 36), np.zeros(36)
    ends = []
    for _ in range(2):
        twin.set_state(*start, time=3.0)
        assert twin.time == 3.0
        twin.advance(np.full(9, 2.0), 50)
        ends.append(twin.qpos)
    np.testing.assert_array_equal(*ends)


def test_tip_is_that_of_the_new_state():
    twin = Twin("finger")
    twin.advance([1.0, -1.0], 20)
    tip = twin.tip
    twin.set_state(twin.qpos, twin.qvel)
    np.testing.assert_array_equal(tip, twin.tip)


def test_bad_arguments():
    with refused("integrator"):
        Twin("finger", integrator="verlet")
    with refused("timestep"):
        Twin("finger", timestep=0.0)
    with refused("robot"):
        Twin("no_such_robot")


@pytest.mark.parametrize("size", ['radius="x" length="1"', 'radius="1"', 'radius="inf" length="1"'])
def test_a_faulty_capsule_is_named(size, tmp_path):
    body = link("base") + "\n" + ball("a", f"<capsule {size}/>") + joint("j", "base", "a")
    with refused('<link name="a"><collision><geometry><capsule>', by=UrdfError) as caught:
        Twin(urdf(tmp_path, body))
    text = caught.value.file.read_text().splitlines()[caught.value.line - 1]
    assert '<link name="a">' in text
    assert caught.value.element == '<link name="a"><collision><geometry><capsule>'


def test_capsules(tmp_path):
    """MuJoCo's sizes are the radius and half of the cylinder's length; without one it is a ball."""
    body = link("base") + ball("a", '<capsule radius="0.02" length="0.3"/>')
    body += ball("b", '<capsule radius="0.05" length="0"/>') + ball("c", "<x/>")
    body += joint("j", "base", "a") + joint("k", "a", "b") + joint("l", "b", "c")
    twin = Twin(urdf(tmp_path, body), contacts=True)
    kinds = mujoco.mjtGeom
    assert twin.model.geom_type.tolist() == [kinds.mjGEOM_CAPSULE, kinds.mjGEOM_SPHERE]
    assert twin.model.geom_size.tolist() == [[0.02, 0.15, 0.0], [0.05, 0.0, 0.0]]
    (skipped,) = twin.skipped
    place, _, reason = skipped.partition(": ")
    assert place.startswith(str(tmp_path))
    assert place.rpartition(":")[2].isdigit()
    assert reason == "collision shape of link 'c': x is not supported"


def test_collision_shapes_have_their_size(tmp_path):
    """MuJoCo's sizes are half lengths, except radii."""
    shapes = (
        '<cylinder radius="0.02" length="0.3"/>',
        '<box size="0.1 0.2 0.4"/>',
        '<sphere radius="0.07"/>',
    )
    collisions = "".join(f"<collision><geometry>{x}</geometry></collision>" for x in shapes)
    body = link("base") + robots.link("a", 1, None, 1, collisions)
    twin = Twin(urdf(tmp_path, body + joint("j", "base", "a", "continuous")))
    sizes = {tuple(size) for size in twin.model.geom_size.tolist()}
    assert sizes == {(0.02, 0.15, 0.0), (0.05, 0.1, 0.2), (0.07, 0.0, 0.0)}
