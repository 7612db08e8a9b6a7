"""A URDF in Pinocchio compared with an independent MJCF in MuJoCo."""

import json
from pathlib import Path

import pytest
from lxml import etree

from softdyn.commands import compare as command
from softdyn.validation import compare
from softdyn.validation.crosschecks.engines import engine_errors, side_by_side
from tests.support import pair_robots, robots
from tests.support.command import command as shell
from tests.support.refused import refused


@pytest.fixture
def pair(tmp_path):
    (tmp_path / "pair.urdf").write_text(pair_robots.URDF)
    (tmp_path / "pair.xml").write_text(pair_robots.MJCF)
    return tmp_path / "pair.urdf", tmp_path / "pair.xml"


def edit(file: Path, change) -> None:
    root = etree.fromstring(file.read_text())
    change(root)
    file.write_bytes(etree.tostring(root))


def errors(found) -> dict[str, float]:
    return {check.quantity: check.max_error for check in found.checks}


def test_two_files_of_one_robot_agree_in_two_engines(pair):
    def otherwise(root) -> None:
        lift, swing = (root.find(f".//joint[@name='{name}']") for name in ("lift", "swing"))
        lift.set("axis", " ".join(str(-float(x)) for x in lift.get("axis").split()))
        lift.set("range", "-1.1 0.8")
        swing.set("ref", "0.3")  # its zero, and with it the range
        swing.set("range", "-0.7 1.8")
        root.find(".//joint[@name='slide']").set("armature", "0.02")  # the URDF states none
        hand = etree.SubElement(swing.getparent(), "body")
        etree.SubElement(hand, "joint", name="thumb")
        tiny = {"pos": "0 0 0", "mass": "1e-12", "diaginertia": "1e-14 1e-14 1e-14"}
        etree.SubElement(hand, "inertial", tiny)
        etree.SubElement(root.find("actuator"), "position", name="servo", joint="thumb", kp="3")

    edit(pair[1], otherwise)
    found = side_by_side(*pair, samples=2)
    assert found.passed, found
    assert set(errors(found)) >= {"M", "bias", "J", "qdd", "trajectory", "length", "B"}
    assert len(found.runs) == 4


def test_what_differs_is_measured(pair):
    edit(pair[1], lambda root: root.find(".//inertial").set("mass", "0.909"))
    found = side_by_side(*pair, samples=2)
    assert set(found.failures) >= {"M", "g", "bias", "qdd", "trajectory"}
    assert 1e-6 < errors(found)["M"] < 1e-2
    assert errors(found)["J"] < 1e-10


def test_a_floating_base(tmp_path):
    from softdyn.validation.mjcf.export import write_mjcf

    source, target = tmp_path / "walker.urdf", tmp_path / "walker.xml"
    source.write_text(robots.WALKER)
    write_mjcf(source, target, floating=True)
    found = side_by_side(source, target, samples=2)
    assert found.passed, found


def test_two_urdfs_are_no_pair_of_engines(pair):
    with refused("engines", "pair.urdf, pair.urdf"):
        side_by_side(pair[0], pair[0])


def test_the_command_asks_both_engines(pair, capsys):
    assert command.main([*map(str, pair), "--engines", "--samples", "2", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)["engines"]
    assert max(found["a"].values()) < 1e-12 > max(found["b"].values())
    assert found["pair"]["passed"]
    command.main([str(pair[0]), str(pair[0]), "--engines", "--samples", "1"])
    assert "not compared" in capsys.readouterr().out


def test_one_degree_of_freedom(tmp_path):
    text = robots.hinge(1, None, 1, name="j", child="l", axis=None, kind="continuous")
    (tmp_path / "a.urdf").write_text(text)
    (tmp_path / "b.xml").write_text(
        "<mujoco><worldbody><body name='l'><joint name='j' axis='1 0 0'/><inertial pos='0 0 0' "
        "mass='1' diaginertia='1 1 1'/></body></worldbody></mujoco>"
    )
    files = [str(tmp_path / name) for name in ("a.urdf", "b.xml")]
    assert command.main([*files, "--engines", "--samples", "1"]) == 0


def test_rounding_between_two_files_does_not_fail_the_command(pair, capsys):
    """The comparison accepts it; the cross-check's 1e-10 applies to one file in two engines."""
    edit(pair[1], lambda root: root.find(".//inertial").set("mass", "0.90000001"))
    words = [*map(str, pair), "--engines", "--samples", "1", "--json", "-"]
    assert command.main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert not found["engines"]["pair"]["passed"]
    edit(pair[1], lambda root: root.find(".//inertial").set("mass", "0.909"))
    assert command.main(words) == 1
    assert not json.loads(capsys.readouterr().out)["engines"]["passed"]


def test_a_file_in_which_nothing_moves(tmp_path):
    still = tmp_path / "still.xml"
    still.write_text('<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>')
    assert max(engine_errors(still, samples=1).values()) == 0.0


def arm(coef: float = 1, gear: float = 2, **spring: float) -> str:
    return robots.hinge(
        0.2, "0 0 -0.1", "7e-4 7e-4 1e-4", name="hip", limit=(-1.5, 1.5), effort=20, damping=0.02,
        path=[f"hip {coef}"], pull=(-1, 1), gear=gear, tendon=spring, drive={"name": "motor"},
    )  # fmt: skip


MOTOR = """<mujoco><compiler angle="radian"/><worldbody><site name="a" pos="0.1 0 0"/>
<body name="arm"><inertial pos="0 0 -0.1" mass="0.2" diaginertia="7e-4 7e-4 1e-4"/>
<joint name="hip" axis="0 1 0" range="-1.5 1.5" limited="true" damping="0.02"/>
<site name="b" pos="0.02 0 -0.1"/></body></worldbody>
<tendon>{tendon}</tendon><actuator><motor name="motor" joint="hip" gear="2" ctrlrange="-1 1"/>
</actuator></mujoco>"""
CABLE = '<spatial name="rope"><site site="a"/><site site="b"/></spatial>'
OTHER = '<fixed name="other" stiffness="3"><joint joint="hip" coef="5"/></fixed>'


@pytest.mark.parametrize("tendon", ["", CABLE, OTHER])
@pytest.mark.parametrize(
    ("coef", "gear", "spring"), [(1, 2, {}), (-4, -0.5, {}), (1, 2, {"stiffness": 3, "damping": 1})]
)
def test_a_motor_on_a_joint_against_a_tendon_over_it(tmp_path, tendon, coef, gear, spring):
    """The MJCF lacks the URDF's tendon, so there is no length to compare, nor its spring."""
    files = tmp_path / "arm.urdf", tmp_path / "arm.xml"
    files[0].write_text(arm(coef, gear, **spring))
    files[1].write_text(MOTOR.format(tendon=tendon))
    assert compare(*files).passed == (not spring and tendon != OTHER)
    found = side_by_side(*files, samples=2)
    assert found.passed, found
    assert len(found.runs) == 4  # with inputs, too


def test_a_spring_that_only_the_urdf_gives_to_a_shared_tendon(pair):
    text = pair[0].read_text().replace('name="cable">', 'name="cable" stiffness="8" damping="2">')
    pair[0].write_text(text)
    assert not compare(*pair).passed
    found = side_by_side(*pair, samples=2)
    assert found.passed, found


def test_the_command_agrees_where_a_motor_is_on_the_joint(tmp_path):
    files = tmp_path / "arm.urdf", tmp_path / "arm.xml"
    files[0].write_text(arm())
    files[1].write_text(MOTOR.format(tendon=""))
    for words in (files, files[::-1]):
        code, out, _ = shell("compare", *words, "--engines", "--samples", "1")
        assert code == 0
        assert "the two engines agree" in out
