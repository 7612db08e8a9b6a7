"""The pull that buckles an arm at the begin of a path."""

from __future__ import annotations

import numpy as np

from softdyn import Reference, SetPoint, load, statics
from softdyn.controllers import Mpc
from softdyn.controllers.predictive import buckling, rest_target
from softdyn.controllers.predictive.objective import horizon_weights, unseen
from softdyn.controllers.predictive.rest_target import RestTargets
from softdyn.dynamics.derivatives import stiffness
from softdyn.validation import paper
from tests.support.control_cases import robot
from tests.support.predictive_cost import KNOTS


def test_the_least_buckling_input_bends_nothing_and_makes_the_stiffness_singular() -> None:
    model = robot("spirob")
    u = buckling.buckling_input(model)
    assert u is not None
    state = model.state(model.q0, np.zeros(model.nv))
    assert np.abs(state.B @ u).max() < 1e-9 * np.abs(state.B).max() * u.max()
    for share, indefinite in ((0.999, False), (1.001, True)):
        assert (np.linalg.eigvalsh(stiffness(model, model.q0, share * u))[0] < 0) == indefinite


def test_cables_that_cannot_pull_against_each_other_buckle_nothing() -> None:
    for name in ("finger", "helix"):
        model = robot(name)
        assert buckling.buckling_input(model) is None
        law = Mpc(model, targets=RestTargets(model))
        assert not law.buckles
        assert law._on_path is law._usual


def test_a_change_that_the_metric_does_not_see_costs_as_much_as_each_input_alone() -> None:
    R = 2.0 * (np.eye(3) - 1 / 3)  # three cables at 120 degrees
    np.testing.assert_allclose(unseen(R), 4 / 3 * np.full((3, 3), 1 / 3), atol=1e-12)
    np.testing.assert_array_equal(unseen(np.diag([1.0, 2.0])), np.zeros((2, 2)))
    model = robot("spirob")
    together = np.ones(len(KNOTS) * model.nu)
    given = {"horizon": 0.1, "speed": 0.1, "rate": 1e-4, "lag": 0.0}
    free, counted = (horizon_weights(model, KNOTS, **given, blind=b).inputs for b in (False, True))
    assert together @ free @ together < 1e-4 * (together @ counted @ together)


def test_folded_shapes_hold_a_point_that_the_simple_bend_does_not_hold(monkeypatch) -> None:
    monkeypatch.setattr(rest_target, "FOLDED", 60)
    model, y = load("spirob"), paper.set_point("spirob", 1.5).reference(0.0).y  # its own targets
    found = RestTargets(model).find(y, waits=True)
    assert found is not None
    plain = statics.approach(statics.rest(model), y, stay_stable=True)
    assert np.linalg.norm(plain.y - y) > 0.01
    assert len(found) > 1
    for one in found:
        assert one.distance < 1e-6
        assert np.linalg.norm(model.state(one.q, np.zeros(model.nv)).y - y) < 1e-6
        assert np.abs(statics.residual(model, one.q, one.u)).max() < 1e-7
        assert ((one.u >= model.u_min) & (one.u <= model.u_max)).all()
    sums = []
    for one in found:
        poles = statics.balance(model, one.u, one.q).poles.real
        sums.append(max(poles[poles > 0].sum(), rest_target.SLOW))
    assert sums == sorted(sums)


def test_only_a_moving_reference_is_pulled_for_and_two_runs_are_equal() -> None:
    model = robot("spirob")
    state = model.state(model.q0, np.zeros(model.nv))
    far = state.y + np.array([0.1, 0.0, 0.1])
    runs = []
    for _ in range(2):
        law = Mpc(model, targets=RestTargets(model))
        law.reset(0.002)
        moving = [law(state, Reference(far, ydot=[0.0, 0.0, 0.1])).u for _ in range(5)]
        law.reset(0.002)
        still = [law(state, SetPoint(far)).u for _ in range(5)]
        runs.append((moving, still))
    np.testing.assert_array_equal(*runs)
    moving, still = runs[0]
    plain = Mpc(model)
    plain.reset(0.002)
    np.testing.assert_array_equal(still, [plain(state, SetPoint(far)).u for _ in range(5)])
    assert np.abs(np.subtract(moving, still)).max() > 1.0
