"""The largest force of a joint's actuators, by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softdyn.validation.mjcf.comparison.drives import largest_force
from softdyn.validation.mjcf.comparison.dynamics import random_states
from softdyn.validation.mjcf.comparison.neutral import Motor
from softdyn.validation.mjcf.comparison.side import neutral

ARM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
<geom size="0.1" mass="1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("gear", "limits", "more", "expected"),
    [
        (2.0, (-3.0, 1.0), {}, 6.0),
        (-2.0, (-3.0, 1.0), {}, 6.0),
        (2.0, (-np.inf, np.inf), {}, np.inf),
        (0.0, (-np.inf, np.inf), {}, 0.0),  # an actuator that pulls nothing
    ],
)
def test_a_motor_s_largest_force(tmp_path: Path, gear, limits, more, expected) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    robot = neutral(tmp_path / "arm.xml")
    (k,) = (k for k, part in enumerate(robot.parts) if part.name == "hinge")
    driven = replace(robot, motors=(Motor("u", "joint:hinge", gear, *limits, more=more),))
    assert largest_force(driven, k, random_states(driven, 3, 0)) == expected
