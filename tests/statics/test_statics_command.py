"""The command `softdyn statics`."""

import json

import numpy as np
import pytest

import softdyn
from softdyn import statics
from tests.support import robots
from tests.support.command import command
from tests.support.robots import TURRET

# 1 kg on a spring of 100 N/m, and no input
WEIGHT = robots.slide(1, 1e-4, axis="0 0 1", stiffness=100, damping=1)


@pytest.mark.parametrize("words", [(), ("--inputs",)])
def test_a_robot_without_inputs_rests_somewhere(tmp_path, words):
    file = robots.write(tmp_path, WEIGHT)
    done = command("statics", file, *words, "--hold", "0.1", "--json", "-")
    assert done.code == 0, done.err
    assert json.loads(done.out)["rest"]["y"][2] == pytest.approx(-9.81 / 100)
    done = command("statics", file, "--inputs", "0")
    assert (done.code, done.out) == (2, "")
    assert "expected none, because the robot has no inputs, got 1" in done.err


@pytest.mark.parametrize("width", [0.0, 1e-9])
def test_a_preload_is_a_constant_force_and_no_unknown(tmp_path, width):
    path = robots.write(tmp_path, robots.preloaded(5.0, 5.0 + width))
    target = [*map(str, robots.PRELOADED_TIP)]
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


def test_a_turret_whose_continuous_joint_nothing_holds(tmp_path):
    """It rests at any angle of `pan`, under no torque of its motor: neutral, as by hand."""
    file = robots.write(tmp_path, TURRET)
    words = ("statics", file, "--rays", "8", "--spread", "10", "--hold", "0.2")
    done = command(*words)
    assert done.code == 0, done.err
    assert "nan" not in done.out
    assert "0 stable equilibria sampled, " in done.out
    model = softdyn.load(file)
    found = list(statics.sample_rests(model, 8))
    assert len(found) > 40
    for one in found:
        assert one.neutral
        assert one.u[0] == 0.0
        np.testing.assert_allclose(np.abs(one.loose), [[1], [0], [0]], atol=1e-9)
    pans = [model.coordinates(one.q)[0] for one in found]
    assert max(pans) - min(pans) > 2  # all around
    # the same equilibria as of the turret without the turn, by the same inputs
    fixed = robots.build(robots.changed(
        TURRET, ('name="pan" type="continuous"', 'name="pan" type="fixed"'),
        (robots.cable("pan_t", "pan 1"), ""), (robots.motor("pan_t", name="pan_m"), ""),
    ))  # fmt: skip
    for one in found[::7]:
        alone = statics.settle(fixed, one.u[1:], model.coordinates(one.q)[1:])
        np.testing.assert_allclose(alone.q, model.coordinates(one.q)[1:], atol=1e-8)
        np.testing.assert_allclose(alone.y[2], one.y[2], atol=1e-9)
        np.testing.assert_allclose(np.abs(alone.y[0]), np.hypot(*one.y[:2]), atol=1e-9)


def test_a_target_behind_a_turret(tmp_path):
    """163° of `pan`: the tip of the arm level at 0.2 m from the axis, turned."""
    file = robots.write(tmp_path, TURRET)
    model = softdyn.load(file)
    level = statics.settle(model, np.array([0.0, 0.0]))
    radius, height = np.hypot(*level.y[:2]), level.y[2]
    angle = np.deg2rad(163)
    target = [radius * np.cos(angle), radius * np.sin(angle), height]
    done = command("statics", file, "--target", *map(str, target),
                   "--hold", "0.2", "--json", "-")  # fmt: skip
    assert done.code == 0, done.err
    closest = json.loads(done.out)["targets"][0]["closest"]
    assert closest["distance_cm"] < 0.01
    assert closest["neutral"]
