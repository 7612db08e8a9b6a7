"""A certified controller's V̇ against differences of V along the motion."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import softdyn
from softdyn import Ellipse, InputError, SetPoint
from softdyn.controllers import (
    CONTROLLERS,
    Certified,
    ClfQp,
    IdClfQp,
    Impedance,
    SoftIdClfQp,
    Staged,
)
from softdyn.controllers.qps.clf import make_clf
from softdyn.dynamics.integrators import step_rk4
from softdyn.validation import Log, simulate
from tests.support.control_cases import BUNDLED, drawn, robot


@pytest.mark.parametrize(
    ("law", "which"),
    [
        *itertools.product((SoftIdClfQp, IdClfQp, ClfQp, Impedance), ("finger", "helix", "spirob")),
        (Staged, "spirob"),
    ],
)
def test_the_rate_is_that_of_V_along_the_motion(law, which):
    """A short motion from every state under the held input, towards a moving reference."""
    model, h = robot(which), 2e-7
    controller = Certified(law(model))
    clf = make_clf(getattr(controller.law, "stage", controller).gains.eps)
    for state, reference in drawn(which, 6):

        def V(q, v, t, reference=reference, state=state):
            y = reference.y + t * reference.ydot + t * t / 2 * reference.yddot
            now = model.state(q, v)
            eta = np.concatenate((now.y - y, now.ydot - reference.ydot - t * reference.yddot))
            return clf.decrease(eta)[0]

        command = controller(state, reference)

        def central(h, u=command.u, state=state, V=V):
            ends = (step_rk4(model, state.q, state.v, u, t) for t in (h, -h))
            return np.subtract(*(V(*end, t) for end, t in zip(ends, (h, -h), strict=True))) / (
                2 * h
            )

        rate = (4 * central(h) - central(2 * h)) / 3
        scale = abs(rate) + command.V / clf.eps
        assert command.Vdot == pytest.approx(rate, abs=1e-3 * scale)
        assert command.delta_true == pytest.approx(
            max(0.0, command.Vdot + command.V / clf.eps), abs=1e-9 * scale
        )


@pytest.mark.parametrize("which", BUNDLED)
def test_who_keeps_the_promise(which):
    """ID-CLF-QP and CLF-QP have the model's accelerations; Soft ID-CLF-QP has not."""
    model = robot(which)
    broken = dict.fromkeys(CONTROLLERS, 0)
    for name in ("soft-id-clf-qp", "id-clf-qp", "clf-qp"):
        law = Certified(CONTROLLERS[name](model))
        for state, reference in drawn(which):
            command = law(state, reference)
            scale = command.V / law.gains.eps + abs(command.Vdot)
            broken[name] += command.delta_true > max(command.delta, 0) + 1e-6 * scale
    assert broken["id-clf-qp"] == broken["clf-qp"] == 0
    assert broken["soft-id-clf-qp"] > 0


def test_a_log_has_the_columns_only_where_a_law_is_certified(tmp_path):
    model = softdyn.load("finger")
    goal = Ellipse(0.08, 0.03, 0.2, 0.5)
    plain = simulate(model, SoftIdClfQp(model), goal, duration=0.05, period=0.005)
    log = simulate(model, Certified(SoftIdClfQp(model)), goal, duration=0.05, period=0.005)
    assert plain.Vdot is None
    assert plain.delta_true is None
    np.testing.assert_array_equal(log.u, plain.u)
    assert (log.delta_true >= 0).all()
    assert log.controller == plain.controller
    for one in (plain, log):
        one.save(tmp_path / "a.npz")
        again = Log.load(tmp_path / "a.npz")
        np.testing.assert_equal(again.Vdot, one.Vdot)
        np.testing.assert_equal(again.delta_true, one.delta_true)


def test_a_law_of_two_stages_is_judged_by_the_eps_of_the_present_one():
    model = robot("spirob")
    law = Staged(model)
    law.reset(1.0)  # longer than the schedule's dwell: near the goal the second stage begins
    state = model.state(model.q0, np.full(model.nv, 0.1))
    judged = Certified(law)
    for goal, stage in ((state.y, law.stages[1]), (state.y + 0.1, law.stages[0])):
        command = judged(state, SetPoint(goal))
        assert law.stage is stage
        claimed = command.Vdot + command.V / stage.gains.eps
        assert command.delta_true == pytest.approx(max(0.0, claimed))


def test_a_law_without_eps_has_no_certificate():
    with pytest.raises(InputError, match="Gains"):
        Certified(lambda state, reference: None)
