"""Equilibria with the tip at a point, from shapes that are none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softdyn import statics
from softdyn.statics import StaticsError
from softdyn.statics.unknown_inputs import TargetProblem, balance_at, explore_from
from softdyn.tasks import PoseTask, StackedReference, Target
from tests.support import cart
from tests.support.control_cases import robot


def test_it_finds_the_inputs_that_hold_a_tip_from_other_shapes() -> None:
    model, rng = robot("finger"), np.random.default_rng(0)
    for u in ([-0.2, -0.1], [-0.1, -0.15], [-0.25, 0.05]):
        known = statics.settle(model, u)
        problem = TargetProblem.for_tip(model, known.y)
        start = model.configuration(known.q + rng.uniform(-0.4, 0.4, model.nv))
        found = balance_at(problem, start, np.zeros(model.nu))
        np.testing.assert_allclose(found.y, known.y, atol=1e-6)
        assert found.residual < 1e-8
        assert ((found.u >= model.u_min) & (found.u <= model.u_max)).all()
        np.testing.assert_allclose(found.u, known.u, atol=1e-4)


def test_a_point_out_of_reach_is_a_statics_error() -> None:
    model = robot("finger")
    problem = TargetProblem.for_tip(model, np.array([1.0, 0.0, 0.0]))
    with pytest.raises(StaticsError, match="no equilibrium of finger at the target"):
        balance_at(problem, model.q0, np.zeros(model.nu))


def test_a_robot_that_no_force_holds_can_be_searched() -> None:
    model, target = cart.cart(-1.0, 1.5, stiffness=0.0), np.array([cart.LENGTH + 0.5, 0.0, 0.0])
    search = statics.inputs_for_tip(model, target, shapes=4, seconds=math.inf)
    assert search.nearest.residual < 1e-6


def test_any_errors_can_be_the_goal() -> None:
    """A pose of the tip has six errors; two inputs hold those of a known equilibrium."""
    model = robot("finger")
    known = statics.settle(model, [-0.2, -0.1])
    tip = model.robot.task
    goal = StackedReference({"pose": Target(model.link_poses(known.q)[tip])})
    measure = statics.TaskSearch((PoseTask(tip, name="pose"),), goal, ()).measure
    problem = TargetProblem.build(statics.rest(model), measure)
    start = model.configuration(known.q + 0.2), np.zeros(model.nu)
    for found in (balance_at(problem, *start), explore_from(problem, *start)):
        np.testing.assert_allclose(found.q, known.q, atol=1e-6)
        np.testing.assert_allclose(found.u, known.u, atol=1e-6)
