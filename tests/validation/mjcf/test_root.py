"""`--root DIR`: includes and meshes above a file's folder, and never beyond that folder."""

from __future__ import annotations

from pathlib import Path

import pytest

import softdyn
from softdyn import InputError
from softdyn.description.visuals import visuals
from tests.support import ROOT
from tests.support.command import command

BODY = """<mujocoinclude><body name="arm"><joint name="hinge" axis="0 1 0" damping="0.1"/>
  <geom type="mesh" mesh="bone" density="1000"/></body></mujocoinclude>"""
ASSET = '<mujocoinclude><asset><mesh name="bone" file="{}"/></asset></mujocoinclude>'
MAIN = """<mujoco><compiler meshdir="../../meshes"/><include file="../common/asset.xml"/>
  <worldbody><include file="../common/body.xml"/></worldbody></mujoco>"""
TRUE = BODY.replace("mujocoinclude>", "worldbody>")
FLAT = f'<mujoco><asset><mesh name="bone" file="bone.stl"/></asset>{TRUE}</mujoco>'


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """The folders models/hand, models/common and meshes, and one file that needs all of them."""
    for name in ("models/hand", "models/common", "meshes", "flat"):
        (tmp_path / name).mkdir(parents=True)
    bone = (ROOT / "urdf/meshes/phalanx.stl").read_bytes()
    for name in ("meshes/bone.stl", "flat/bone.stl"):
        (tmp_path / name).write_bytes(bone)
    (tmp_path / "models/common/asset.xml").write_text(ASSET.format("bone.stl"))
    (tmp_path / "models/common/body.xml").write_text(BODY)
    (tmp_path / "models/hand/hand.xml").write_text(MAIN)
    (tmp_path / "flat/hand.xml").write_text(FLAT)
    return tmp_path


def test_files_below_the_root_are_read_and_others_are_refused_by_the_option(tree):
    words = ("compare", tree / "models/hand/hand.xml", tree / "flat/hand.xml", "--samples", 1)
    refused = command(*words)
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "--root DIR" in refused.err
    assert command(*words, "--root", tree).code == 0
    short = command(*words, "--root", tree / "models")  # the meshes are beyond it
    assert (short.code, "meshes" in short.err) == (2, True)
    assert command(*words, "--root", tree / "none").code == 2


def test_export_reads_below_the_root(tree):
    source, out = tree / "models/hand/hand.xml", tree / "hand.urdf"
    assert command("export", source, "--urdf", out).code == 2
    assert not out.exists()
    assert command("export", source, "--urdf", out, "--root", tree).code == 0
    assert [joint.name for joint in softdyn.parse(out).moving_joints] == ["hinge"]


def test_nothing_beyond_the_root_is_opened(tree, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "body.xml"
    outside.write_text(BODY)
    words = ("compare", tree / "models/hand/hand.xml", tree / "flat/hand.xml", "--root", tree)
    (tree / "models/common/body.xml").unlink()
    (tree / "models/common/body.xml").symlink_to(outside)
    assert command(*words).code == 2
    (tree / "models/hand/hand.xml").write_text(MAIN.replace('"../common/body.xml"', f'"{outside}"'))
    assert command(*words).code == 2


ARM = """<robot name="arm"><link name="base"><visual><geometry><mesh filename="{}"/></geometry>
  </visual></link></robot>"""


@pytest.mark.parametrize(
    ("reference", "root", "seen"),
    [
        ("../meshes/bone.stl", None, False),
        ("../meshes/bone.stl", ".", True),
        ("../meshes/bone.stl", "models", False),
        ("package://meshes/bone.stl", None, False),
        ("package://meshes/bone.stl", ".", True),
        ("package://../meshes/bone.stl", ".", False),
    ],
)
def test_meshes_of_a_urdf_may_lie_below_the_root(tree, reference, root, seen):
    path = tree / "models/arm.urdf"
    path.write_text(ARM.format(reference))
    robot = softdyn.parse(path, root=None if root is None else tree / root)
    shapes, problems = visuals(robot)
    assert (len(shapes) > 0, problems == ()) == (seen, seen)


def test_a_root_that_is_no_folder_is_refused(tree):
    for root in (tree / "none", tree / "flat/hand.xml", 3):
        with pytest.raises(InputError) as refused:
            softdyn.load("finger", root=root)
        assert refused.value.name == "root"
    seen = command("view", "finger", "--html", tree / "page.html", "--root", tree)
    assert seen.code == 0, seen.err


def test_a_plant_reads_below_the_root_and_its_record_says_so(tree):
    scene, plant = ROOT / "docs/examples/finger_scene.xml", tree / "models/hand/scene.xml"
    inner = scene.read_text().partition("<mujoco")[2].partition(">")[2].rpartition("</mujoco>")[0]
    (tree / "models/common/all.xml").write_text(f"<mujocoinclude>{inner}</mujocoinclude>")
    plant.write_text('<mujoco><include file="../common/all.xml"/></mujoco>')
    words = ("run", "finger", "best", "--theta", "0.5", "--duration", "0.02", "--no-verdict")
    words = (*words, "--plant", plant, "--log", tree / "run.npz")
    refused = command(*words)
    assert (refused.code, "--root DIR" in refused.err) == (2, True)
    assert command(*words, "--root", tree).code == 0
    assert command("run", "--from", tree / "run.npz").code == 0
