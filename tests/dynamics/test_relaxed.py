"""The input nearest to zero within its bounds, and the commands that are speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn.description.rig import CommandKind
from tests.support.arms import PROJECTIONS


@pytest.mark.parametrize(
    ("bounds", "nearest"), [((1.0, 5.0), 1.0), ((-3.0, -2.0), -2.0), ((-1.0, 1.0), 0.0)], ids=str
)
def test_the_relaxed_input_is_the_one_nearest_to_zero(bounds, nearest) -> None:
    robot = softdyn.load("finger").robot
    first, second = robot.actuators
    first = replace(first, lower=bounds[0], upper=bounds[1])
    model = softdyn.build(replace(robot, actuators=(first, second)))
    np.testing.assert_array_equal(model.relaxed, [nearest, 0.0])
    model.relaxed[:] = 9.0  # an array of the caller's own
    np.testing.assert_array_equal(model.relaxed, [nearest, 0.0])


@pytest.mark.parametrize("which", PROJECTIONS)
def test_projected_models_have_it_too(which, tmp_path) -> None:
    model = PROJECTIONS[which](tmp_path)
    assert model.relaxed.shape == (model.nu,)
    assert (model.u_min <= model.relaxed).all()
    assert (model.relaxed <= model.u_max).all()


def test_the_commands_that_are_speeds() -> None:
    robot = softdyn.load("spirob").robot
    kinds = (CommandKind.LENGTH, CommandKind.VELOCITY, CommandKind.FORCE)
    actuators = tuple(
        replace(one, command=kind) for one, kind in zip(robot.actuators, kinds, strict=True)
    )
    np.testing.assert_array_equal(replace(robot, actuators=actuators).speeds, [False, True, False])
