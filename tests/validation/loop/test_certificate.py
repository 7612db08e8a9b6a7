"""The true V̇ under a controller against differences of V along the motion."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import softdyn
from softdyn import Ellipse, SetPoint
from softdyn.controllers import (
    CONTROLLERS,
    ClfQp,
    IdClfQp,
    Impedance,
    SoftIdClfQp,
    Staged,
)
from softdyn.controllers.qps.clf import make_clf
from softdyn.dynamics.integrators import step_rk4
from softdyn.validation import Log, certify, simulate
from softdyn.validation.loop.certificate import TrueRate
from tests.support.control_cases import BUNDLED, drawn, robot
from tests.support.refused import refused


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
    controller = law(model)
    true_rate = TrueRate(controller)
    clf = make_clf(getattr(controller, "stage", controller).gains.eps)
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
        Vdot, delta = true_rate(state, reference, command.u, command.V)
        assert Vdot == pytest.approx(rate, abs=1e-3 * scale)
        assert delta == pytest.approx(max(0.0, Vdot + command.V / clf.eps), abs=1e-9 * scale)


@pytest.mark.parametrize("which", BUNDLED)
def test_who_keeps_the_promise(which):
    """ID-CLF-QP and CLF-QP have the model's accelerations; Soft ID-CLF-QP has not."""
    model = robot(which)
    broken = dict.fromkeys(CONTROLLERS, 0)
    for name in ("soft-id-clf-qp", "id-clf-qp", "clf-qp"):
        law = CONTROLLERS[name](model)
        true_rate = TrueRate(law)
        for state, reference in drawn(which):
            command = law(state, reference)
            Vdot, delta = true_rate(state, reference, command.u, command.V)
            scale = command.V / law.gains.eps + abs(Vdot)
            broken[name] += delta > max(command.delta, 0) + 1e-6 * scale
    assert broken["id-clf-qp"] == broken["clf-qp"] == 0
    assert broken["soft-id-clf-qp"] > 0


def test_a_log_has_the_columns_only_if_it_is_certified(tmp_path):
    model = softdyn.load("finger")
    goal = Ellipse(0.08, 0.03, 0.2, 0.5)
    law = SoftIdClfQp(model)
    plain = simulate(model, law, goal, duration=0.02, period=0.0005)
    log = certify(plain, model, law, goal)
    assert plain.Vdot is None
    assert plain.delta_true is None
    np.testing.assert_array_equal(log.u, plain.u)
    assert (log.delta_true >= 0).all()
    slope = np.diff(plain.V) / 0.0005
    middle = (log.Vdot[:-1] + log.Vdot[1:]) / 2
    np.testing.assert_allclose(middle[20:], slope[20:], rtol=0.02)  # V falls fast at first
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
    true_rate = TrueRate(law)
    for goal, stage in ((state.y + 1e-4, law.stages[1]), (state.y + 0.1, law.stages[0])):
        command = law(state, SetPoint(goal))
        assert law.stage is stage
        Vdot, delta = true_rate(state, SetPoint(goal), command.u, command.V)
        assert delta == pytest.approx(max(0.0, Vdot + command.V / stage.gains.eps))


def test_a_law_without_eps_has_no_certificate():
    with refused("controller", "function"):
        TrueRate(lambda state, reference: None)
