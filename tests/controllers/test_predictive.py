"""The parts of predictive control: the filter, and targets of shape and input."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn import Reference, SetPoint
from softdyn.controllers import Mpc
from softdyn.controllers.predictive.rest_target import RestTarget, RestTargets
from softdyn.controllers.predictive.state_filter import StateFilter
from softdyn.validation import paper, simulate
from softdyn.validation.twin.rig import Rig
from tests.support import predictive_cost
from tests.support.control_cases import robot
from tests.support.predictive_cost import KNOTS


def run_filter(
    noise: float | np.ndarray, push: float, steps: int = 600, coupling: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """The filter on a joint that the model has at rest, and that a force moves: errors, forces.

    The joints of the finger are unit masses, coupled by another share of each. The prediction
    lacks the acceleration `push` of the first joint. Forces are given as accelerations.
    """
    model, T, rng = robot("finger"), 0.005, np.random.default_rng(0)
    n = model.nv
    M = (1 - coupling) * np.eye(n) + coupling
    filtering = StateFilter(model, memory=0.1)
    filtering.reset(T)
    q, v, errors, forces = np.zeros(n), np.zeros(n), [], []
    for _ in range(steps):
        dq, dv = noise * rng.normal(size=(2, n))
        seen = model.state(q + dq, v + dv / T)
        p, speed, force = filtering(seen, np.zeros(n, bool))
        errors.append(np.concatenate((seen.q + p - q, (speed - v) * T)))
        forces.append(np.linalg.solve(M, force))
        ahead = speed + T * forces[-1]
        filtering.expect(seen.q + p + T * ahead, ahead, M)
        v = v + T * push * np.cos(0.5 * T * len(forces))
        q = q + T * v
    return np.array(errors), np.array(forces)


def test_the_filter_lets_an_exact_measurement_pass_and_finds_the_force() -> None:
    errors, forces = run_filter(0.0, 0.05)
    assert np.abs(errors).max() < 1e-9
    np.testing.assert_allclose(forces[100:300, 0], 0.05 * np.cos(0.0025 * np.arange(100, 300)),
                               atol=0.01)  # fmt: skip


def test_the_filter_lets_half_of_the_positions_noise_pass_and_hardly_any_of_the_velocitys() -> None:
    errors, forces = run_filter(1e-3, 0.0)
    q, v = np.split(errors[100:], 2, axis=1)
    assert q.std() < 0.6e-3
    assert v.std() < 0.1e-3
    # noise of q̇ alone, averaged over the memory, would give M σ / T² √(0.05 / 2) = 6.3
    assert forces[100:].std() < 0.1


def test_noise_of_some_joints_hides_no_force_on_another_that_is_coupled_to_them() -> None:
    noise = np.array([0.0, 1e-3, 1e-3, 1e-3])
    _, found = run_filter(noise, 0.05, coupling=0.9)
    np.testing.assert_allclose(found[100:300, 0], 0.05 * np.cos(0.0025 * np.arange(100, 300)),
                               atol=0.01)  # fmt: skip


@pytest.mark.parametrize(("lag", "delay"), [(0.05, 0.0), (0.0, 0.005), (0.02, 0.012)])
def test_known_lag_and_delay_cost_nothing_at_the_end(lag: float, delay: float) -> None:
    model = robot("finger")
    log = simulate(
        model, Mpc(model, lag=lag, delay=delay), paper.set_point("finger", 1.25), duration=3,
        rig=Rig(lag=lag, delay=delay),
    )  # fmt: skip
    assert np.linalg.norm(log.error[-1]) < 5e-4
    assert log.fallbacks == log.not_solved == 0
    assert ((log.u >= model.u_min) & (log.u <= model.u_max)).all()


class Found:
    """Targets that a test chooses."""

    def __init__(self, *targets: RestTarget) -> None:
        self.targets, self.asked = targets, list[tuple[float, ...]]()
        self.searching = False

    def find(self, y: np.ndarray, *_: object, waits: bool) -> tuple[RestTarget, ...]:
        if tuple(y) not in self.asked:
            self.asked.append(tuple(y))
        return self.targets


def test_a_target_acts_where_the_tip_does_not_arrive_and_after_a_stated_time() -> None:
    model, T = robot("finger"), 0.01
    state = model.state(model.q0, np.zeros(model.nv))
    u = np.array([-0.2, -0.1])
    found = Found(RestTarget(model.q0, u, True, 0.01))
    law = Mpc(model, period=T, targets=found)  # type: ignore[arg-type]
    law.reset(T)
    far = SetPoint(state.y + np.array([0.0, 0.0, 0.05]))
    commands = [law(state, far) for _ in range(160)]
    acts = np.isfinite([command.distance for command in commands])
    assert len(found.asked) == 1
    assert not acts[:148].any()
    assert acts[152:].all()
    assert commands[-1].distance == 0.01
    # a new set point, a set point that the tip is at, and a moving reference have none
    assert np.isnan(law(state, SetPoint(far.y + 0.01)).distance)
    for reference in (SetPoint(state.y), Reference(far.y, ydot=[0.0, 0.0, 0.1])):
        law.reset(T)
        assert not np.isfinite([law(state, reference).distance for _ in range(160)]).any()
    assert len(found.asked) == 1
    # one that is no nearer than the tip does not act
    law = Mpc(model, period=T, targets=Found(RestTarget(model.q0, u, True, 0.05)))  # type: ignore[arg-type]
    assert not np.isfinite([law(state, far).distance for _ in range(160)]).any()


@pytest.mark.parametrize("stable", [True, False])
def test_a_target_adds_its_terms_to_the_objective(stable: bool) -> None:
    """κ Σ‖u - u*‖²_diag(R) over the knots; σ Σ‖q - q*‖²_S as well where it is unstable."""
    model, T = robot("finger"), 0.01
    state = model.state(model.q0, np.zeros(model.nv))
    far = SetPoint(state.y + np.array([0.0, 0.0, 0.05]))
    target = RestTarget(np.full(model.nq, 0.1), np.array([-0.3, 0.2]), stable, 0.01)
    problems = []
    for targets in (Found(target), Found()):
        law = Mpc(model, period=T, targets=targets)  # type: ignore[arg-type]
        law.reset(T)
        seen: list = []
        solve = law._qp.solve
        law._qp.solve = lambda p, s=solve, seen=seen: seen.append(p) or s(p)  # type: ignore
        for _ in range(155):
            law(state, far)
        problems.append(seen)
    first = next(k for k, (a, b) in enumerate(zip(*problems, strict=True)) if np.any(a.H != b.H))
    one, other = (seen[first] for seen in problems)
    lengths, (_, R) = np.diag(np.diff((0, *KNOTS))), predictive_cost.metric(model)
    inputs = 2e-3 * np.kron(lengths, np.diag(np.diag(R)))
    if stable:
        np.testing.assert_allclose(one.H - other.H, inputs, atol=1e-9 * np.abs(one.H).max())
        u = -one.upper[: model.nu] + model.u_max
        pulled = (
            np.kron(np.diag(lengths), u - target.u)
            * np.diag(inputs)
            / np.diag(np.kron(lengths, np.eye(model.nu)))
        )
        np.testing.assert_allclose(one.g - other.g, pulled, atol=1e-9 * np.abs(one.g).max())
    else:
        bent = one.H - other.H - inputs
        assert np.linalg.eigvalsh(bent)[0] > -1e-9 * np.abs(bent).max()
        assert np.abs(bent).max() > np.abs(inputs).max()


def test_targets_are_found_once() -> None:
    model = robot("finger")
    y = paper.set_point("finger", 1.5).reference(0.0).y
    here = RestTargets(model)
    found = here.find(y, waits=True)
    assert found is not None
    assert found is here.find(y.copy(), waits=True)
    assert found is RestTargets(model).find(y, waits=False)  # who waited is of use to all
    assert found[0].distance == pytest.approx(0.0023, abs=2e-4)  # out of reach
