"""The command `softdyn statics`."""

import json

import pytest

from tests.support import preloaded
from tests.support.command import command

# 1 kg on a spring of 100 N/m, and no input
WEIGHT = """<robot name="weight"><link name="base"/><link name="a"><inertial><mass value="1"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
<joint name="sa" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="9" velocity="9"/><dynamics stiffness="100" damping="1"/></joint>
</robot>"""


@pytest.mark.parametrize("words", [(), ("--inputs",)])
def test_a_robot_without_inputs_rests_somewhere(tmp_path, words):
    (tmp_path / "weight.urdf").write_text(WEIGHT)
    done = command("statics", tmp_path / "weight.urdf", *words, "--hold", "0.1", "--json", "-")
    assert done.code == 0, done.err
    assert json.loads(done.out)["rest"]["y"][2] == pytest.approx(-9.81 / 100)
    done = command("statics", tmp_path / "weight.urdf", "--inputs", "0")
    assert (done.code, done.out) == (2, "")
    assert "expected none, because the robot has no inputs, got 1" in done.err


@pytest.mark.parametrize("width", [0.0, 1e-9])
def test_a_preload_is_a_constant_force_and_no_unknown(tmp_path, width):
    path = tmp_path / "arm.urdf"
    path.write_text(preloaded.text(5.0, 5.0 + width))
    target = [*map(str, preloaded.TARGET)]
    done = command(
        "statics", path, "--target", *target, "--hold", "0.2", "--rays", "4", "--json", "-"
    )
    assert done.code == 0, done.err
    closest = json.loads(done.out)["targets"][0]["closest"]
    assert closest["u"] == pytest.approx([9.405, 5.0], abs=1e-3)
    assert closest["distance_cm"] < 0.01
    done = command("check", path, "--samples", "4")
    assert done.code == 0, done.out
    assert "1 input moves 1 of 2 directions" in done.out
    assert "preload moves nothing: its bounds hold it at 5" in done.out
    done = command(
        "observe", path, "--target", *target, "--sensors", "joints=0.001@500", "--seconds", "0.2"
    )
    assert done.code == 0, done.err
