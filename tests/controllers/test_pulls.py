"""Pulls that make up for the friction of cables: best factors, dead band, closed loops."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn.actuation import Capstan
from softdyn.controllers import Compensated, Mpc, SoftIdClfQp, best
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.controllers.predictive.pulls import HORIZON, ORDERED, REST, FrictionPulls
from softdyn.controllers.staged import Staged
from softdyn.validation import Rig, paper, simulate
from tests.support.cable_chains import rubbing
from tests.support.refused import refused


@pytest.mark.parametrize("name", ["finger", "helix", "spirob"])
def test_the_factors_are_the_least_squares_of_the_joint_forces(name: str) -> None:
    """The directions come from an own solve, the moment arms from central differences by u."""
    model, rng = rubbing(name), np.random.default_rng(3)
    S = stiffness_at_rest(model, HORIZON)[1]
    capstan, pulls = Capstan(model), FrictionPulls(model)
    for _ in range(5):
        state = model.state(
            model.integrate(model.q0, 0.2 * rng.normal(size=model.nv)), rng.normal(size=model.nv)
        )
        u = rng.uniform(0.3, 0.6, model.nu) * model.u_max
        lost = rng.normal(size=model.nv)
        M, D = state.M, state.D
        matrix = M + ORDERED * D + ORDERED**2 * np.diag(model.stiffness)
        force = state.B @ u - state.h + lost
        ordered = np.linalg.solve(matrix, (M + ORDERED * D) @ state.v + ORDERED * force)
        guides = capstan.at(state)
        slid = -guides.arms_beyond @ ordered
        direction = slid / np.hypot(slid, REST * np.abs(guides.arms_beyond).sum(axis=1) + 1e-150)
        root = np.linalg.inv(np.linalg.cholesky(S))
        found = pulls(u, state, lost)
        for k in range(model.nu):
            one = np.eye(model.nu)[k] * u[k]
            wanted = state.B @ one
            rubbed = wanted + guides.forces(one, direction)
            factor = np.linalg.lstsq((root @ rubbed)[:, None], root @ wanted, rcond=None)[0][0]
            expected = min(max(factor * u[k], model.u_min[k]), model.u_max[k])
            assert found[k] == pytest.approx(expected, rel=1e-9)
            if model.u_min[k] < found[k] < model.u_max[k] and found[k] != 0:
                assert pulls.inputs(found)[k] == pytest.approx(u[k])


def test_a_robot_at_rest_gets_what_was_asked_for_and_motion_gets_more() -> None:
    model = rubbing("finger")
    pulls, u = FrictionPulls(model), np.array([0.3, 0.4])
    state = model.state([0.3, 0.2, 0.1, 0.4], np.zeros(4))
    holding = state.h - state.B @ u
    np.testing.assert_allclose(pulls(u, state, holding), u, rtol=1e-12)
    assert (pulls(u, state, holding + state.B @ u) > u).all()
    assert (pulls(u, state, holding - state.B @ u) < u).all()
    np.testing.assert_array_equal(pulls(model.u_max, state, state.h), model.u_max)


@pytest.mark.parametrize("law", ["mpc", "wrapped"])
def test_without_friction_nothing_changes(law: str) -> None:
    model, logs = softdyn.load("finger"), []
    for friction in (None, 0.0):
        if law == "mpc":
            controller = Mpc(model, lag=0.02, friction=friction)
        else:
            controller = Compensated(SoftIdClfQp(model), model, friction=friction)
        assert not controller._pulls.rubs
        logs.append(simulate(model, controller, paper.set_point("finger", 0.5), duration=0.1))
    np.testing.assert_array_equal(logs[0].u, logs[1].u)


def test_a_controller_without_an_estimate_of_disturbances_tracks_with_known_friction() -> None:
    model, path = softdyn.load("finger"), paper.tracking("finger", omega=0.3)

    def error(mu: float, known: float) -> float:
        law = Compensated(SoftIdClfQp(model), model, friction=known)
        log = simulate(model, law, path, rig=Rig(friction=mu))
        return float(np.mean(np.sum(log.error[len(log.t) // 2 :] ** 2, axis=1)))

    ideal, unknown, known = error(0.0, 0.0), error(0.1, 0.0), error(0.1, 0.1)
    assert unknown > 5 * ideal
    assert known < 2 * ideal


def test_friction_is_the_file_s_unless_it_is_given() -> None:
    assert best(rubbing("finger"))._pulls.rubs
    assert not best(rubbing("finger"), friction=0.0)._pulls.rubs
    assert isinstance(best(softdyn.load("spirob")).inner, Staged)
    rubs = best(softdyn.load("spirob"), friction=0.1).inner
    assert isinstance(rubs, Compensated)
    assert isinstance(rubs.inner, Staged)
    assert isinstance(best(softdyn.load("spirob"), friction=0.1, lag=0.02), Mpc)
    model = softdyn.load("finger")
    for wrong in (-0.1, np.nan, 11.0, [0.1], "much"):
        with refused("friction"):
            best(model, friction=wrong)
        with refused("friction"):
            Compensated(SoftIdClfQp(model), model, friction=wrong)
