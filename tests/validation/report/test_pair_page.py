"""The page of two files: poses equal MuJoCo's, differences are coloured, no network."""

import json
import re

import mujoco
import numpy as np
from lxml import etree

from softdyn.commands import compare as command
from softdyn.validation import compare
from softdyn.validation.mjcf.comparison.dynamics import States
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.report.drawing import RobotDrawing
from softdyn.validation.report.pair_page import ALONE, DIFFERS, PLAIN, VALUES, pair_page
from tests.support import ROOT, pair_robots
from tests.support.terms import forward_kinematics

SCENE = ROOT / "docs/examples/finger_scene.xml"
BALLS = """<mujoco><worldbody><body name="a" pos="1 2 3" euler="10 20 30">
  <freejoint/><geom type="ellipsoid" size="0.1 0.2 0.3" pos="0.1 0.2 0.3"/>
  <body pos="0.3 0.2 0.1" euler="40 0 10"><joint type="ball" pos="0.1 0 0"/>
    <geom type="capsule" fromto="0 0 0 0.3 0.1 0.2" size="0.02"/></body>
  </body></worldbody></mujoco>"""


def posed(data: dict, row: np.ndarray) -> list[np.ndarray]:
    """Shapes (4, 4) in the world, as the page poses them."""
    links = {0: np.eye(4)}
    for joint in data["joints"]:
        move, value, axis = np.eye(4), row[joint["index"]], np.array(joint["axis"])
        if joint["slides"]:
            move[:3, 3] = value * axis
        else:
            quat, turned = np.zeros(4), np.zeros(9)
            mujoco.mju_axisAngle2Quat(quat, axis, value)
            mujoco.mju_quat2Mat(turned, quat)
            move[:3, :3] = turned.reshape(3, 3)
        fixed = np.reshape(joint["pose"], (4, 4)).T
        links[joint["child"]] = links[joint["parent"]] @ fixed @ move
    return [links[s["link"]] @ np.reshape(s["pose"], (4, 4)).T for s in data["shapes"]]


def test_hinges_and_slides_stand_where_mujoco_has_them(tmp_path):
    root = etree.fromstring(pair_robots.MJCF)
    for k, body in enumerate(root.iter("body")):
        etree.SubElement(body, "geom", type="box", size="0.1 0.1 0.1", pos=f"{k} 0.2 0.3")
    file = tmp_path / "pair.xml"
    file.write_bytes(etree.tostring(root))
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qpos[:] = q = [0.3, -0.7, 0.1]
    mujoco.mj_kinematics(model, data)
    drawing = RobotDrawing.of(Side(file))
    names = [part.name for part in drawing.robot.parts]
    row = drawing.coordinates({name: [x] for name, x in zip(names, q, strict=True)})
    shapes = posed(drawing.data, row)
    assert np.allclose([pose[:3, 3] for pose in shapes], data.geom_xpos, atol=1e-8)
    turned = data.geom_xmat.reshape(-1, 3, 3)
    assert np.allclose([pose[:3, :3] for pose in shapes], turned, atol=1e-8)


def test_balls_and_free_bodies_turn_as_in_the_neutral_form(tmp_path):
    file = tmp_path / "balls.xml"
    file.write_text(BALLS)
    drawing = RobotDrawing.of(Side(file))
    robot = drawing.robot
    q = ([0.1, -0.2, 0.3, 0.5, -0.8, 0.4], [0.9, 0.2, -0.6])
    row = drawing.coordinates({p.name: v for p, v in zip(robot.parts, q, strict=True)})
    states = States(tuple(np.array([v]) for v in q), np.zeros((1, robot.nv)))
    there = forward_kinematics(robot, states)
    for (part, shape), pose in zip(drawing.shapes, posed(drawing.data, row), strict=True):
        wanted = there.point(part, shape.pose[:3, 3])[0]
        assert np.allclose(pose[:3, 3], wanted, atol=1e-8)
        assert np.allclose(pose[:3, :3], there.rotation[part, 0] @ shape.pose[:3, :3], atol=1e-8)
    rest = drawing.coordinates({})  # at its place in the file
    assert np.allclose(rest[:3], [1, 2, 3])


def scene_of(text: str) -> dict:
    return json.loads(re.search(r'id="scene">(.*?)</script>', text, re.DOTALL)[1])


def colours(figure: dict) -> dict[tuple, set]:
    found: dict[tuple, set] = {}
    for shape in figure["shapes"]:
        found.setdefault(tuple(shape["rgba"]), set()).add(shape["link"])
    return found


def test_the_page_of_a_pair(tmp_path, capsys):
    target = tmp_path / "pair.html"
    assert command.main(["finger", str(SCENE), "--html", str(target)]) == 1
    capsys.readouterr()
    text = target.read_text()
    assert not re.search(r'(src|href)="(?!data:)', text)  # no external resource
    scene = scene_of(text)
    assert [run["title"] for run in scene["runs"]] == ["side by side", "in one place"]
    assert ["axis", "joint4 reversed"] in scene["rows"]
    ours, theirs = map(colours, scene["figures"])
    assert ours[DIFFERS] == {4}
    assert set(ours) == {DIFFERS, PLAIN}
    assert set(theirs) == {DIFFERS, PLAIN, ALONE}  # the block
    assert len(theirs[DIFFERS]) == 1
    notes = scene["runs"][0]["notes"]
    assert notes[0][1] == "zero"
    assert "M " in notes[1][1]


def test_values_that_move_nothing_have_a_colour_of_their_own_and_sticks_stand_for_shapes(tmp_path):
    (tmp_path / "pair.urdf").write_text(pair_robots.URDF)
    (tmp_path / "pair.xml").write_text(pair_robots.MJCF.replace('damping="0.3"', 'damping="0.4"'))
    files = Side(tmp_path / "pair.urdf"), Side(tmp_path / "pair.xml")
    page = pair_page(*files, compare(*files))
    found = [colours(figure.data) for figure in page.figures]
    assert [set(paint) for paint in found] == [{VALUES, PLAIN}] * 2
    # they agree in M, g and tips, so only the zero pose is shown
    assert len(page.runs[0].tracks[0].frames) == 1
    assert page.figures[0].data["cables"][0]["name"] == "cable"


def test_a_file_whose_meshes_are_gone_is_drawn_as_sticks(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(
        '<mujoco><asset><mesh name="m" file="m.stl"/></asset><worldbody><body><joint name="j"/>'
        '<inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body>'
        "</worldbody></mujoco>"
    )
    drawing = RobotDrawing.of(Side(file))
    assert "expected a mesh to read" in drawing.problem
    assert len(drawing.shapes) == 2
