"""The shapes of an MJCF in the URDF that is written from it."""

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn.description.urdf import parse
from softdyn.description.visuals import triangles, visuals
from softdyn.validation import Twin
from softdyn.validation.mjcf import export
from tests.support.command import command

BODY = (
    '<mujoco><asset><mesh name="m" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset><worldbody>'
    '<geom name="table" type="box" size="0.2 0.3 0.01" pos="0 0 -0.5"/>'
    '<geom type="plane" size="1 1 1"/>'
    '<body name="a" pos="0.1 0 0.2" euler="20 30 40"><joint name="j" axis="0 1 0"/>'
    '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{}</body></worldbody></mujoco>'
)
SHAPES = (
    '<geom name="g" type="box" size="0.1 0.02 0.03" pos="0 0 -0.1" euler="10 20 30"/>'
    '<geom name="v" size="0.05" contype="0" conaffinity="0" rgba="1 0.5 0 1" pos="0.3 0 0"/>'
    '<geom name="c" type="capsule" size="0.02" fromto="0 0 0 0.1 0.2 0.3" group="3"/>'
    '<geom name="z" type="cylinder" size="0.02 0.1" euler="0 90 0"/>'
)
OTHERS = (
    '<geom type="mesh" mesh="m"/><geom type="mesh" mesh="m" pos="1 0 0"/>'
    '<geom type="ellipsoid" size="0.1 0.2 0.3"/>'
    '<geom size="0.1" contype="0" conaffinity="0" group="4"/>'
)


@pytest.fixture
def files(tmp_path):
    return tmp_path / "robot.xml", tmp_path / "robot.urdf"


def corners(robot, kind):
    """All corners of the shapes at q = 0, in the world, as sorted rows of their extremes."""
    model = softdyn.load(robot)
    twin = Twin(model, limits=False)
    twin.set_state(np.zeros(model.nv), np.zeros(model.nv))
    data, named = twin.data, twin.model
    found = []
    for visual in visuals(parse(robot), (kind,))[0]:
        body = named.body(visual.link).id if visual.link != "world" else 0
        points = triangles(visual).reshape(-1, 3) @ data.xmat[body].reshape(3, 3).T
        points = points + data.xpos[body]
        found.append((points.min(axis=0), points.max(axis=0)))
    return np.array(found)


def test_shapes_are_where_mujoco_shows_them(files):
    source, target = files
    joint = '<joint name="j" axis="0 1 0"'
    source.write_text(BODY.format(SHAPES).replace(joint, f'{joint} pos="0 0.02 0.05"'))
    _, lost = export.write_urdf(source, target)
    assert lost == ("shapes of body 'world': 1 plane",)
    model = mujoco.MjModel.from_xml_path(str(source))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shapes, problems = visuals(parse(target), ("visual",))
    assert not problems
    assert [visual.link for visual in shapes] == ["world", "j_link", "j_link", "j_link"]
    ends = corners(target, "visual")
    for name, row in zip(("table", "g", "v", "z"), (0, 1, 2, 3), strict=True):
        middle = ends[row].mean(axis=0)
        np.testing.assert_allclose(middle, data.geom(name).xpos, atol=1e-3, err_msg=name)
    turn, half = data.geom("g").xmat.reshape(3, 3), np.array([0.1, 0.02, 0.03])
    np.testing.assert_allclose(ends[1][1] - ends[1][0], 2 * np.abs(turn) @ half, atol=1e-9)
    assert shapes[2].rgba == (1.0, 0.5, 0.0, 1.0)
    touching = visuals(parse(target), ("collision",))[0]  # v does not touch, c is 3 pieces
    assert [visual.link for visual in touching] == ["world"] + 5 * ["j_link"]
    a, b = (corners(target, "collision")[k].mean(axis=0) for k in (3, 4))
    c = data.geom("c")
    np.testing.assert_allclose((a + b) / 2, c.xpos, atol=1e-3)
    assert np.linalg.norm(b - a) == pytest.approx(np.linalg.norm([0.1, 0.2, 0.3]), abs=1e-3)


def test_shapes_that_a_urdf_cannot_state_are_lost(files):
    source, target = files
    source.write_text(BODY.format(OTHERS))
    _, lost = export.write_urdf(source, target)
    assert lost == (
        "shapes of body 'world': 1 plane",
        "shapes of body 'a': 2 mesh, 1 ellipsoid, 1 hidden sphere",
    )
    assert "<visual" in target.read_text()  # the table


def test_shapes_are_left_out_where_asked_for_and_a_missing_mesh_costs_only_the_shapes(files):
    source, target = files
    source.write_text(BODY.format(SHAPES))
    code, _, err = command("export", source, "--urdf", target, "--no-shapes")
    assert (code, err) == (0, "")
    assert "visual" not in target.read_text()
    source.write_text(BODY.replace('vertex="0 0 0  1 0 0  0 1 0  0 0 1"', 'file="gone.stl"')
                      .format(SHAPES))  # fmt: skip
    code, _, err = command("export", source, "--urdf", target)
    assert code == 0
    assert err.startswith("lost: all shapes: ")
    assert "gone.stl" in err
    code, _, err = command("export", "finger", "--urdf", target)
    assert "lost: shapes of " in err


def test_shapes_around_a_floating_robot_are_lost(files):
    source, target = files
    text = BODY.format('<geom size="0.1"/>')
    source.write_text(text.replace('<joint name="j" axis="0 1 0"/>', "<freejoint/>"))
    _, lost = export.write_urdf(source, target)
    assert "the shapes around the robot" in lost
    assert "<sphere" in target.read_text()
