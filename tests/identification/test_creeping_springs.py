"""Shares and times of Maxwell branches from motion: derivatives; intervals that hold the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import identification
from softdyn.dynamics.mimic import build
from softdyn.identification import trajectory
from softdyn.identification.parameters import apply_values
from softdyn.identification.trajectory import Start, creeping_springs, follow
from softdyn.identification.unknowns.kinds import Around
from softdyn.identification.unknowns.relaxation import shares
from tests.support.creep_decays import UNKNOWNS, decay, fitted, spring_hinge


@pytest.fixture(scope="module")
def finger() -> softdyn.SoftModel:
    robot = softdyn.load("finger").robot
    branches = ((0.002, 0.05), (0.004, 0.01))
    joints = tuple(
        replace(one, relaxation=branches if one.stiffness else ()) for one in robot.joints
    )
    return build(replace(robot, joints=joints))


def test_the_derivatives_of_a_motion_with_branches(finger, monkeypatch) -> None:
    monkeypatch.setattr(trajectory, "TOLERANCE", 1e-12)
    rng = np.random.default_rng(2)
    several = [
        one
        for kind in ("relaxation_share", "stiffness", "relaxation_time")
        for one in identification.parameters(finger, kind)
    ]
    t = np.cumsum(rng.uniform(0.003, 0.008, 20))
    u = rng.uniform(finger.u_min, finger.u_max, (20, finger.nu))
    theta = np.array([one.nominal for one in several]) * rng.uniform(0.8, 1.2, len(several))
    measured = np.cumsum(rng.normal(size=(20, 4)), 0) * 0.05

    def path(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        changed = apply_values(finger, several, at)
        creep = creeping_springs(changed, several, len(at))
        none = np.zeros((4, len(at)))
        start = Start(np.zeros(4), np.zeros(4), none, none, creep.along(t, measured))
        return follow(changed, several, t, u, start, around=Around(finger))

    _, slope = path(theta)
    for k in rng.choice(len(theta), 8, replace=False):
        step = np.zeros(len(theta))
        step[k] = 1e-5 * theta[k]
        difference = (path(theta + step)[0] - path(theta - step)[0]) / (2 * step[k])
        assert slope[:, :, k] == pytest.approx(difference, abs=1e-6 * np.abs(difference).max())


def test_a_spring_of_another_stiffness_keeps_its_shares(finger) -> None:
    several = identification.parameters(finger, "stiffness", shared=True)
    found = apply_values(finger, several, np.array([3.0]))
    assert shares(found.robot) == pytest.approx(shares(finger.robot))
    assert found.stiffness == pytest.approx(3.0 * finger.stiffness)


def test_share_and_time_from_a_step_and_its_decay() -> None:
    inside = fitted(spring_hinge(), decay(spring_hinge(), 1))
    assert sorted(inside) == sorted(UNKNOWNS)
    assert all(inside.values())
