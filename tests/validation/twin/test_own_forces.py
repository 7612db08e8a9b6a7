"""Forces of a user's own in the twin: its steps, their order, stiff ones, followers, bases."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint
from softdyn.dynamics import Wrench
from softdyn.validation import Rig, Twin, crosscheck, rollout, simulate
from softdyn.validation.crosschecks import trajectories
from tests.support import robots

ARM = robots.WINCHED.replace("1.2", "3.1")  # it stays off its stops


class Drag:
    """A linear drag of every joint."""

    name = "drag"

    def __init__(self, size: float = 0.1) -> None:
        self.size = size

    def __call__(self, model, q, v):
        return -self.size * v


class Water:
    """A drag of every link by the square of its speed, in world's axes."""

    name = "water"

    def __call__(self, model, q, v):
        found = np.zeros(model.nv)
        for link in model.robot.links:
            jacobian = model.link_jacobian(q, link.name)[:3]
            speed = jacobian @ v
            found -= 2.0 * jacobian.T @ (np.linalg.norm(speed) * speed)
        return found


class Spring:
    """A spring with a wrong energy, if it is asked for."""

    name = "spring"

    def __init__(self, size: float, wrong: float = 1.0) -> None:
        self.size, self.wrong = size, wrong

    def __call__(self, model, q, v):
        return -self.size * q

    def derivatives(self, model, q, v):
        return -self.size * np.eye(model.nv), np.zeros((model.nv, model.nv))

    def energy(self, model, q):
        return self.wrong * self.size * q @ q / 2


def test_a_drag_that_would_explode_explicitly_stops_the_arm():
    """Explicit steps of -0.1 v blow up within twelve steps of 0.5 ms."""
    wet = softdyn.load("finger").with_forces(Drag())
    log = rollout(wet, [0.1, -0.1], 0.2)
    dry = rollout(softdyn.load("finger"), [0.1, -0.1], 0.2)
    assert not log.failed
    assert np.abs(log.v).max() < 0.5 * np.abs(dry.v).max()


@pytest.mark.parametrize("name", ["helix", "spirob"])
def test_a_hundred_times_that_on_arms(name):
    model = softdyn.load(name)
    u = np.zeros(model.nu)
    u[0] = 0.1 * model.u_max[0]
    log = rollout(model.with_forces(Drag(10.0)), u, 0.01)
    assert not log.failed
    assert np.abs(log.v).max() < 1.0


@pytest.mark.parametrize("scheme", ["implicitfast", "rk4"])
def test_twin_and_model_take_the_same_steps(scheme, tmp_path):
    dry = robots.load(tmp_path, ARM)
    wet = dry.with_forces(Water(), Wrench("tip", force=[0, 0, 0.5]))
    ours, twins, dry = (
        rollout(model, [6.0, 0.0], 0.1, integrator=scheme, **plant)
        for model, plant in ((wet, {"plant": "model"}), (wet, {}), (dry, {}))
    )
    np.testing.assert_allclose(ours.q, twins.q, atol=1e-11)
    assert np.abs(twins.q - dry.q).max() > 1e-3


def test_the_steps_are_of_first_order_and_of_fourth(tmp_path):
    wet = robots.load(tmp_path, ARM).with_forces(Water())
    for scheme, ratio in (("implicitfast", 2.0), ("rk4", 16.0)):
        ends = [
            rollout(wet, [6.0, 0.0], 0.08, integrator=scheme, timestep=h, period=0.004).q[-1]
            for h in (4e-3, 2e-3, 1e-3)
        ]
        one, other = (np.abs(a - b).max() for a, b in itertools.pairwise(ends))
        assert one / other == pytest.approx(ratio, rel=0.3)


def test_a_force_that_is_zero_changes_nothing(tmp_path):
    model = robots.load(tmp_path, robots.WINCHED)
    for rig in (None, Rig()):
        ends = [
            rollout(one, [10.0, 5.0], 0.1, rig=rig).q for one in (model, model.with_forces(Drag(0)))
        ]
        np.testing.assert_allclose(*ends, atol=1e-12)


def test_followers_and_floating_bases_feel_it(tmp_path):
    gripper = robots.load(tmp_path, robots.GRIPPER).with_forces(Drag(1.0))
    logs = [rollout(gripper, [0.5, 0.5, 0], 0.1, **plant) for plant in ({}, {"plant": "model"})]
    assert np.abs(logs[0].q - logs[1].q).max() < 1e-3
    walker = robots.load(tmp_path, robots.WALKER, floating=True)
    far = []
    for h in (5e-4, 2.5e-4):
        wet = walker.with_forces(Water())
        logs = [
            rollout(wet, [1.0], 0.05, timestep=h, **plant) for plant in ({}, {"plant": "model"})
        ]
        far.append(np.abs(logs[0].y - logs[1].y).max())
    assert far[0] < 1e-4
    assert far[0] / far[1] == pytest.approx(2, rel=0.2)


@pytest.mark.parametrize("scheme", ["implicitfast", "rk4"])
def test_a_force_too_stiff_for_the_step_is_refused_with_the_step_that_does(scheme):
    stiff = softdyn.load("finger").with_forces(Spring(1e4))
    with pytest.raises(InputError) as caught:
        rollout(stiff, [0.0, 0], 0.01, integrator=scheme)
    assert caught.value.name == "timestep"
    step = float(caught.value.expected.split()[2])
    log = rollout(stiff, [0.3, 0], 40 * step, timestep=step, period=step, integrator=scheme)
    assert not log.failed


def test_motors_that_lag_and_fourth_order_are_refused(tmp_path):
    model = robots.load(tmp_path, robots.WINCHED).with_forces(Drag())
    with pytest.raises(InputError) as caught:
        rollout(model, [10.0, 5.0], 0.1, rig="file", integrator="rk4")
    assert caught.value.name == "integrator"


def test_a_force_that_fails_in_a_run_says_so():
    class Late(Drag):
        def __call__(self, model, q, v):
            return -0.1 * v if abs(q[0]) < 1e-3 else np.full(model.nv, np.nan)

    law = lambda state, reference: np.array([0.5, -0.5])  # noqa: E731
    with pytest.raises(InputError) as caught:
        simulate(softdyn.load("finger").with_forces(Late()), law, SetPoint([0.2, 0, 0]))
    assert caught.value.name.startswith("Late.__call__")


def test_the_crosscheck_takes_it_as_given_and_holds_derivatives_against_differences(
    tmp_path, monkeypatch
):
    for name, value in (("HORIZON", 0.04), ("HORIZON_UNDAMPED", 0.01), ("RUNG_STEPS", 16)):
        monkeypatch.setattr(trajectories, name, value)
    gripper = robots.load(tmp_path, robots.GRIPPER)
    for model in (softdyn.load("finger").with_forces(Drag(), Spring(2.0)),
                  gripper.with_forces(Drag(1.0))):  # fmt: skip
        found = crosscheck(model, samples=2)
        assert found.passed, str(found)
        (check,) = (one for one in found.checks if one.quantity == "F")
        assert "given" in check.scale
    for size in (2.0, 2e-7):  # the least force of a pair is judged by its own size
        wrong = softdyn.load("finger").with_forces(Spring(size, wrong=1.01), Drag())
        found = crosscheck(wrong, samples=2, trajectories=False)
        assert [one.quantity for one in found.checks if not one.passed] == ["F"]
        spring, drag = found.forces
        assert spring.derivatives < 1e-8
        assert spring.power == pytest.approx(0.01, rel=0.02)
        assert drag.power is None
    plain = crosscheck(softdyn.load("finger"), samples=1, trajectories=False)
    assert "F" not in {one.quantity for one in plain.checks}


def test_a_twin_shows_it_in_its_acceleration():
    wet = softdyn.load("finger").with_forces(Spring(3.0))
    twin = Twin(wet)
    q = np.array([0.1, -0.2, 0.1, 0.3])
    twin.set_state(q, np.zeros(4))
    np.testing.assert_allclose(
        twin.data.qacc, wet.forward_dynamics(q, np.zeros(4), np.zeros(2)), rtol=1e-9
    )
