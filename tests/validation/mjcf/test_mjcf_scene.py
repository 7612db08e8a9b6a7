"""A controller on the analytic model drives a user's MJCF."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

import softdyn
from softdyn import InputError, SetPoint
from softdyn.commands import run
from softdyn.controllers import SoftIdClfQp
from softdyn.description.library import find
from softdyn.validation import Log, Twin, paper, simulate
from softdyn.validation.mjcf.export import write_mjcf
from softdyn.validation.mjcf.scene import Scene
from softdyn.validation.mjcf.scenery import scenery
from tests.support import ROOT
from tests.support.refused import refused

SCENE = ROOT / "docs/examples/finger_scene.xml"


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


def changed(folder: Path, change, source: Path = SCENE) -> Path:
    root = etree.parse(source).getroot()
    change(root)
    target = folder / "scene.xml"
    target.write_bytes(etree.tostring(root))
    return target


def without_obstacles(root) -> None:
    for node in root.xpath("//geom[@name='post'] | //geom[@name='shelf'] | //body[@name='block']"):
        node.getparent().remove(node)


def test_the_same_robot_from_another_hand_moves_as_the_twin_does(finger, tmp_path):
    # names, units, and the senses of a joint and its tendon differ; the map corrects them
    scene = Scene(finger, changed(tmp_path, without_obstacles))
    assert scene.comparison.turns == {"joint4": (-1.0, 0.0)}
    plan = paper.set_point("finger", theta=0.5)
    log = simulate(finger, SoftIdClfQp(finger), plan, plant=scene, duration=0.5)
    twin = simulate(finger, SoftIdClfQp(finger), plan, duration=0.5)
    assert np.abs(log.q - twin.q).max() < 1e-7 < np.abs(log.q).max()
    assert np.abs(log.u - twin.u).max() < 1e-5 < np.abs(log.u).max()


@pytest.mark.parametrize("as_path", [True, False])
@pytest.mark.parametrize(
    ("where", "name", "said"),
    [("option", "density", "opt.density 1000"), ("option", "viscosity", "opt.viscosity 1000"),
     ("joint", "frictionloss", "friction of joint1 1000"),
     ("joint", "armature", "armature of joint1 1000")],
)  # fmt: skip
def test_what_the_model_does_not_know_is_said(finger, tmp_path, where, name, said, as_path):
    def change(root) -> None:
        without_obstacles(root)
        root.find(f".//worldbody//{where}" if where == "joint" else where).set(name, "1000")

    file = changed(tmp_path, change)
    plant = file if as_path else Scene(finger, file)
    plan = paper.set_point("finger", theta=0.5)
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        simulate(finger, SoftIdClfQp(finger), plan, plant=plant, duration=0.01)
    assert [
        one for one in heard if "does not know" in str(one.message) and said in str(one.message)
    ]


def test_a_scene_that_the_model_knows_warns_of_nothing_unknown(finger, tmp_path):
    assert Scene(finger, changed(tmp_path, without_obstacles)).unknown == ()


def test_what_stands_in_the_way_stops_the_finger_and_the_block_is_pushed(finger):
    scene = Scene(finger, SCENE)
    assert scene.contacts
    assert scene.comparison.unmatched == {"a": [], "b": ["block"]}
    plan = paper.set_point("finger", theta=0.5)
    log = simulate(finger, SoftIdClfQp(finger), plan, plant=scene, duration=1.5)
    free = simulate(finger, SoftIdClfQp(finger), plan, duration=1.5)
    ends = [100 * np.linalg.norm(run.error[-1]) for run in (log, free)]
    assert ends[0] > 3.0 > 0.3 > ends[1]  # cm
    touching = {scene.model.geom(g).name for c in scene.data.contact for g in (c.geom1, c.geom2)}
    assert "post" in touching
    assert log.contacts
    assert not free.contacts


def test_gears_zeros_and_what_only_the_scene_has_are_mapped(finger, tmp_path):
    def change(root) -> None:
        without_obstacles(root)
        first, *_, last = root.findall(".//joint[@name]")
        first.set("ref", "20")  # its zero differs, and with it the limits and the spring
        first.set("range", "-69.954374 109.954374")
        first.set("springref", "20")
        for motor in root.iter("motor"):
            if motor.get("name"):
                motor.set("gear", "-0.05")
                motor.set("ctrlrange", "-2 2")
        hand = etree.SubElement(last.getparent(), "body", pos="0.06 0 0")
        etree.SubElement(hand, "joint", name="jaw")
        etree.SubElement(
            hand, "inertial", pos="0 0 0", mass="1e-9", diaginertia="1e-12 1e-12 1e-12"
        )
        etree.SubElement(root.find("actuator"), "position", name="grip", joint="jaw", kp="1e-6")

    scene = Scene(finger, changed(tmp_path, change))
    sense, zero = scene.comparison.turns["joint1"]
    assert (sense, zero) == (1.0, pytest.approx(-np.radians(20)))
    assert scene.idle == ("grip",)
    assert np.allclose(scene.inputs[:2], -2 * np.eye(2))
    q, v = np.array([0.1, -0.2, 0.3, 0.4]), np.array([1.0, 2.0, 3.0, 4.0])
    qpos, qvel = scene.states.to_twin(q, v)
    assert np.allclose(qpos, [0.1 + np.radians(20), -0.2, 0.3, -0.4, 0.0])
    assert np.allclose(qvel, [1, 2, 3, -4, 0])
    assert all(map(np.allclose, scene.states.from_twin(qpos, qvel), (q, v)))
    plan = paper.set_point("finger", theta=0.5)
    log = simulate(finger, SoftIdClfQp(finger), plan, plant=scene, duration=0.1)
    twin = simulate(finger, SoftIdClfQp(finger), plan, duration=0.1)
    assert np.abs(log.q - twin.q).max() < 1e-6


def test_cables_drive_as_the_twin_s(tmp_path):
    model = softdyn.load("spirob")
    write_mjcf("spirob", tmp_path / "spirob.xml", shapes=False)
    scene, twin = Scene(model, tmp_path / "spirob.xml", timestep=5e-4), Twin(model)
    assert np.array_equal(scene.inputs, np.eye(3))
    assert scene.comparison.passed
    q = np.linspace(-0.2, 0.2, 27)
    scene.set_state(*scene.states.to_twin(q, 0 * q))
    states = softdyn.validation.StateMap(model, twin)
    twin.set_state(*states.to_twin(q, 0 * q))
    for plant in (scene, twin):
        plant.advance(np.array([1.0, 2.0, 0.5]), 50)
    sides = ((scene.states, scene), (states, twin))
    ends = (m.from_twin(p.data.qpos, p.data.qvel)[0] for m, p in sides)
    assert np.abs(np.subtract(*ends)).max() < 1e-9


def unnamed(root) -> None:
    for node in root.xpath("//*[@name='knuckle_4']"):
        node.set("name", "q")
    for node in root.xpath("//*[@joint='knuckle_4']"):
        node.set("joint", "q")


def shorter(root) -> None:
    for node in root.xpath("//body[@name='phalanx_4'] | //*[@joint='knuckle_4']"):
        node.getparent().remove(node)


def undriven(root) -> None:
    root.remove(root.find("actuator"))


def damper(root) -> None:
    root.find("actuator/motor").set("ctrlrange", "0 2")
    root.find("actuator/motor").tag = "damper"


def disabled(root) -> None:
    root.find("option").set("actuatorgroupdisable", "2")
    root.find("actuator/motor").set("group", "2")


def still(root) -> None:
    root.find("actuator/motor").tag = "general"
    root.find("actuator/general").attrib.update(
        {"gear": "0.1", "gainprm": "0", "biastype": "affine"}
    )


def afloat(root) -> None:
    palm = etree.SubElement(root.find("worldbody"), "body")
    etree.SubElement(palm, "freejoint")
    etree.SubElement(palm, "geom", type="sphere", size="0.01")
    palm.append(root.find(".//body[@name='phalanx_1']"))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (shorter, ("scene.xml", "none for joint4")),
        (undriven, ("scene.xml: actuator for 'u1'", "none")),
        (damper, ("scene.xml: actuator for 'u1'", "'servo_1', gain affine")),
        (disabled, ("scene.xml: actuator for 'u1'", "'servo_1', its group disabled")),
        (still, ("scene.xml: actuator for 'u1'", "'servo_1', gain 0")),
        (afloat, ("scene.xml", "a floating one")),
    ],
)
def test_a_scene_without_all_of_the_robot_is_refused_in_one_line(
    finger, tmp_path, change, expected
):
    file = changed(tmp_path, lambda root: (without_obstacles(root), change(root)))
    with refused(*expected) as error:
        Scene(finger, file)
    assert str(file) in str(error.value)


def test_a_joint_of_no_like_name_is_found_along_the_tree(finger, tmp_path):
    assert len(Scene(finger, changed(tmp_path, unnamed)).comparison.matched) == 4


def test_a_plant_that_cannot_be_is_refused(finger):
    def run_it(**options):
        return simulate(finger, SoftIdClfQp(finger), SetPoint([0.2, 0, 0]), **options)

    with refused("contacts, friction", "one"):
        run_it(plant=SCENE, contacts=True)
    with refused("plant", 3):
        run_it(plant=3)
    with refused("plant", "one for 'finger'"):
        simulate(
            softdyn.load("spirob"),
            lambda *_: np.zeros(3),
            SetPoint([0, 0, 0]),
            plant=Scene(finger, SCENE),
        )


def test_what_stands_around_the_robot_is_drawn(finger, tmp_path):
    """Only the post, the shelf and a floor are drawn; not the moving block, nor the robot again."""

    def add(root):
        world, base = root.find("worldbody"), root.find(".//body[@name='phalanx_1']")
        mount = etree.SubElement(world, "body", name="mount", pos="0 0 0")
        etree.SubElement(mount, "geom", type="box", size="0.01 0.01 0.01")
        mount.append(base)
        pad = etree.SubElement(world, "body", name="pad", pos="0 0 -0.3", euler="0 90 0")
        etree.SubElement(pad, "geom", type="capsule", size="0.01 0.1")
        etree.SubElement(world, "geom", type="plane", size="0 0 1", pos="0 0 -0.5")

    post, shelf, rod, *balls, floor = scenery(Scene(finger, changed(tmp_path, add)))
    np.testing.assert_allclose(post.pose[:3, 3], [0.14, 0, -0.1], atol=1e-9)
    assert post.shape.radius == pytest.approx(0.02)
    assert post.shape.length == pytest.approx(0.08)
    assert abs(post.pose[1, 2]) == pytest.approx(1.0)  # it lies along y
    assert shelf.shape.size == pytest.approx((0.1, 0.1, 0.01))
    assert rod.shape.length == pytest.approx(0.2)
    ends = sorted(ball.pose[0, 3] for ball in balls)
    np.testing.assert_allclose(ends, [-0.1, 0.1], atol=1e-9)
    low, high = (floor.pose[2, 3] + s * floor.shape.size[2] / 2 for s in (-1, 1))
    assert low < high == pytest.approx(-0.5)
    assert {one.link for one in (post, shelf, rod, *balls, floor)} == {""}


def test_the_command_reports_the_differences_first_and_shows_the_scene(capsys, tmp_path):
    arguments = ["finger", "best", "--theta", "0.5", "--duration", "0.05", "--plant", str(SCENE)]
    kept = ["--html", str(tmp_path / "run.html"), "--log", str(tmp_path / "run.npz")]
    assert run.main([*arguments, *kept]) in (0, 1)
    out = capsys.readouterr().out
    assert out.index("reversed") < out.index("finger in finger_scene.xml, best")
    text = (tmp_path / "run.html").read_text().partition('id="scene">')[2].partition("</scr")[0]
    page = json.loads(text)
    assert [shape["link"] for shape in page["figures"][0]["shapes"]][-2:] == [-1, -1]
    assert page["runs"][0]["tracks"][0]["note"] == "in finger_scene.xml"
    log = Log.load(tmp_path / "run.npz")
    assert log.plant == "finger_scene.xml"
    run.main([*arguments, "--json", "-"])
    found = json.loads(capsys.readouterr().out)["plant"]
    assert not found["passed"]
    assert found["comparison"]["causes"][0]["where"] == "joint4"
    with pytest.warns(UserWarning, match="the files differ: axis"):
        simulate(
            softdyn.load("finger"),
            lambda *_: np.zeros(2),
            SetPoint([0.2, 0, 0]),
            plant=SCENE,
            duration=0.01,
        )


def test_our_own_export_drives_a_file_whose_coefficients_changed(tmp_path):
    """A unit input pulls with the same tension on the cable of the same name, at other arms."""
    text = find("finger").read_text()
    write_mjcf(find("finger"), tmp_path / "finger.xml")
    other = tmp_path / "finger.urdf"
    root = etree.fromstring(text.encode())
    coef = root.find("softdyn/tendon/joint")
    coef.set("coef", str(1.1 * float(coef.get("coef"))))
    other.write_bytes(etree.tostring(root))
    model, own = softdyn.load(other), softdyn.load(find("finger"))
    plant = Scene(model, tmp_path / "finger.xml")
    assert plant.inputs == pytest.approx(Scene(own, tmp_path / "finger.xml").inputs)
    assert not plant.comparison.passed
    assert "tendon" in {cause.kind for cause in plant.comparison.causes}


def test_an_input_without_an_actuator_is_named_with_the_targets(tmp_path):
    write_mjcf(find("finger"), tmp_path / "finger.xml")
    text = (tmp_path / "finger.xml").read_text()
    root = etree.fromstring(text.encode())
    (actuators,) = root.findall("actuator")
    actuators.remove(actuators[0])
    (tmp_path / "finger.xml").write_bytes(etree.tostring(root))
    with pytest.raises(InputError) as error:
        Scene(softdyn.load("finger"), tmp_path / "finger.xml")
    assert "'u1'" in str(error.value)
    assert "'u2' on tendon:tendon_b" in str(error.value)


@pytest.mark.parametrize(("share", "fits"), [(5e-4, True), (5e-3, False)])
def test_arms_on_a_cable_of_another_name_are_proportional_within_a_thousandth(
    tmp_path, share, fits
):
    """An input has one scale, so that it drives both joints of a cable as they are in the file."""
    write_mjcf(find("finger"), tmp_path / "finger.xml")
    root = etree.parse(tmp_path / "finger.xml").getroot()
    for k, cable in enumerate(root.findall("tendon/fixed")):
        for motor in root.findall(f"actuator/*[@tendon='{cable.get('name')}']"):
            motor.set("tendon", f"other_{k}")
        cable.set("name", f"other_{k}")
    arms = root.findall("tendon/fixed[@name='other_0']/joint")
    assert len(arms) == 2
    arms[1].set("coef", str((1 + share) * float(arms[1].get("coef"))))
    (tmp_path / "finger.xml").write_bytes(etree.tostring(root))
    model = softdyn.load("finger")
    if fits:
        assert Scene(model, tmp_path / "finger.xml").inputs == pytest.approx(np.eye(2), rel=1e-3)
    else:
        with refused("finger.xml: actuator for 'u1'"):
            Scene(model, tmp_path / "finger.xml")
