"""The viewer's drawing of a robot: poses, the side of cables, and the response at rest."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import softdyn
from softdyn import design, statics
from softdyn.description.robot import input_unit, poses
from softdyn.description.visuals import BoxShape, CylinderShape, Visual
from softdyn.view.rest_sweep import BEND, TRAVEL, rest_sweep
from softdyn.view.scene import TENSION, Figure, tension_colour
from softdyn.view.tendon_paths import CLEARANCE, _distance
from tests.support import robots
from tests.support.arms import RUBBER, THREE_SECTIONS, loaded, pushed
from tests.support.wrapped_robots import wrapped_robot


def sticks(mimic: str = "", base: str = "", **first: object) -> str:
    """A joint that turns, one that slides on it and may follow it, and a tip."""
    # a continuous joint has no follower
    first = first or {"kind": "revolute" if mimic else "continuous"}
    return robots.robot(
        "sticks", robots.tag("link", base, name="base"), robots.link("a", 1, None, 1),
        robots.link("b", 1, None, 1), robots.link("tip"), robots.joint("j", "base", "a", **first),
        robots.joint("k", "a", "b", "1 0 0", "prismatic", at="0.2 0 0", inside=mimic),
        robots.weld("b", "tip", "0.1 0 0"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


def polyline(figure: Figure, cable, q: np.ndarray) -> float:
    points = cable.points(figure.link_poses(q))
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def page_tip(data: dict, q: np.ndarray) -> np.ndarray:
    """The tip's position, computed joint by joint from the page's data."""
    base = np.eye(4)
    if data["floating"]:
        base[:3, 3], base[:3, :3] = q[:3], Rotation.from_rotvec(q[3:6]).as_matrix()
    placed = {data["root"]: base}
    for joint in data["joints"]:
        moves = joint["index"] >= 0
        value = joint["gain"] * q[joint["index"]] + joint["offset"] if moves else 0.0
        moved = np.eye(4)
        if joint["slides"]:
            moved[:3, 3] = value * np.array(joint["axis"])
        else:
            moved[:3, :3] = Rotation.from_rotvec(value * np.array(joint["axis"])).as_matrix()
        pose = np.reshape(joint["pose"], (4, 4)).T
        placed[joint["child"]] = placed[joint["parent"]] @ pose @ moved
    return placed[data["tip"]][:3, 3]


@pytest.mark.parametrize("name", ["spirob", "helix"])
def test_link_poses_are_pinocchio_s(name):
    model = softdyn.load(name)
    q = np.random.default_rng(1).normal(scale=0.3, size=model.nq)
    placed = Figure.of(model).link_poses(q)
    data = model.pin_model.createData()
    pin.framesForwardKinematics(model.pin_model, data, q)
    for link in model.robot.links[1:]:
        frame = data.oMf[model.pin_model.getFrameId(link.name, pin.FrameType.BODY)]
        np.testing.assert_allclose(placed[link.name], frame.homogeneous, atol=1e-12)


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("mimic", ["", '<mimic joint="j" multiplier="0.1" offset="0.05"/>'])
def test_the_tip_of_any_tree_is_the_model_s(tmp_path, mimic, floating):
    text = sticks(mimic, robots.inertial(1, None, 1) if floating else "")
    model = robots.load(tmp_path, text, floating=floating)
    figure = Figure.of(model)
    rods = [shape for shape in figure.shapes if isinstance(shape.shape, CylinderShape)]
    for rod, joint in zip(rods, model.robot.joints[-2:], strict=True):  # the first turns in place
        half = rod.shape.length / 2 * rod.pose[:3, 2]
        ends = rod.pose[:3, 3] - half, rod.pose[:3, 3] + half
        assert rod.link == joint.parent
        np.testing.assert_allclose(ends, [np.zeros(3), joint.origin.translation], atol=1e-12)
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = model.configuration(rng.uniform(-0.9, 0.9, model.nv))
        tip = figure.link_poses(q)[model.robot.task][:3, 3]
        np.testing.assert_allclose(tip, model.state(q, np.zeros(model.nv)).y, atol=1e-12)
    data = json.loads(json.dumps(figure.data, allow_nan=False))
    np.testing.assert_allclose(page_tip(data, model.coordinates(q)), tip, atol=1e-8)


def test_spatial_cables_have_the_model_s_lengths():
    model = softdyn.load("spirob")
    figure = Figure.of(model)
    q = np.random.default_rng(2).normal(scale=0.3, size=model.nq)
    lengths = [polyline(figure, cable, q) for cable in figure.cables]
    np.testing.assert_allclose(lengths, model.tendon_lengths(q), rtol=1e-12)


@pytest.mark.parametrize("name", ["finger", "helix"])
def test_a_fixed_tendon_is_drawn_on_the_side_where_it_would_pull(name):
    """Under tension, the joints turn so that the drawn cable becomes shorter."""
    model = softdyn.load(name)
    figure = Figure.of(model)
    B = model.state(model.q0, np.zeros(model.nv)).B
    checked = 0
    for cable in figure.cables:
        if cable.side == 0:
            continue
        u = cable.side * np.sign(cable.weights)
        assert cable.part(u) * cable.side > 0
        assert cable.part(-u) == 0
        step = 1e-5 * B @ u / np.abs(B @ u).max()
        assert polyline(figure, cable, step) < polyline(figure, cable, -step)
        checked += 1
    assert checked == {"finger": 4, "helix": 12}[name]


def test_cables_clear_the_robot(finger):
    figure = Figure.of(finger)
    radius = 0.0088  # of a phalanx
    for cable in figure.cables:
        points = np.array([xyz for _, xyz in cable.sites])
        assert (np.abs(points[:, 2]) > radius).all()


def test_a_cable_clears_the_first_link_below_that_has_a_shape():
    robot = robots.build(sticks()).robot
    boxes = [
        Visual(link, np.eye(4), BoxShape((0.1, 0.1, 2 * half)), (1, 1, 1, 1))
        for link, half in (("base", 0.7), ("a", 0.05), ("b", 0.2))
    ]
    joint, up = robot.joints[0], np.array([0.0, 0.0, 1.0])
    for shapes, reach in ((boxes, 0.05), (boxes[2:], 0.2)):
        assert _distance(robot, joint, up, shapes, poses(robot)) == pytest.approx(CLEARANCE * reach)
    assert _distance(robot, joint, up, boxes[:1], poses(robot)) == 0.03 * robot.length


def test_colours_of_tension_are_told_apart_by_lightness():
    parts = np.linspace(0, 1, 50) ** 3
    for sign in (1, -1):
        colours = np.array([tension_colour(sign * part) for part in parts])
        luminance = colours**2.2 @ [0.2126, 0.7152, 0.0722]
        assert luminance[0] - luminance[-1] > 0.15
    assert tension_colour(2.0) == tension_colour(1.0)
    stops = (0.0, 0.5, 1.0)  # cube roots of tensions: what the table is over
    for sign in (1, -1):
        table = [rgb for at in stops for stop, rgb in TENSION if stop == sign * at]
        seen = [tension_colour(sign * at**3) for at in stops]
        np.testing.assert_allclose(seen, np.array(table) / 255, rtol=1e-12)


def test_the_sweep_starts_at_rest_and_moves_the_tip():
    model = softdyn.load("spirob")
    sweep = rest_sweep(model)
    state = model.state(sweep.q[0], np.zeros(model.nv))
    assert np.abs(state.h).max() < 1e-3 * np.abs(state.g).max() + 1e-6
    assert [text.split()[0] for _, text in sweep.notes] == ["rest", "u1", "u2", "u3"]
    assert (sweep.u >= model.u_min).all()
    assert (sweep.u <= model.u_max).all()
    travel = np.linalg.norm(sweep.y - sweep.y[0], axis=1).max()
    assert 0.3 * TRAVEL < travel / 0.5 < 2 * TRAVEL
    assert np.diff(sweep.t).max() < 0.04


def test_the_helix_rests_on_its_stops(monkeypatch):
    for part in ("RAMP", "HOLD"):  # short, because only the rest matters here
        monkeypatch.setattr(f"softdyn.view.rest_sweep.{part}", 0.05)
    sweep = rest_sweep(model := softdyn.load("helix"))
    beyond = np.maximum(model.lower - sweep.q[0], sweep.q[0] - model.upper)
    assert beyond.max() == pytest.approx(0.0, abs=1e-9)  # the weight hangs on the lower stops
    assert len(sweep.notes) == 1 + 6 * 2 + 3


def test_a_robot_without_inputs_moves_joint_by_joint():
    model = softdyn.load("ur5")
    sweep = rest_sweep(model)
    assert [text for _, text in sweep.notes] == list(model.joint_names)
    assert (np.ptp(sweep.q, axis=0) > 0.1).all()


@pytest.mark.parametrize(
    ("limits", "peak"),
    [
        ((-1, 0.1), -BEND),
        ((-0.3, 0.4), 0.4),
        ((-0.2, 0.1), -0.2),
        ((-1, 2), BEND),
        ((0.2, 1), 0.2 + BEND),
    ],
)
def test_a_joint_moves_where_it_has_room_and_back(limits, peak):
    sweep = rest_sweep(robots.build(sticks(limit=limits)))
    assert [name for _, name in sweep.notes] == ["j", "k"]
    second = np.searchsorted(sweep.t, sweep.notes[1][0])
    rest, first = max(limits[0], 0), sweep.q[:second, 0]
    assert first[0] == pytest.approx(rest)
    assert first[np.argmax(np.abs(first - rest))] == pytest.approx(peak, abs=0.01 * BEND)
    assert np.argmax(np.abs(first - rest)) == pytest.approx(second / 2, abs=1)  # as fast back
    np.testing.assert_array_equal(sweep.q[:second, 1], 0)
    np.testing.assert_allclose(sweep.q[second:, 0], rest, atol=1e-12)
    stroke = sweep.q[second:, 1]
    assert stroke.max() == pytest.approx(0.03, rel=0.02)  # a tenth of the length


def test_a_led_cable_of_a_rod_is_drawn_on_its_side(tmp_path):
    """At joints that bend both ways in one point, its moment arms determine its place."""
    arm = design.make_arm(tomllib.loads(THREE_SECTIONS))
    figure = Figure.of(loaded(arm, tmp_path))
    assert len(figure.cables) == len(arm.cables) == 12
    for cable, drawn in zip(arm.cables, figure.cables, strict=True):
        assert len(drawn.sites) >= 8
        for _, (_, y, z) in drawn.sites:
            side = np.array([-np.sin(cable.angle), np.cos(cable.angle)])
            np.testing.assert_allclose([y, z] / np.hypot(y, z), side, atol=1e-6)


@pytest.fixture(scope="module")
def channels(tmp_path_factory):
    """An arm that tapers, with one cable in a channel that comes nearer to its axis."""
    section = design.Section(0.2, [0.02, 0.01], RUBBER, 4)
    cable = design.Cable(0.7, [0.015, 0.006], straight=False, max_tension=5.0, name="left")
    return loaded(design.Arm((section,), cables=(cable,)), tmp_path_factory.mktemp("arm"))


def test_a_cable_in_a_channel_is_drawn_in_it_and_turns_red(channels):
    """Its offset shrinks towards the tip; a pull is positive, as in the legend."""
    figure = Figure.of(channels)
    (cable,) = figure.cables
    placed = figure.link_poses(channels.q0)
    points = cable.points(placed)
    joints = (points[0:-1:2] + points[1:-1:2]) / 2
    along, away = -joints[:, 2], np.hypot(joints[:, 0], joints[:, 1])
    assert (np.diff(away) < 0).all()
    assert (away < 0.02 - 0.05 * along).all()  # inside the body
    np.testing.assert_allclose(away, 0.015 - 0.045 * along, rtol=0.01)
    assert cable.part(np.array([5.0])) == 1
    B = channels.state(channels.q0, np.zeros(4 * 2)).B
    assert polyline(figure, cable, 1e-3 * B[:, 0]) < polyline(figure, cable, -1e-3 * B[:, 0])


def test_inputs_of_an_arm_are_named_after_their_cables_and_in_newton(channels):
    (actuator,) = channels.robot.actuators
    assert actuator.name == actuator.tendon == "left"
    assert input_unit(channels.robot) == "N"


def test_a_skin_leads_along_the_arm_and_is_as_wide(channels):
    (rings,) = Figure.of(channels).data["skins"]
    placed, links = channels.link_poses(channels.q0), Figure.of(channels).links
    poses = [placed[links[r["link"]]] @ np.reshape(r["pose"], (4, 4)).T for r in rings]
    along = np.array([-pose[2, 3] for pose in poses])
    assert along[0] == pytest.approx(0, abs=1e-9)
    assert along[-1] == pytest.approx(0.2)
    assert (np.diff(along) > 0.005).all()
    radii = [ring["radius"] for ring in rings]
    np.testing.assert_allclose(radii, 0.02 - 0.05 * along, rtol=0.04)
    for pose in poses:
        np.testing.assert_allclose(pose[:3, 2], [0, 0, -1], atol=1e-9)  # z of a ring is its axis


def test_a_drawn_cable_follows_the_round_bodies_that_it_touches():
    """The polyline is as long as the cable, but for the chords of its arcs."""
    touched = 0
    for seed in range(6):
        model = softdyn.build(wrapped_robot(seed, bodies=2))
        figure, q = Figure.of(model), model.q0
        lengths = dict(zip(model.tendons.names, model.tendon_lengths(q), strict=True))
        for cable in figure.cables:
            if cable.wraps:
                drawn = polyline(figure, cable, q)
                assert 0.998 * lengths[cable.name] < drawn < lengths[cable.name] + 1e-12
                touched += len(cable.points(figure.link_poses(q))) > len(cable.sites)
    assert touched > 2


def test_a_chamber_is_a_tube_at_its_place_beside_the_cables() -> None:
    """The drawn tube lies where the chamber is, on the side that its pressure makes longer."""
    model = pushed()
    front, back = Figure.of(model).cables
    assert front.radius_m == back.radius_m == pytest.approx(np.sqrt(4e-5 / np.pi))
    assert front.part(np.array([1e5, 0.0])) == pytest.approx(1)
    assert front.part(np.array([-6e4, 1e5])) == pytest.approx(-0.6)
    poses = model.link_poses(model.q0)
    # the arm hangs from the origin, and its +z is the world's +x
    assert front.points(poses)[:, 0] == pytest.approx(0.008)
    assert back.points(poses)[:, 0] == pytest.approx(-0.008)
    inputs = Figure.of(model).data["inputs"]
    assert [(one["unit"], one["factor"]) for one in inputs] == [("kPa", 1e-3)] * 2
    rest = statics.settle(model, np.array([5e4, 0.0]))
    assert rest.y[0] < -0.01


def test_a_body_without_a_shape_gets_a_stand_in():
    shape = '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
    text = sticks()
    for link, bare in (("a", {"b", "tip"}), ("b", {"a", "b"})):
        shown = robots.changed(text, (f'<link name="{link}">', f'<link name="{link}">{shape}'))
        shapes = Figure.of(robots.build(shown)).shapes
        assert {one.link for one in shapes if not isinstance(one.shape, BoxShape)} == bare
