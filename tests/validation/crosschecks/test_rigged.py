"""The cross-check of rigs: both engines have the same rig, and every difference is seen."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.actuation import Winches
from softdyn.description.rig import CommandKind
from softdyn.validation import Twin, crosscheck
from softdyn.validation.crosschecks import crosscheck as judged
from softdyn.validation.crosschecks.rigged import (
    RIG_SCALES,
    RIG_TOLERANCES,
    RigMotion,
    quantities_of,
)
from tests.support import rigs, robots
from tests.support.command import command
from tests.support.random_robots import write_robot


@pytest.fixture
def arm(tmp_path: Path) -> SoftModel:
    return robots.load(tmp_path, robots.WINCHED)


def errors(
    model: SoftModel, twin: SoftModel | None = None, seed: int = 0, moves: bool = True
) -> dict[str, float]:
    """Errors of the rig's quantities in the same order as a report has them."""
    tally = judged.Tally()
    wanted = [name for name in quantities_of(model) if moves or name != "rigged"]
    judge = Twin(model if twin is None else twin, limits=False)
    judged._compare_rigs(tally, model, judge, wanted, 3, seed, lambda _text: None)
    assert not tally.reasons
    return {name: tally.errors[name] for name in wanted}


def changed(model: SoftModel, **fields: Any) -> SoftModel:
    """The robot with other actuators."""
    actuators = tuple(replace(actuator, **fields) for actuator in model.robot.actuators)
    return softdyn.build(replace(model.robot, actuators=actuators))


def speeds(model: SoftModel) -> SoftModel:
    return changed(model, command=CommandKind.VELOCITY, stiffness=400.0, length_upper=0.38)


def wound(model: SoftModel, **fields: Any) -> SoftModel:
    """The robot with another first motor, its winch."""
    first, *others = model.robot.actuators
    return softdyn.build(replace(model.robot, actuators=(replace(first, **fields), *others)))


def bounded(model: SoftModel) -> SoftModel:
    return changed(speeds(model), rate=2.0, lag=0.01)


@pytest.mark.parametrize(
    "make",
    [
        lambda m: m,
        speeds,
        lambda m: changed(m, rate=3.0),
        bounded,
        lambda m: wound(m, offset=-0.02, length_upper=0.38),
    ],
)
def test_both_engines_have_the_same_rig(arm: SoftModel, make: Any) -> None:
    """Winches with lag and delay, slack, every kind of sensor, and a bound of one side only."""
    found = errors(make(arm))
    assert list(found) == [name for name in RIG_SCALES if name != "friction"]
    assert max(found.values()) < 1e-12


def test_a_floating_robot_with_a_rig(tmp_path: Path) -> None:
    model = robots.load(tmp_path, robots.WINCHED, floating=True)
    found = errors(model)
    assert "rigged" in found
    assert max(found.values()) < 1e-11


def test_accelerometers_of_a_robot_with_followers(tmp_path: Path) -> None:
    """MuJoCo's accelerations lack the ties; a trajectory with the rig is not compared."""
    found = errors(rigs.measured(robots.load(tmp_path, robots.GRIPPER)))
    assert list(found) == ["tension", "rigged qdd", "sensors"]
    assert max(found.values()) < 1e-11


def test_a_trajectory_with_a_rig_of_a_robot_with_followers(tmp_path: Path) -> None:
    """MuJoCo's forces, activations and delays; the ties and the step are ours."""
    gripper = robots.load(tmp_path, robots.GRIPPER)
    followed = 0
    for seed in range(4):
        found = errors(rigs.random_rig(gripper, seed), seed=seed)
        followed += "rigged" in found
        assert max(found.values()) < 1e-9
    assert followed


def test_random_robots_with_random_rigs(tmp_path: Path) -> None:
    followed = rubbed = 0
    for seed in range(1, 13):
        model = rigs.random_rig(softdyn.load(write_robot(seed, tmp_path)), seed)
        found = errors(model, seed=seed)
        followed += "rigged" in found
        assert all(found[name] < RIG_TOLERANCES[name] for name in found)
        rubbed += "friction" in found
        assert "sensors" in found
    assert followed >= 2
    assert rubbed >= 6


@pytest.mark.parametrize(
    ("fields", "seen"),
    [
        ({"stiffness": 610.0}, {"inputs", "tension", "rigged qdd", "sensors", "rigged"}),
        ({"damping": 4.1}, {"inputs", "tension", "rigged qdd", "sensors", "rigged"}),
        ({"upper": 10.0}, {"inputs", "tension", "rigged qdd", "sensors", "rigged"}),
        ({"lag": 0.021}, {"rigged"}),
        ({"delay": 0.0046}, {"rigged"}),  # one step more
        ({"delay": 0.0042}, set()),  # the same steps
        ({"rate": 1.0}, {"rigged"}),
        ({"offset": 1e-4}, {"inputs", "tension", "rigged qdd", "sensors", "rigged"}),
    ],
)
def test_a_rig_that_differs_is_seen(arm: SoftModel, fields: Any, seen: set[str]) -> None:
    found = errors(arm, wound(arm, **fields))
    assert {name for name, error in found.items() if error > 1e-8} == seen


@pytest.mark.parametrize("place", range(8))
def test_a_sensor_that_differs_is_seen(arm: SoftModel, place: int) -> None:
    sensors = list(arm.robot.sensors)
    moved = sensors[place]
    if moved.link:
        sensors[place] = replace(moved, xyz=(0.0, 0.02, 0.03), rpy=(0.2, 0.1, 0.0))
    elif moved.tendon:
        sensors[place] = replace(moved, tendon={"above": "below"}.get(moved.tendon, "above"))
    else:
        sensors[place] = replace(moved, joint="shoulder")
    found = errors(arm, softdyn.build(replace(arm.robot, sensors=tuple(sensors))), moves=False)
    assert {name for name, error in found.items() if error > 1e-8} == {"sensors"}


def test_a_motion_has_the_closed_form_of_lag_and_delay(arm: SoftModel) -> None:
    """The extensor's acting force after a step: delay of 3 steps, then 1 - e^(-t/λ)."""
    h = 1e-3
    start, held = (arm.q0, np.zeros(arm.nv)), np.array([1.0, 0.0])  # the flexor stays slack
    motion = RigMotion(Winches(arm), start, held, h)
    for k in range(40):
        motion.step(np.array([1.0, 5.0]))
        expected = 5.0 * (1.0 - math.exp(-max(k - 2, 0) * h / 0.01))
        assert motion._held[1] == pytest.approx(expected, abs=1e-12)


def test_the_command_reports_the_rig(arm: SoftModel, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    path = str(arm.robot.path)
    found = command("crosscheck", path, "--samples", 2, "--states-only", "--json", report)
    assert found.code == 0, found.err
    names = [check["quantity"] for check in json.loads(report.read_text())["checks"]]
    assert names[-4:] == ["inputs", "tension", "rigged qdd", "sensors"]


def test_a_robot_without_a_rig_has_no_such_quantities() -> None:
    for name in ("finger", "spirob"):
        assert quantities_of(softdyn.load(name)) == ()
    result = crosscheck(softdyn.load("finger"), samples=1, trajectories=False)
    assert tuple(check.quantity for check in result.checks) == judged.QUANTITIES[:-1]
