"""The page of two files: poses equal MuJoCo's, differences are coloured, no network."""

import json
import re

import mujoco
import numpy as np
import pytest
from lxml import etree

from softdyn.commands import compare as command
from softdyn.description.urdf_writer import write
from softdyn.validation import compare
from softdyn.validation.mjcf import export
from softdyn.validation.mjcf.comparison.dynamics import States
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.report.drawing import RobotDrawing
from softdyn.validation.report.pair_page import ALONE, DIFFERS, PLAIN, VALUES, pair_page
from softdyn.view.scene import Figure
from tests.support import ROOT, pair_robots
from tests.support.command import command as shell
from tests.support.neutral_terms import forward_kinematics
from tests.support.wrapped_robots import wrapped_robot

SCENE = ROOT / "docs/examples/finger_scene.xml"
BALLS = """<mujoco><worldbody><body name="a" pos="1 2 3" euler="10 20 30">
  <freejoint/><geom type="ellipsoid" size="0.1 0.2 0.3" pos="0.1 0.2 0.3"/>
  <body pos="0.3 0.2 0.1" euler="40 0 10"><joint type="ball" pos="0.1 0 0"/>
    <geom type="capsule" fromto="0 0 0 0.3 0.1 0.2" size="0.02"/></body>
  </body></worldbody></mujoco>"""


def posed(data: dict, row: np.ndarray) -> list[np.ndarray]:
    """Shapes (4, 4) in the world, as the page poses them."""
    links = links_of(data, row)
    return [links[s["link"]] @ np.reshape(s["pose"], (4, 4)).T for s in data["shapes"]]


def links_of(data: dict, row: np.ndarray) -> dict[int, np.ndarray]:
    """Links (4, 4) in the world, as the page poses them."""
    links = {0: np.eye(4)}
    for joint in data["joints"]:
        move, axis = np.eye(4), np.array(joint["axis"])
        value = row[joint["index"]] if joint["index"] >= 0 else 0.0
        if joint["slides"]:
            move[:3, 3] = value * axis
        else:
            quat, turned = np.zeros(4), np.zeros(9)
            mujoco.mju_axisAngle2Quat(quat, axis, value)
            mujoco.mju_quat2Mat(turned, quat)
            move[:3, :3] = turned.reshape(3, 3)
        fixed = np.reshape(joint["pose"], (4, 4)).T
        links[joint["child"]] = links[joint["parent"]] @ fixed @ move
    return links


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
    fourth = {joint["child"] for joint in scene["figures"][0]["joints"] if joint["index"] == 3}
    assert ours[DIFFERS] == fourth
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


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A soft arm as `softdyn new` writes it."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    assert shell("new", ROOT / "docs/examples/three_sections.toml", "--out", path).code == 0
    return path


def page_of(one, other):
    sides = Side(one), Side(other)
    return pair_page(*sides, compare(*sides, samples=1))


def test_an_arm_of_new_has_its_skin_and_its_cables_as_in_view(arm, tmp_path):
    """Each of its links has a ring of the skin, and its cables are those that `view` draws."""
    export.write_mjcf(arm, tmp_path / "arm.xml")
    ours, theirs = (figure.data for figure in page_of(arm, tmp_path / "arm.xml").figures)
    view = Figure.of(Side(arm).model).data
    ringed = [{ring["link"] for rings in data["skins"] for ring in rings} for data in (view, ours)]
    assert ringed[0] == ringed[1]
    assert len(ringed[0]) > 10
    paths = [[cable["sites"] for cable in data["cables"]] for data in (view, ours)]
    assert paths[0] == paths[1]
    # an MJCF has no skin, so its links are drawn one by one
    assert not any(shape["skin"] for shape in theirs["shapes"])
    assert len({shape["link"] for shape in theirs["shapes"]}) > 10


def test_the_tip_of_both_files_is_where_mujoco_has_it(arm, tmp_path):
    export.write_mjcf(arm, tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    page = page_of(arm, tmp_path / "arm.xml")
    task = Side(arm).robot.task
    q = np.random.default_rng(0).uniform(-0.1, 0.1, model.nq)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    named = [model.site(k).name for k in range(model.nsite)]
    there = data.site(task).xpos if task in named else data.body(task).xpos
    names = [model.joint(k).name for k in range(model.njnt)]
    for drawing in page.figures:
        row = drawing.coordinates({name: [x] for name, x in zip(names, q, strict=True)})
        assert np.allclose(
            links_of(drawing.data, row)[drawing.data["tip"]][:3, 3], there, atol=1e-7
        )


def test_a_changed_cable_has_a_colour(arm, tmp_path):
    root, other = etree.fromstring(arm.read_bytes()), tmp_path / "other.urdf"
    tendon = root.find("softdyn/tendon")
    term = tendon.find("joint")
    term.set("coef", str(1.1 * float(term.get("coef"))))
    other.write_bytes(etree.tostring(root))
    for figure in page_of(arm, other).figures:
        marked = {cable["name"] for cable in figure.data["cables"] if cable["rgba"]}
        assert marked == {tendon.get("name")}


@pytest.mark.parametrize("number", [2, 3])
def test_a_changed_damping_colours_the_skin_of_the_link_that_its_joint_moves(arm, tmp_path, number):
    """The first of two joints between two segments ends at a link without a shape."""
    root, other = etree.fromstring(arm.read_bytes()), tmp_path / "other.urdf"
    dynamics = root.findall("joint/dynamics")
    damped, last = dynamics[number], dynamics[3]
    damped.set("damping", str(2 * float(damped.get("damping"))))
    other.write_bytes(etree.tostring(root))
    sides = Side(arm), Side(other)
    joint = last.getparent().get("name")
    (changed,) = [part.link for part in sides[0].neutral.parts if part.name == joint]
    for figure in page_of(arm, other).figures:
        data = figure.data
        rings = [ring for rings in data["skins"] for ring in rings]
        marked = {ring["link"] for ring in rings if tuple(ring["rgba"]) == VALUES}
        marked |= colours(data).get(VALUES, set())
        assert figure.figure.links.index(changed) in marked


@pytest.mark.parametrize("tendon", ["near", "other"])
def test_an_actuator_of_another_name_marks_both_robots(tmp_path, tendon):
    """Its tendon is a sum of joints, so that the links which these move have the colour."""
    body = ('<mujoco><worldbody><body><joint name="j" type="hinge" axis="0 1 0"/>'
            '<geom size="0.1" pos="0.2 0 0" mass="1"/></body></worldbody><tendon><fixed name="{}">'
            '<joint joint="j" coef="0.1"/></fixed></tendon><actuator><motor name="{}" tendon="{}" '
            'gear="{}" ctrlrange="-1 1"/></actuator></mujoco>')  # fmt: skip
    files = tmp_path / "a.xml", tmp_path / "b.xml"
    files[0].write_text(body.format("near", "pull", "near", 1))
    files[1].write_text(body.format(tendon, f"{tendon}_motor", tendon, -1))
    for figure in page_of(*files).figures:
        assert VALUES in colours(figure.data)


@pytest.mark.parametrize("seed", [1, 2])
def test_cables_run_around_round_bodies_and_not_through_their_axes(tmp_path, seed):
    """Sites and centres of an MJCF's cables stand where MuJoCo has them."""
    (tmp_path / "a.urdf").write_text(write(wrapped_robot(seed, 2)))
    export.write_mjcf(tmp_path / "a.urdf", tmp_path / "a.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    drawn = RobotDrawing.of(Side(tmp_path / "a.xml")).data
    links = links_of(drawn, np.zeros(drawn["dof"]))
    kinds = mujoco.mjtWrap
    for cable in drawn["cables"]:
        t = model.tendon(cable["name"]).id
        rows = range(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
        sites = [model.wrap_objid[w] for w in rows if model.wrap_type[w] == kinds.mjWRAP_SITE]
        round_ = (int(kinds.mjWRAP_SPHERE), int(kinds.mjWRAP_CYLINDER))
        geoms = [model.wrap_objid[w] for w in rows if int(model.wrap_type[w]) in round_]
        places = [(links[link] @ [*xyz, 1])[:3] for link, *xyz in cable["sites"]]
        assert np.allclose(places, data.site_xpos[sites], atol=1e-8)
        assert [wrap["radius"] for wrap in cable["wraps"]] == pytest.approx(
            model.geom_size[geoms, 0]
        )
        for wrap, geom in zip(cable["wraps"], geoms, strict=True):
            pose = links[wrap["link"]] @ np.reshape(wrap["pose"], (4, 4)).T
            assert np.allclose(pose[:3, 3], data.geom_xpos[geom], atol=1e-8)
            if not wrap["sphere"]:
                along = data.geom_xmat[geom].reshape(3, 3)[:, 2]
                assert abs(pose[:3, 2] @ along) == pytest.approx(1, abs=1e-9)
    assert any(cable["wraps"] for cable in drawn["cables"])


PULLEYS = """<mujoco><worldbody><site name="a"/><site name="b" pos="0 0.1 0"/>
<body name="load" pos="0 0 -0.3"><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/><site name="c"/>
<site name="d" pos="0 0.1 0"/></body></worldbody><tendon><spatial name="rope"><site site="a"/>
<site site="c"/><pulley divisor="2"/><site site="b"/><site site="d"/></spatial></tendon></mujoco>"""


def test_a_pulley_divides_a_path(tmp_path):
    (tmp_path / "a.xml").write_text(PULLEYS)
    cables = RobotDrawing.of(Side(tmp_path / "a.xml")).data["cables"]
    assert [len(cable["sites"]) for cable in cables] == [2, 2]
