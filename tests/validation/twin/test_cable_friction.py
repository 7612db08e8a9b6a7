"""Friction of cables in the twin: it sticks, agrees with the model, and is absent without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel, statics
from softdyn.actuation import Capstan
from softdyn.description.robot import PathEnd
from softdyn.validation import Rig, Twin, crosscheck, rollout
from tests.support.cable_chains import random_arm, rubbing
from tests.support.refused import refused
from tests.support.robots import build, changed, slide
from tests.support.wrapped_robots import wrapped_robot


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_stuck_arm_does_not_creep(seed: int, tmp_path: Path) -> None:
    """It carries its weight between both rests, and moves less than 0.1 mm in 10 s."""
    twin = Twin(random_arm(seed, tmp_path), rig=True)
    u = np.full(twin.nu, -3.0)
    twin.advance(u, 2_000)
    twin.advance(0.9 * u, 4_000)
    before = twin.tip
    twin.advance(0.9 * u, 20_000)
    assert np.linalg.norm(twin.tip - before) < 0.1e-3
    assert twin.cable_friction is not None
    rows, end = twin.cable_friction.rows, twin.data.ne + twin.data.nf
    limits = twin.model.tendon_frictionloss[rows]
    assert (np.abs(twin.data.efc_force[end - len(rows) : end]) < 0.99 * limits).any()


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_tensions_and_joint_forces_are_those_of_the_model(seed: int, tmp_path: Path) -> None:
    found = crosscheck(random_arm(seed, tmp_path), samples=10, trajectories=False)
    (check,) = (check for check in found.checks if check.quantity == "friction")
    assert check.max_error < 1e-12


def test_hysteresis_is_that_of_the_model(tmp_path: Path) -> None:
    """The cable is pulled slowly to 4 N, and paid out to 3 N, where it still sticks in part."""
    model = random_arm(3, tmp_path)
    capstan, twin = Capstan(model), Twin(model, rig=True)
    twin.advance([0.0], 4000)
    pulls = [2.0, 4.0, 3.5, 3.0]
    before, tips = 0.0, []
    for pull in pulls:
        for part in np.linspace(0, 1, 1001)[1:]:
            twin.advance([-before - part * (pull - before)], 8)
        before = pull
        tips.append(twin.tip)
    start = statics.settle(model, np.zeros(1)).q
    fine = np.concatenate((np.linspace(0, 4, 5)[1:], np.linspace(4, 3, 33)[1:]))
    rests = statics.follow(capstan, -fine[:, None], start)
    expected = [rests[k].y for k in (1, 3, 19, 35)]
    raised, paid_out = statics.rest_interval(capstan, [-3.0])
    width = np.linalg.norm(raised.y - paid_out.y)
    assert width > 3e-3
    np.testing.assert_allclose(tips, expected, atol=0.01 * width)


def test_without_friction_or_without_a_rig_the_plant_is_the_same() -> None:
    ideal, rubs = softdyn.load("spirob"), rubbing("spirob")
    assert Twin(ideal, rig=True).cable_friction is None
    assert Twin(rubs).model.ntendon == Twin(ideal, rig=True).model.ntendon == 3

    def end(model: SoftModel, rig: Rig | str | None) -> np.ndarray:
        return rollout(model, [1.0, 0.5, 0.2], duration=0.1, rig=rig).q[-1]

    free = end(ideal, None)
    for model, rig in ((ideal, "file"), (rubs, None), (rubs, Rig(file=False))):
        np.testing.assert_array_equal(end(model, rig), free)
    stuck = end(rubs, "file")
    for rig in (Rig(friction=0.1), Rig(file=False, friction=0.1)):
        np.testing.assert_array_equal(end(ideal, rig), stuck)
    assert np.abs(stuck - free).max() > 1e-4


@pytest.mark.parametrize("wrong", [-0.1, 11.0, "much"])
def test_a_rig_refuses_impossible_friction(wrong: object) -> None:
    with refused("friction"):
        Rig(friction=wrong)  # type: ignore[arg-type]


PIN = '<cylinder link="base" xyz="0 0 0.5" axis="0 1 0" radius="0.02" side="0 0 0.6"/>'
HOIST = slide(
    0.5, 1e-4, axis="0 0 1", limit=(-0.3, 0.3), damping=2, pull=(0, 30), gear=-1,
    path=("base -0.02 0 -0.2", PIN, "block 0.02 0 0"), tendon={"friction": 0.25},
)  # fmt: skip


@pytest.mark.parametrize(("own", "mu"), [("", 0.25), ('friction="0" ', 0.0)])
def test_a_rope_over_a_pin_lifts_a_load_beyond_euler_s_pull(own: str, mu: float) -> None:
    """Between weight / e^(μπ) and weight · e^(μπ) it sticks; over a pulley it follows at once."""
    model = build(changed(HOIST, ('radius="0.02" ', f'radius="0.02" {own}')))
    weight, factor = 0.5 * 9.81, np.exp(mu * np.pi)
    cases = (factor * 1.05, 1), (factor / 1.05, 0), (1.05 / factor, 0), (0.95 / factor, -1)
    for pull, moves in cases:
        twin = Twin(model, rig=True, timestep=1e-3)
        twin.advance([weight], 1)  # the friction is that of the step before
        twin.advance([pull * weight], 300)
        moved = float(twin.qpos[0])
        expected = moves if mu else np.sign(pull - 1.0)
        assert np.sign(moved) * (abs(moved) > 1e-3) == expected, (pull, moved)
    found = crosscheck(model, samples=4, trajectories=False)
    (check,) = (check for check in found.checks if check.quantity == "friction") if mu else (None,)
    assert check is None or check.max_error < 1e-12


@pytest.mark.parametrize(("seed", "driven"), [(2, "first"), (2, "last"), (7, "last")])
def test_cables_around_round_bodies_rub_as_in_the_model(seed: int, driven: str) -> None:
    robot = wrapped_robot(seed, 2, inside=False)
    tendons = [
        replace(
            tendon, friction=0.3, driven=PathEnd(driven),
            wraps=tuple(
                replace(wrap, friction=(None, 0.0, 0.6)[k % 3])
                for k, wrap in enumerate(tendon.wraps)
            ),
        )
        if tendon.wraps
        else tendon
        for tendon in robot.tendons
    ]  # fmt: skip
    model = softdyn.build(replace(robot, tendons=tuple(tendons)))
    found = crosscheck(model, samples=4, trajectories=False)
    (check,) = (check for check in found.checks if check.quantity == "friction")
    assert check.max_error < 1e-12
