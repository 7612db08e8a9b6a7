"""A URDF in Pinocchio compared with an independent MJCF in MuJoCo."""

import json
from pathlib import Path

import pytest
from lxml import etree

from softdyn import InputError
from softdyn.commands import compare as command
from softdyn.validation.crosschecks.engines import engine_errors, side_by_side
from tests.support import micro, pair_robots


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
    source.write_text(micro.FLOATING)
    write_mjcf(source, target, floating=True)
    found = side_by_side(source, target, samples=2)
    assert found.passed, found


def test_two_urdfs_are_no_pair_of_engines(pair):
    with pytest.raises(InputError, match="expected a URDF and an MJCF"):
        side_by_side(pair[0], pair[0])


def test_the_command_asks_both_engines(pair, capsys):
    assert command.main([*map(str, pair), "--engines", "--samples", "2", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)["engines"]
    assert max(found["a"].values()) < 1e-12 > max(found["b"].values())
    assert found["pair"]["passed"]
    command.main([str(pair[0]), str(pair[0]), "--engines", "--samples", "1"])
    assert "not compared" in capsys.readouterr().out


def test_one_degree_of_freedom(tmp_path):
    inertial = "<mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/>"
    (tmp_path / "a.urdf").write_text(
        f"<robot name='r'><link name='w'/><link name='l'><inertial>{inertial}</inertial></link>"
        "<joint name='j' type='continuous'><parent link='w'/><child link='l'/></joint></robot>"
    )
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
