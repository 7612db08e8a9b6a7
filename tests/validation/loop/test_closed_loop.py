"""Closed loops on micro-robots, against closed forms and against the integration scheme itself."""

import math
from dataclasses import dataclass, replace
from enum import Enum
from types import SimpleNamespace

import numpy as np
import pytest

import softdyn
from softdyn import Ellipse, InputError, Reference, SetPoint
from softdyn.controllers import Compensated, Impedance, SoftIdClfQp
from softdyn.validation import Twin, crosscheck, paper, simulate
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.settings import RunOptions
from tests.support.cart import DAMPING, LENGTH, MASS, STIFFNESS, TARGET, push, steer, step_response
from tests.support.refused import refused
from tests.support.robots import build, hinge

NAN, INF = math.nan, math.inf
WHEEL = hinge(0.2, "0 0 -0.1", kind="continuous")


def implicit(inputs, substeps, h):
    """The cart by implicitfast's formulas: forces at the start, damping at the end of a step."""
    x, v, states = 0.0, 0.0, [(0.0, 0.0)]
    for u, n in zip(inputs, substeps, strict=True):
        for _ in range(n):
            v += h * (u - DAMPING * v - STIFFNESS * x) / (MASS + h * DAMPING)
            x += h * v
        states.append((x, v))
    return np.array(states)


# --- the plant ----------------------------------------------------------------------------------


def test_step_response_of_a_spring_and_damper(cart):
    errors = []
    for timestep in (5e-4, 2.5e-4):
        log = simulate(cart, push(4.0), TARGET, duration=2.0, period=0.01, timestep=timestep)
        errors.append(np.abs(log.q[:, 0] - step_response(log.t, 4.0)).max())
    assert errors[1] < 2e-4
    assert 1.9 < errors[0] / errors[1] < 2.1  # a scheme of first order


def test_inputs_are_held_and_the_last_hold_is_cut(cart):
    def ramp(state, reference):
        ramp.calls += 1
        return SimpleNamespace(u=[float(ramp.calls)])

    ramp.calls = 0
    log = simulate(cart, ramp, TARGET, duration=0.0175, period=0.005)
    assert log.u[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(log.t, [0, 0.005, 0.01, 0.015, 0.0175], rtol=0, atol=1e-15)
    expected = implicit(log.u[:, 0], [10, 10, 10, 5], 5e-4)
    np.testing.assert_allclose(log.q[:, 0], expected[:, 0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(log.v[:, 0], expected[:, 1], rtol=0, atol=1e-13)


def test_tip_reference_and_error(cart):
    path = Ellipse(0.1, 0.1, 0.3, omega=0.5)
    log = simulate(cart, push(1.0), path, duration=0.1, period=0.01)
    np.testing.assert_allclose(log.y[:, 0], LENGTH + log.q[:, 0], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(log.y_ref, [path(t).y for t in log.t])
    np.testing.assert_array_equal(log.error, log.y - log.y_ref)


def test_a_law_with_known_error_dynamics(cart):
    def worst(period):
        log = simulate(cart, steer, TARGET, duration=1.0, period=period, timestep=period / 4)
        exact = -0.5 * (1 + 5 * log.t) * np.exp(-5 * log.t)
        return np.abs(log.error[:, 0] - exact).max()

    coarse, fine = worst(0.002), worst(0.001)
    assert fine < 5e-3
    assert 1.8 < coarse / fine < 2.2


def test_initial_state(cart):
    log = simulate(cart, push(0.0), TARGET, duration=0.01, q0=[0.3], v0=[-0.2])
    assert (log.q[0, 0], log.v[0, 0]) == (0.3, -0.2)


def test_two_runs_are_the_same(cart):
    first, second = (simulate(cart, steer, TARGET, duration=0.2) for _ in range(2))
    np.testing.assert_array_equal(first.q, second.q)
    np.testing.assert_array_equal(first.u, second.u)


def test_a_continuous_joint_without_inputs():
    model = build(WHEEL)
    q0 = model.configuration(np.array([3.0]))
    nothing = lambda state, reference: SimpleNamespace(u=[])  # noqa: E731
    log = simulate(model, nothing, SetPoint([0, 0, 0]), duration=0.5, period=0.01, q0=q0)
    assert log.q.shape == (51, 2)
    assert log.u.shape == (50, 0)
    np.testing.assert_allclose(np.hypot(*log.q.T), 1.0, rtol=0, atol=1e-15)
    # No dissipation: ½ I θ̇² - m g l cos θ stays, but for the scheme's first-order ripple.
    energy = 0.5 * 3e-3 * log.v[:, 0] ** 2 - 0.2 * 9.81 * 0.1 * log.q[:, 0]
    assert np.ptp(energy) < 2e-3
    assert np.abs(log.v).max() > 1.0
    assert log.length is None


# --- arguments ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["q0", "v0"])
@pytest.mark.parametrize("value", [[NAN], [INF], [], [0.0, 0.0], "a", ["1"], 0.0, [1e300]])
def test_hostile_states_are_refused(cart, name, value):
    with pytest.raises(InputError):
        simulate(cart, steer, TARGET, duration=0.01, **{name: value})


@pytest.mark.parametrize("value", [None, [1, 2, 3], np.zeros(3), Reference([0, 0, 0]), "finger"])
def test_what_is_no_reference_is_refused(cart, value):
    with refused("reference"):
        simulate(cart, steer, value)


@pytest.mark.parametrize("value", [None, [1, 2, 3], SimpleNamespace(y=[0, 0, 0])])
def test_what_returns_no_reference_is_refused(cart, value):
    with refused("reference"):
        simulate(cart, steer, lambda t: value)


def test_a_reference_that_breaks_on_the_way_is_refused(cart):
    def reference(t):
        return SimpleNamespace(y=[1.0, 0, NAN if t > 0.005 else 0], ydot=[0] * 3, yddot=[0] * 3)

    with refused("y", "[1.0, 0, nan]"):
        simulate(cart, steer, reference, duration=0.01)


def test_what_is_no_controller_is_refused(cart):
    with refused("controller"):
        simulate(cart, None, TARGET)


def test_an_experiment_of_another_robot_is_refused():
    model = softdyn.load("finger")
    with refused("experiment", "one for 'helix'"):
        simulate(model, steer, paper.set_point("helix", 0.0))


def test_the_experiments_numbers_are_defaults(cart):
    experiment = replace(paper.tracking("finger", 0.2), duration=0.02, period=0.01, length=5.0)
    log = simulate(cart, push(0.0), experiment)
    assert (log.kind, log.theta, log.omega) == ("tracking", None, 0.2)
    assert (log.duration, log.period, log.length, log.steps) == (0.02, 0.01, 5.0, 2)
    log = simulate(cart, push(0.0), experiment, duration=0.03, period=0.005)
    assert (log.duration, log.period, log.steps) == (0.03, 0.005, 6)


# --- controllers of all sorts -------------------------------------------------------------------


def test_a_controller_is_reset_once_with_the_period(cart):
    calls = []

    class Starts:
        def reset(self, period):
            calls.append(period)

        def __call__(self, state, reference):
            calls.append("step")
            return SimpleNamespace(u=[0.0])

    simulate(cart, Starts(), TARGET, duration=0.02, period=0.01)
    assert calls == [0.01, "step", "step"]


@pytest.mark.parametrize(
    "u", [[NAN], [INF], [-INF], [], [1.0, 2.0], 1.0, [[1.0]], None, "1", ["1"], [None], [1j]]
)
def test_an_answer_that_is_no_input_ends_the_run(cart, u):
    def controller(state, reference):
        return SimpleNamespace(u=[1.0] if state.q[0] == 0 else u)

    log = simulate(cart, controller, TARGET, duration=0.1, period=0.01)
    assert log.failed
    assert not log.complete
    assert log.reason.startswith("the controller failed at t = 0.01 s: u: expected finite numbers")
    assert (log.steps, len(log.t)) == (1, 2)
    assert np.isfinite(log.error).all()


def test_an_answer_without_input_ends_the_run(cart):
    log = simulate(cart, lambda state, reference: None, TARGET, duration=0.1)
    assert log.failed
    expected = "u: expected finite numbers of shape (1,), got None"
    assert log.reason == f"the controller failed at t = 0 s: {expected}"
    assert (log.steps, len(log.t), log.u.shape) == (0, 1, (0, 1))


@pytest.mark.parametrize("answer", [[1.5], (1.5,), np.array([1.5])])
def test_the_numbers_alone_are_an_answer(cart, answer):
    log = simulate(cart, lambda state, reference: answer, TARGET, duration=0.01)
    assert log.u.tolist() == [[1.5]] * 5


def test_what_is_no_model_is_refused(cart):
    for run in (lambda: simulate("cart", lambda s, r: [0.0], TARGET), lambda: crosscheck("cart")):
        with refused("model", "'cart'"):
            run()


def test_inputs_beyond_their_bounds_are_measured_and_clipped(cart):
    forces = iter([5.0, 21.5, -20.25])
    log = simulate(
        cart, lambda s, r: SimpleNamespace(u=[next(forces)]), TARGET, duration=0.03, period=0.01
    )
    assert log.u[:, 0].tolist() == [5.0, 20.0, -20.0]
    assert log.max_bound_violation == 1.5
    assert "answers up to 1.5 beyond the bounds, clipped" in log.summary()
    rounded = simulate(cart, lambda s, r: [20 + 1e-12], TARGET, duration=0.01)
    assert rounded.max_bound_violation > 0
    assert "inputs in bounds" in rounded.summary()
    np.testing.assert_allclose(
        log.q[:, 0], implicit([5.0, 20.0, -20.0], [20] * 3, 5e-4)[:, 0], rtol=0, atol=1e-14
    )


def test_diagnostics_are_logged(cart):
    class Status(Enum):
        GOOD = "fine"
        BAD = "not fine at all"

    class Talker:
        name = "talker"
        gains = Gains(3.0, np.array([1.0, 2.0]))
        guard = SimpleNamespace(not_solved=4, fallbacks=7, max_bound_violation=0.25)

        def __call__(self, state, reference):
            self.guard.fallbacks += 1
            status = Status.GOOD if state.v[0] == 0 else Status.BAD
            return SimpleNamespace(u=[1.0], V=2, delta=None, status=status)

    log = simulate(cart, Talker(), TARGET, duration=0.03, period=0.01)
    assert log.controller == "talker"
    assert log.status.tolist() == ["fine", "not fine at all", "not fine at all"]
    assert log.V.tolist() == [2.0, 2.0, 2.0]
    assert np.isnan(log.delta).all()
    assert log.gains == {"Kp": 3.0, "table": [1.0, 2.0]}
    assert (log.not_solved, log.fallbacks, log.max_bound_violation) == (0, 3, 0.25)
    assert (log.step_us > 0).all()
    assert simulate(cart, push(1.0), TARGET, duration=0.01, name="mine").controller == "mine"


@dataclass
class Gains:
    Kp: float
    table: np.ndarray


def test_counters_on_the_controller_itself(cart):
    class Counter:
        not_solved = 2
        fallbacks = 0

        def __call__(self, state, reference):
            self.not_solved += 2
            return SimpleNamespace(u=[0.0])

    log = simulate(cart, Counter(), TARGET, duration=0.03, period=0.01)
    assert (log.not_solved, log.fallbacks) == (6, 0)
    assert log.controller == "Counter"
    assert log.status.tolist() == ["", "", ""]


def test_a_controllers_exceptions_pass(cart):
    def controller(state, reference):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        simulate(cart, controller, TARGET)


@pytest.mark.parametrize("kind", [ZeroDivisionError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("where", ["controller", "reference", "on_step"])
def test_an_exception_has_the_run_so_far(cart, kind, where):
    calls = []

    def fail():
        calls.append(1)
        if len(calls) > 4:
            raise kind("mine")

    def controller(state, reference):
        if where == "controller":
            fail()
        return SimpleNamespace(u=[0.5])

    def reference(t):
        if where == "reference":
            fail()
        return TARGET(t)

    seen = (lambda *_: fail()) if where == "on_step" else None
    with pytest.raises(kind, match="mine") as caught:
        simulate(cart, controller, reference, duration=0.1, period=0.01, on_step=seen)
    log, whole = caught.value.log, simulate(cart, push(0.5), TARGET, duration=0.1, period=0.01)
    done = len(log.u)
    # a reference is called once before the run, and before its sample is recorded
    late = where == "reference"
    assert done == (2 if late else 4)
    assert (log.complete, log.failed, log.controller) == (False, True, "controller")
    for name in ("t", "q", "v", "y", "error"):
        np.testing.assert_array_equal(getattr(log, name), getattr(whole, name)[: done + 1])
    np.testing.assert_array_equal(log.u, whole.u[:done])
    why = "interrupted" if kind is KeyboardInterrupt else f"{kind.__name__}: mine"
    assert log.reason == f"the run ended at t = {(done + late) / 100:g} s: {why}"


def test_on_step_sees_every_step(cart):
    seen = []
    log = simulate(
        cart, push(1.0), TARGET, duration=0.05, period=0.01, on_step=lambda *a: seen.append(a)
    )
    assert [t for t, _, _ in seen] == log.t[:-1].tolist()
    assert [state.q[0] for _, state, _ in seen] == log.q[:-1, 0].tolist()
    assert [command.u[0] for _, _, command in seen] == [1.0] * 5


# --- failures -----------------------------------------------------------------------------------


def test_a_tip_that_runs_away_ends_the_run(cart):
    push_away = lambda state, reference: SimpleNamespace(u=[20.0 * (1 + state.q[0])])  # noqa: E731
    log = simulate(cart, push_away, SetPoint([LENGTH, 0, 0]), duration=10.0)
    distance = np.linalg.norm(log.error, axis=1)
    assert log.failed
    assert not log.complete
    assert "more than twice the length of 0.4 m" in log.reason
    assert distance[-1] > 2 * LENGTH
    assert (distance[:-1] <= 2 * LENGTH).all()
    assert f"at t = {log.t[-1]:.4g} s" in log.reason
    assert log.steps == len(log.t) - 1 < 5000


def test_a_plant_that_blows_up_ends_the_run(make_cart, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    cart = make_cart(lower="-9e9", upper="9e9")
    log = simulate(cart, push(9e9), TARGET, duration=0.1, period=0.01)
    assert log.failed
    assert not log.complete
    assert log.reason.startswith("the plant diverged at t = ")
    assert "acceleration" in log.reason
    assert (log.steps, len(log.t)) == (1, 2)
    assert [path.name for path in tmp_path.iterdir()] == ["robot.urdf"]  # no MUJOCO_LOG.TXT
    assert capfd.readouterr() == ("", "")


def test_a_run_that_does_not_converge_is_failed_and_complete(cart):
    log = simulate(cart, push(-1.0), TARGET, duration=0.5)
    assert log.failed
    assert log.complete
    assert log.reason.startswith("no convergence: the final error of ")
    still = simulate(cart, push(0.0), TARGET, duration=0.1)
    assert still.failed  # not below the initial error: equal to it


@pytest.mark.parametrize("horizon", [0.0, 0.03])
def test_a_verdict_of_no_convergence_names_a_horizon_that_is_on(horizon):
    model = softdyn.load("finger")
    law = Compensated(SoftIdClfQp(model, horizon=horizon), model, delay=0.0)
    start = model.state(model.q0, np.full(4, 2.0))
    behind = SetPoint(start.y - 0.01 * start.ydot)  # the tip leaves it
    log = simulate(model, law, behind, v0=start.v, duration=0.005, period=0.005)
    assert log.reason.startswith("no convergence: ")
    assert ("horizon of 30 ms" in log.reason) == (horizon > 0)


def test_a_run_that_converges_is_not_failed(cart):
    log = simulate(cart, steer, TARGET, duration=2.0)
    assert not log.failed
    assert log.complete
    assert log.reason is None
    assert np.linalg.norm(log.error[-1]) < 0.01 * np.linalg.norm(log.error[0])


def test_staying_on_the_target_is_not_a_failure(cart):
    assert not simulate(cart, push(0.0), SetPoint([LENGTH, 0, 0]), duration=0.1).failed


def test_the_plant_can_be_another_one(cart):
    made = []

    class Sticky(Twin):
        def __init__(self, *arguments, **options):
            made.append(options)
            super().__init__(*arguments, **options)
            self.model.dof_damping[:] = 1e6

    log = simulate(cart, push(1.0), TARGET, duration=0.01, contacts=True, plant=Sticky)
    assert made == [{"timestep": log.timestep, "contacts": True, "friction": False}]
    assert np.abs(log.v).max() < 1e-5
    assert np.abs(simulate(cart, push(1.0), TARGET, duration=0.01).v).max() > 1e-3


def test_a_loop_can_be_stepped(cart):
    options = {"duration": 0.2, "period": 0.01}
    loop = ClosedLoop(cart, steer, SetPoint([0.5, 0, 0]), RunOptions(**options))
    seen = []
    while (step := loop.step()) is not None:
        seen.append(step)
        assert loop.steps == len(seen)
        assert not loop.log().complete
    assert loop.done
    assert loop.step() is None
    whole, log = simulate(cart, steer, SetPoint([0.5, 0, 0]), **options), loop.log()
    for name in ("t", "q", "v", "u", "error"):
        assert getattr(log, name).tobytes() == getattr(whole, name).tobytes()
    assert [step.t for step in seen] == list(log.t[:-1])
    assert (log.complete, log.failed, log.reason) == (whole.complete, whole.failed, whole.reason)


def test_a_loop_that_is_not_over_has_a_log_up_to_its_last_sample(cart):
    loop = ClosedLoop(cart, steer, SetPoint([0.5, 0, 0]), RunOptions(duration=0.2, period=0.01))
    for _ in range(5):
        loop.step()
    log = loop.log()
    assert (log.steps, log.complete, log.failed) == (4, False, False)
    assert np.isfinite(log.y).all()
    assert loop.run().steps == 20


def test_a_log_prints_plots_and_shows_itself(tmp_path):
    model = softdyn.load("finger")
    log = simulate(model, Impedance(model), paper.set_point("finger", 0.5), duration=0.02)
    assert str(log) == log.summary()
    log.plot(tmp_path / "run.png")
    assert log.plot()._repr_png_() == (tmp_path / "run.png").read_bytes()
    page = log.show()
    assert page.runs[0].tracks[0].frames.shape[1] == 1 + 4 + 2 + 6
    assert "<iframe" in page._repr_html_()
    with refused("robot", "another, …"):
        log.show(softdyn.load("spirob"))
