"""Pinocchio's own MJCF reader, compared with MuJoCo's."""

import pytest

from softdyn import UrdfError
from tests.proof.mjcf.reader_survey import survey_readers
from tests.proof.mjcf.readers import pinocchio_reads
from tests.support.refused import refused

BODY = (
    '<inertial pos="0 0.1 0.2" mass="2" diaginertia="0.1 0.2 0.25"/><joint name="{}" axis="0 {} 1" '
    'armature="0.1"/>'
)
ROBOT = (
    '<mujoco><worldbody><body name="base" {}><body name="arm">' + BODY.format("one", 1)
    + '<body name="hand" pos="0 0 1">' + BODY.format("two", 0)
    + '<joint name="three" type="slide" axis="1 0 0"/></body></body></body>{}</worldbody></mujoco>'
)  # fmt: skip


def test_what_it_reads_right_is_exact(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(ROBOT.format("", ""))
    assert pinocchio_reads(file).exact


@pytest.mark.parametrize(
    ("pose", "more", "why"),
    [
        ('pos="1 2 3" euler="40 0 0"', "", "base of "),  # the pose of a fixed root is lost
        ("", '<body name="b">' + BODY.format("four", 2) + "</body>", "1 joints missing (four)"),
    ],
)
def test_what_it_gets_wrong_is_said(tmp_path, pose, more, why):
    file = tmp_path / "robot.xml"
    file.write_text(ROBOT.format(pose, more))
    found = pinocchio_reads(file)
    assert not found.exact
    assert why in found.why


def test_a_folder_of_files(tmp_path):
    (tmp_path / "robot.xml").write_text(ROBOT.format("", ""))
    (tmp_path / "scene.xml").write_text('<mujoco><include file="robot.xml"/></mujoco>')
    (tmp_path / "evil.xml").write_text('<mujoco><include file="../robot.xml"/></mujoco>')
    (tmp_path / "other.xml").write_text("<robot/>")
    found = survey_readers([str(tmp_path)])
    assert found.exact == 1
    assert {v.file.split("/")[-1]: v.why for v in found.verdicts if not v.exact} == {
        "scene.xml": "a top-level <include> is passed over"
    }
    assert len(found.refused) == 1
    assert "2 MJCFs that MuJoCo reads: 1 exact" in found.summary


def test_pinocchio_opens_no_file_outside_the_folder(tmp_path):
    (tmp_path / "in").mkdir()
    file = tmp_path / "in/robot.xml"
    file.write_text(
        '<mujoco><asset><texture name="t" type="2d" file="../t.png"/></asset>'
        + ROBOT.format("", "").removeprefix("<mujoco>")
    )
    with refused('<texture file="../t.png">', "'../t.png'", by=UrdfError):
        pinocchio_reads(file)
