"""A robot written in the other format is the same robot."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import UrdfError
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.validation import Twin, compare
from softdyn.validation.mjcf import export, to_mjcf
from softdyn.validation.mjcf.comparison.side import neutral
from softdyn.validation.mjcf.to_urdf import to_urdf
from tests.support import pair_robots, robots
from tests.support.command import command
from tests.support.wrapped_robots import wrapped_robot


@pytest.mark.parametrize("name", ["finger", "helix", "spirob"])
def test_mujoco_loads_the_twin_and_steps_to_the_same(tmp_path, name):
    path = tmp_path / "out.xml"
    touching = name == "spirob"
    result, _ = export.write_mjcf(name, path, shapes=touching, contacts=touching)
    assert result.passed, str(result)
    assert max(result.waterfall[0].left.values()) < 1e-10
    model = mujoco.MjModel.from_xml_path(str(path))
    twin = Twin(name, friction=True, contacts=touching)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    np.testing.assert_array_equal(data.qpos, 0.0)
    names = [model.joint(k).name for k in range(model.njnt)]
    order = [names.index(joint) for joint in twin.joint_names]
    part = np.linspace(0.1, 0.4, model.nu)
    u = np.array(
        [a.lower + p * (a.upper - a.lower) for p, a in zip(part, twin.robot.actuators, strict=True)]
    )
    touched = 0
    for _ in range(400):
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
        twin.advance(u)
        assert data.ncon == twin.data.ncon
        touched += data.ncon
    assert (touched > 0) == touching
    assert np.abs(data.qpos[order]).max() > 1e-3
    np.testing.assert_allclose(data.qpos[order], twin.qpos, atol=1e-8)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.site("task").xpos, twin.tip, atol=1e-8)


@pytest.mark.parametrize("contacts", [False, True])
def test_a_file_has_only_the_options_that_its_motion_needs(tmp_path, contacts):
    """MuJoCo Warp refuses a file with `autoreset`, for example."""
    path = tmp_path / "out.xml"
    export.write_mjcf("helix", path, contacts=contacts)
    option, plain = mujoco.MjModel.from_xml_path(str(path)).opt, mujoco.MjOption()
    own = {"timestep", "integrator", "cone" if contacts else "disableflags"}
    names = [name for name in dir(plain) if not name.startswith("_")]
    fields = [name for name in names if not callable(getattr(plain, name))]
    differ = {n for n in fields if np.any(getattr(option, n) != getattr(plain, n))}
    assert differ == own
    assert option.disableflags == (0 if contacts else mujoco.mjtDisableBit.mjDSBL_CONTACT)
    text = path.read_text()
    assert not [word for word in ("<light", "<visual", "<statistic", "energy") if word in text]


def test_massless_chains_are_several_joints_of_one_body(tmp_path):
    path = tmp_path / "out.xml"
    export.write_mjcf("spirob", path, shapes=False)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.nbody - 1, model.nv) == (9, 27)
    assert model.body_mass[1:].min() > 1e-4


@pytest.mark.parametrize("text", [robots.GRIPPER, robots.WALKER, pair_robots.URDF])
def test_round_trip(tmp_path, text):
    floating = text is robots.WALKER
    source = robots.write(tmp_path, text)
    there, back = tmp_path / "there.xml", tmp_path / "back.urdf"
    result, _ = export.write_mjcf(source, there, floating=floating)
    assert result.passed, str(result)
    result, lost = export.write_urdf(there, back)
    assert result.passed, str(result)
    assert bool(lost) == floating  # which no URDF can say
    for a, b in ((source, there), (there, back), (source, back)):
        result = compare(a, b)
        assert result.passed, str(result)
        assert not {cause.kind for cause in result.causes} - {"limit", "effort", "frame"}
    softdyn.load(back, floating=floating)


@pytest.mark.parametrize("name", ["finger", "spirob", "pair", "gripper", "walker"])
def test_a_converted_robot_is_written_as_it_is(tmp_path, name):
    """No number changes between conversion and loading."""
    path = tmp_path / "robot.xml"
    if name == "pair":
        path.write_text(pair_robots.MJCF)
    else:
        texts = {"gripper": robots.GRIPPER, "walker": robots.WALKER}
        source = robots.write(tmp_path, texts[name]) if name in texts else name
        export.write_mjcf(source, path, floating=name == "walker")
    robot = to_urdf(neutral(path), name).robot
    assert parse_text(write(robot), path=path, floating=robot.floating) == robot
    assert robot.floating == (name == "walker")


def test_what_a_urdf_cannot_say_is_listed(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><option gravity="0 0 -3"/><worldbody><body><joint name="b" type="ball"/>'
        '<geom size="0.1"/><body pos="0 0 1"><joint name="h"/><geom size="0.1"/></body></body>'
        '</worldbody><actuator><position name="servo" joint="h" kp="3"/>'
        '<motor name="m" joint="h" ctrllimited="true" ctrlrange="-1 2" gear="3"/></actuator>'
        "</mujoco>"
    )
    _, lost = export.write_urdf(path, tmp_path / "out.urdf")
    said = "\n".join(lost)
    for word in ("ball joint 'b'", "'servo'"):
        assert word in said
    model = softdyn.load(tmp_path / "out.urdf")
    assert model.robot.gravity == (0, 0, -3)
    assert (model.nv, model.nu) == (4, 1)
    state = model.state(model.q0, np.zeros(4))
    assert state.B.ravel().tolist() == [0.0, 0.0, 0.0, 3.0]
    assert [part.name for part in neutral(tmp_path / "out.urdf").parts] == ["b", "h"]


def test_an_inertia_that_no_body_has_becomes_the_nearest_one(tmp_path):
    """MuJoCo refuses a + b < c, so a violation by the last digit is repaired and reported."""
    moments = np.array([1e-3, 2e-3, 3e-3 + 3e-12])
    found = to_mjcf.possible(moments)
    np.testing.assert_allclose(found - moments, [1e-12, 1e-12, -1e-12], rtol=1e-3)
    assert found[0] + found[1] >= found[2]
    _, lost = one_hinge(tmp_path, ixx=1e-3, iyy=2e-3, izz=3.000000003e-3)
    assert ["a + b < c by 1.0e-09 c" in note for note in lost] == [True]
    assert not one_hinge(tmp_path, iyy=1e-18, izz=3e-18)[1]  # a point


def test_an_inertia_that_is_hardly_turned_stays_turned(tmp_path):
    """MuJoCo's compiler merges frames that differ by less than 1e-6."""
    for turn in ("ixy", "ixz", "iyz"):  # one of these has axes along the frame's axes
        for product in (4e-10, -4e-10):
            result, lost = one_hinge(tmp_path, ixx=1e-3, iyy=2e-3, izz=2.5e-3, **{turn: product})
            assert not lost
            assert result.waterfall[0].left["M"] < 1e-14


def one_hinge(folder, **moments):
    """Export a hinge about an oblique axis; MuJoCo must load it."""
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    words = " ".join(str(moments.get(name, 0)) for name in names)
    source = robots.write(folder, robots.hinge(1, None, words, axis="0.6 0.48 0.64"))
    found = export.write_mjcf(source, folder / "out.xml")
    assert mujoco.MjModel.from_xml_path(str(folder / "out.xml")).nv == 1
    return found


def test_a_motor_on_a_joint_comes_through(tmp_path):
    path = tmp_path / "motor.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="h" range="-1 1"/><geom size="0.1"/></body>'
        '</worldbody><actuator><motor name="m" joint="h" ctrlrange="-1 2" gear="3"/></actuator>'
        "</mujoco>"
    )
    result, lost = export.write_urdf(path, tmp_path / "out.urdf")
    assert result.passed, str(result)
    assert not result.causes
    assert not lost


def test_a_fixed_tendon_whose_rest_is_minus_one(tmp_path):
    """MuJoCo reads a springlength of -1 as the length at rest."""
    source = robots.write(tmp_path, robots.GRIPPER.replace('name="band"', 'name="band" rest="-1"'))
    result, lost = export.write_mjcf(source, tmp_path / "out.xml")
    assert result.passed, str(result)
    assert not lost
    assert neutral(tmp_path / "out.xml").cables[0].rest == pytest.approx((-1.0, -1.0), abs=1e-15)


def test_the_command(tmp_path):
    code, out, err = command("export", "finger", "--mjcf", "out.xml", cwd=tmp_path)
    assert (code, err) == (0, "")
    assert "agree" in out
    code, _, err = command("export", "out.xml", "--urdf", "out.xml", cwd=tmp_path)
    assert code == 2
    assert err == "error: out.xml: expected a file that this command does not read, got its input\n"
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml")).nv == 4


CHAIN = """
<mujoco><compiler angle="radian"/><worldbody>
  <body><joint name="a" range="-1 1"/><geom size="0.1"/>
    <body pos="0 0 1"><joint name="b" range="-1 1"/><geom size="0.1"/>
      <body pos="0 0 1"><joint name="c" range="-1 1"/><geom size="0.1"/></body></body></body>
</worldbody>
<tendon><fixed name="t" stiffness="5" springlength="0.1 0.3"><joint joint="a" coef="1"/></fixed>
</tendon>
<equality><joint joint1="b" joint2="a" polycoef="0 2 0 0 0"/>
  <joint joint1="c" joint2="b" polycoef="0.1 3 0 0 0"/></equality></mujoco>
"""


def test_a_follower_of_a_follower_and_a_slack_tendon_are_told(tmp_path):
    """A URDF's mimic follows a joint that moves by itself, and its tendon springs act both ways."""
    (tmp_path / "chain.xml").write_text(CHAIN)
    _, lost = export.write_urdf(tmp_path / "chain.xml", tmp_path / "chain.urdf")
    assert sorted(lost) == [
        "tendon 't': that its spring is slack between two lengths",
        "that 'c' follows 'b', which follows another joint",
    ]
    robot = softdyn.load(tmp_path / "chain.urdf").robot
    followed = {joint.name: joint.mimic and joint.mimic.leader for joint in robot.moving_joints}
    assert followed == {"a": None, "b": "a", "c": None}
    assert robot.tendons[0].rest == 0.3  # from there on it pulls


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_cables_around_round_bodies_survive_both_ways(tmp_path, seed):
    path, there, back = (tmp_path / name for name in ("a.urdf", "b.xml", "c.urdf"))
    path.write_text(write(wrapped_robot(seed, 2)))
    result, lost = export.write_mjcf(path, there)
    assert result.passed, str(result)
    assert not lost
    result, lost = export.write_urdf(there, back)
    assert result.passed, str(result)
    assert not lost
    model, again = softdyn.load(path), softdyn.load(back)
    engine = mujoco.MjModel.from_xml_path(str(there))
    data, q = mujoco.MjData(engine), np.random.default_rng(seed).uniform(-0.5, 0.5, model.nv)
    data.qpos[[engine.joint(name).qposadr[0] for name in model.joint_names]] = q
    mujoco.mj_forward(engine, data)
    for each in (model, again):
        turned = np.zeros(each.nv)
        turned[[each.joint_names.index(name) for name in model.joint_names]] = q
        lengths = each.tendon_lengths(each.configuration(turned))
        np.testing.assert_allclose(lengths, data.ten_length, atol=1e-12)


DRUM = """\
<mujoco><compiler autolimits="true"/><worldbody><site name="a" pos="-0.2 0 -0.1"/>
<geom name="drum" type="cylinder" size="0.03 0.1" zaxis="0 1 0" contype="0" conaffinity="0"/>
<body name="load" pos="0.2 0 -0.1"><joint name="lift" type="slide" axis="0 0 1" range="-1 1"/>
<geom size="0.01"/><site name="b"/><site name="side" pos="-0.2 0.04 0.15"/></body></worldbody>
<tendon><spatial name="rope"><site site="a"/><geom geom="drum" sidesite="side"/><site site="b"/>
</spatial></tendon></mujoco>"""


def test_what_a_urdf_cannot_say_of_a_wrapped_shape(tmp_path):
    """The side site is on another link; on the right link it is kept."""
    source, target = tmp_path / "drum.xml", tmp_path / "drum.urdf"
    source.write_text(DRUM)
    _, lost = export.write_urdf(source, target)
    assert "tendon 'rope': a side site on another link" in lost
    (wrap,) = softdyn.load(target).robot.tendons[0].wraps
    assert (wrap.side, wrap.radius) == (None, 0.03)
    site = '<site name="side" pos="-0.2 0.04 0.15"/>'
    fixed = '<site name="side" pos="0 0 0.05"/><geom name'
    source.write_text(DRUM.replace(site, "").replace("<geom name", fixed))
    _, lost = export.write_urdf(source, target)
    assert not [line for line in lost if "rope" in line]
    assert softdyn.load(target).robot.tendons[0].wraps[0].side == (0.0, 0.0, 0.05)
    other = tmp_path / "other.urdf"
    other.write_text(target.read_text().replace('radius="0.03" side', 'radius="0.031" side'))
    (cause,) = compare(target, other).causes
    assert (cause.kind, cause.where, cause.detail) == ("tendon", "rope", "around other shapes")


def test_a_site_on_the_surface_is_wrapped_by_mujoco_too(tmp_path):
    robot = wrapped_robot(7, 2)
    tendon = robot.tendons[-1]
    wrap = tendon.wraps[0]
    away = np.cross(wrap.direction, [0.6, 0.8, 0.0])
    on = wrap.xyz + wrap.radius * away / np.linalg.norm(away)
    sites = list(tendon.sites)
    sites[wrap.after] = replace(sites[wrap.after], link=wrap.link, xyz=tuple(on.tolist()))
    model = softdyn.build(
        replace(robot, tendons=(*robot.tendons[:-1], replace(tendon, sites=tuple(sites))))
    )
    path = tmp_path / "on.xml"
    (tmp_path / "on.urdf").write_text(write(model.robot))
    export.write_mjcf(tmp_path / "on.urdf", path)
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = rng.uniform(-0.5, 0.5, model.nv)
        data.qpos[[engine.joint(name).qposadr[0] for name in model.joint_names]] = q
        mujoco.mj_forward(engine, data)
        lengths = model.tendon_lengths(model.configuration(q))
        np.testing.assert_allclose(lengths, data.ten_length, atol=1e-10)


def test_a_muscle_and_odd_inertias_of_an_mjcf_are_named(tmp_path):
    path, body = tmp_path / "robot.xml", '<body><joint name="h"/><inertial pos="0 0 1" {}/></body>'
    text = "<mujoco><worldbody>{}</worldbody>{}</mujoco>"
    muscle = '<actuator><muscle name="biceps" joint="h" lengthrange="0 1"/></actuator>'
    path.write_text(text.format(body.format('mass="1" diaginertia="1 1 1"'), muscle))
    result, lost = export.write_urdf(path, tmp_path / "out.urdf")
    assert not result.passed
    assert any("'biceps'" in one and "muscle" in one for one in lost)
    for inertia, word in (
        ('mass="1" fullinertia="2 0.1 0.2 2.5 0 3"', "xx yy zz"),
        ('mass="1" diaginertia="1e-17 1e-17 1e-17"', "1e-15"),
    ):
        path.write_text(text.format(body.format(inertia), ""))
        with pytest.raises(UrdfError) as error:
            neutral(path)
        assert word in str(error.value)
