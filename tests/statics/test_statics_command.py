"""The command `softdyn statics`."""

import json

import pytest

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
    assert "expected 0 numbers, got 1" in done.err
