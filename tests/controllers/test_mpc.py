"""The predictive controller: its prediction against the dynamics, its answer against exact QPs."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import quadprog
from test_controllers import ask, hostile_references

import softdyn
from softdyn import InputError, Reference, SetPoint, SoftdynError, statics
from softdyn.controllers import Mpc, MpcParameters, Status, find_controller
from softdyn.controllers.predictive import prediction
from softdyn.controllers.predictive.prediction import Lookahead, ahead, condensed_qp
from softdyn.controllers.predictive.supervisor import Followed, Phase
from softdyn.description import library as catalogue
from softdyn.design.source import read
from softdyn.dynamics.derivatives import tangent_dynamics
from softdyn.validation import paper, simulate
from tests.support import predictive_cost, robots
from tests.support.control_cases import BUNDLED, MICRO, drawn, robot
from tests.support.refused import refused

every_robot = pytest.mark.parametrize("which", BUNDLED + MICRO)


def random_state(which: str, seed: int):
    model, rng = robot(which), np.random.default_rng(seed)
    lower, upper = np.maximum(model.lower, -0.6), np.minimum(model.upper, 0.6)
    q = model.configuration(rng.uniform(lower, upper))
    u = rng.uniform(np.maximum(model.u_min, -2), np.minimum(model.u_max, 2))
    return model, q, rng.normal(size=model.nv), u


@every_robot
def test_tangents_are_those_of_the_forward_dynamics(which: str) -> None:
    model, q, v, u = random_state(which, 1)
    K, D = tangent_dynamics(model, q, v, u)

    def force(dq: np.ndarray, dv: np.ndarray) -> np.ndarray:  # h - B u
        moved = model.state(model.integrate(q, dq), v + dv)
        return moved.h - moved.B @ u

    zero = np.zeros(model.nv)
    scale = max(1.0, np.abs(K).max(), np.abs(D).max())
    steps = 1e-6 * np.eye(model.nv)
    by_q = np.stack([force(dx, zero) - force(-dx, zero) for dx in steps], axis=1) / 2e-6
    by_v = np.stack([force(zero, dx) - force(zero, -dx) for dx in steps], axis=1) / 2e-6
    np.testing.assert_allclose(K, by_q, atol=2e-6 * scale)
    np.testing.assert_allclose(D, by_v, atol=2e-6 * scale)


@pytest.mark.parametrize("which", ["finger", "spirob"])
def test_the_prediction_is_the_robot_nearby(which: str) -> None:
    # near an equilibrium, against forward dynamics in small implicit steps
    model = robot(which)
    q, v = model.q0, np.zeros(model.nv)
    state, u = model.state(q, v), np.zeros(model.nu)
    w = 1e-4 * np.eye(model.nu)[0]
    f = model.forward_dynamics(q, v, u)
    rest = state.M @ f  # the force that holds the arm, so that only w moves it
    K, D = tangent_dynamics(model, q, v, u)
    step, count = 0.01, 10
    z, push = np.zeros(2 * model.nv), state.B @ w
    for _ in range(count):
        z = predictive_cost.alexander(state.M, K, D, push, z, step)
    small = step * count / 400
    x, dx = q.copy(), v.copy()
    S = np.linalg.inv(state.M + small * D + small**2 * K)
    for _ in range(400):
        now = model.state(x, dx)
        push = now.B @ (u + w) - now.h - rest - small * (K @ dx)
        dx = dx + small * (S @ push)
        x = x + small * dx
    np.testing.assert_allclose(z[: model.nv], x - q, atol=2e-2 * np.abs(x - q).max())
    assert np.abs(x - q).max() > 1e-7


def test_the_method_has_order_two_and_damps_what_is_stiff() -> None:
    one = np.ones((1, 1))
    errors = []
    for count in (10, 20, 40):  # x'' + 0.3 x' + 9 x = 9 from rest for 1 s
        z = np.zeros(2)
        for _ in range(count):
            z = predictive_cost.alexander(one, 9 * one, 0.3 * one, np.full(1, 9.0), z, 1 / count)
        w = np.sqrt(9 - 0.15**2)
        exact = 1 - np.exp(-0.15) * (np.cos(w) + 0.15 / w * np.sin(w))
        errors.append(abs(z[0] - exact))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 1.8).all()
    z = np.array([0.0, 1.0])
    for _ in range(3):
        z = predictive_cost.alexander(one, one, 1e6 * one, np.zeros(1), z, 0.1)
    assert abs(z[1]) < 1e-5


@pytest.mark.parametrize("which", ["finger", "spirob", "helix", "one joint"])
@pytest.mark.parametrize("shape", [False, True])
def test_condensing_is_superposition(which: str, shape: bool) -> None:
    """The condensed objective equals the sum along the simulated steps, as differences show."""
    model, q, v, u = random_state(which, 3)
    state, rng, n, m = model.state(q, v), np.random.default_rng(0), model.nv, model.nu
    K, D = tangent_dynamics(model, q, v, u)
    knots, step, metric = (1, 2, 4, 7, 8), 0.02, rng.normal(size=(n, n)) + 4 * np.eye(n)
    rows = np.vstack((state.J, rng.normal(size=(n, n)))) if shape else state.J
    force, p = state.B @ u - state.h + D @ v, 0.1 * rng.normal(size=n)
    error, pace = rng.normal(size=(8, len(rows))), rng.normal(size=(8, n))
    weights, offset = rng.normal(size=(2, 5 * m, 5 * m))[0], rng.normal(size=5 * m)
    weights = weights @ weights.T
    data = (state.M, K, D, state.B), force, (p, v), rows, error, pace
    H, g, c = condensed_qp(*data, Lookahead(knots, step, metric), weights, offset)

    def outputs(x: np.ndarray) -> np.ndarray:
        line = np.vstack((np.zeros(m), x.reshape(5, m)))
        means = [np.interp(np.arange(8) + 0.5, (0, *knots), inputs) for inputs in line.T]
        z, result = np.concatenate((p, v)), []
        for k, w in enumerate(np.transpose(means)):
            z = predictive_cost.alexander(state.M, K, D, force + state.B @ w, z, step)
            result += [*(error[k] + rows @ z[:n]), *(metric @ z[n:] - pace[k])]
        return np.array(result)

    free = outputs(np.zeros(5 * m))
    into = np.stack([outputs(x) - free for x in np.eye(5 * m)], axis=1)
    wanted = 2 * (into.T @ into + weights)
    size = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(H / np.outer(size, size), wanted / np.outer(size, size), atol=1e-9)
    wanted = 2 * (into.T @ free + offset)
    np.testing.assert_allclose(g, wanted, atol=1e-9 * np.abs(wanted).max())
    assert c == pytest.approx(free @ free, rel=1e-9)


def test_kernels_are_the_plain_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, n, m = np.random.default_rng(4), 3, 2
    M, K, D, metric = (x @ x.T + np.eye(n) for x in rng.normal(size=(4, n, n)))
    data = (M, K, D, rng.normal(size=(n, m))), rng.normal(size=n), rng.normal(size=(2, n))
    data += rng.normal(size=(1, n)), rng.normal(size=(6, 1)), rng.normal(size=(6, n))
    own = Lookahead((1, 3, 6), 0.1, metric), np.eye(3 * m), rng.normal(size=3 * m)
    fast = condensed_qp(*data, *own)
    monkeypatch.setattr(prediction, "_ramp_products", prediction._by_products)
    for kernel, plain in zip(fast, condensed_qp(*data, *own), strict=True):
        np.testing.assert_allclose(kernel, plain, rtol=1e-9, atol=1e-12 * np.abs(plain).max())


@pytest.mark.parametrize("which", ["finger", "helix", "spirob", "two identical tendons"])
def test_the_answer_is_the_optimum(which: str) -> None:
    model = robot(which)
    for state, goal in drawn(which)[:6]:
        controller = Mpc(model, period=1.0)  # longer than a knot, so u is the first knot's
        seen = watch(controller)
        controller.reset(controller.period)
        command = controller(state, goal)
        problem = seen[0]
        size = np.sqrt(np.diag(problem.H))
        scaled = problem.H / np.outer(size, size)
        C = np.vstack([np.diag(1 / size), -np.diag(1 / size)]).T
        bounds = np.concatenate([problem.lower, -problem.upper])
        try:
            x = quadprog.solve_qp(scaled, -problem.g / size, C, bounds)[0] / size
        except ValueError:  # the solver takes it for indefinite
            continue
        objective = [0.5 * y @ problem.H @ y + problem.g @ y for y in (x, full(controller, seen))]
        assert objective[1] <= objective[0] + 1e-6 * max(1.0, abs(objective[0]))
        assert command.status is Status.OK


def watch(controller: Mpc) -> list:
    """A list that collects the QPs that the controller solves."""
    seen: list = []
    solve = controller._qp.solve
    controller._qp.solve = lambda problem: seen.append(problem) or solve(problem)
    return seen


def full(controller: Mpc, seen: list) -> np.ndarray:
    solution = controller._qp.solve(seen[0])
    assert solution is not None
    assert solution.solved
    return solution.x


@every_robot
def test_ordinary_states_need_no_fallback(which: str) -> None:
    model, controller = robot(which), Mpc(robot(which))
    for state, goal in drawn(which)[:9]:
        controller.reset(controller.period)
        command = ask(controller, model, state, goal)
        assert command.status is Status.OK
        assert command.V >= 0


@pytest.mark.parametrize("which", ["finger", "helix", "sliding and turning", "one joint"])
def test_hostile_numbers(which: str) -> None:
    model, controller = robot(which), Mpc(robot(which))
    state, goal = drawn(which)[4]
    for reference in hostile_references():
        ask(controller, model, state, reference)
    rng = np.random.default_rng(3)
    for size in (1e2, 1e100, 1e300):
        v = size * rng.choice([-1.0, 1.0], model.nv)
        for far in (0.0, 1e160):
            try:
                with np.errstate(all="ignore"):
                    q = model.configuration(far * rng.uniform(-1, 1, model.nv))
                    wild = model.state(q, v)
            except SoftdynError:
                continue
            ask(controller, model, wild, goal)
    for value in (np.nan, np.inf, 1e300):
        for name in ("M", "h", "J", "B", "D", "y", "q", "v"):
            array = np.array(getattr(state, name))
            array.flat[0] = value
            ask(controller, model, replace(state, **{name: array}), goal)
    controller.reset(controller.period)
    assert ask(controller, model, state, goal).status is Status.OK  # no later answer is affected


@pytest.mark.parametrize("period", [0.001, 0.005])
def test_the_finger_settles_whatever_the_period(period: float) -> None:
    model = robot("finger")
    log = simulate(model, Mpc(model), paper.set_point("finger", 0.75), period=period, duration=2)
    assert not log.failed
    assert 100 * np.linalg.norm(log.error[-1]) < 0.05
    assert log.fallbacks == log.not_solved == 0
    assert log.max_bound_violation < 1e-9


def test_a_plan_s_feedback_saturates_by_design(monkeypatch) -> None:
    """It is no answer of a solver, so its excess is no violation of the bounds."""
    model = robot("finger")
    law, goal = Mpc(model), paper.set_point("finger", 0.5).reference(0.0)
    state = model.state(model.q0, np.zeros(model.nv))
    law(state, goal)
    error = law._aim(state, goal, False)
    planned = Followed(Phase.PLAN, error, False, command=1e3 + model.u_max)
    monkeypatch.setattr(law, "supervisor", lambda *_, **__: planned)
    command = law(state, goal)
    assert command.status is Status.OK
    assert command.u.tolist() == model.u_max.tolist()
    assert law.guard.max_bound_violation == 0
    assert command.values == {"phase": "plan"}


def test_a_robot_of_ones_own_needs_no_gains(tmp_path: Path) -> None:
    path = tmp_path / "own.urdf"
    text = catalogue.BUNDLED.joinpath("finger.urdf").read_text()
    path.write_text(text)
    model = softdyn.load(path)
    goal = SetPoint(paper.set_point("finger", 1.0).reference(0.0).y)
    log = simulate(model, find_controller("mpc")(model), goal, duration=1.5)
    assert np.linalg.norm(log.error[-1]) < 0.05 * np.linalg.norm(log.error[0])


PULLEYS = """
name = "pulleys"
[finger]
lengths_mm = [45, 35, 30]
radius_mm = [8, 6]
density_kg_m3 = 1100
joint_stiffness_Nm_rad = [0.10, 0.07, 0.05]
joint_damping_Nms_rad = 0.003
joint_limit_deg = 70
[[tendon]]
name = "flexor"
joints = [1, 2, 3]
pulley_mm = [8, 6, 5]
max_tension_N = 30
[[tendon]]
name = "middle"
joints = [1, 2]
pulley_mm = [-7, 6]
max_tension_N = 30
[[tendon]]
name = "extensor"
joints = [1, 2, 3]
pulley_mm = [-8, -7, -5]
max_tension_N = 30
"""


def test_cables_that_pull_a_joint_to_either_stop_are_passed(tmp_path: Path) -> None:
    """Beyond some tension, joint 2 is unstable within 12 ms; the tip comes to its target behind."""
    model = softdyn.load(robots.write(tmp_path, read(tomllib.loads(PULLEYS)).text))
    goal = statics.settle(model, np.array([17.15, 6.65, 8.48]))
    log = simulate(model, Mpc(model), SetPoint(goal.y), period=0.005, duration=1)
    error = 100 * np.linalg.norm(log.error, axis=1)
    assert error[0] > 10  # cm; it ended at 7.9 with the whole horizon
    assert error[-1] < 0.05


def test_what_the_model_does_not_know_leaves_no_offset() -> None:
    # 20 % more gravity than in the controller's model
    model, heavy = robot("finger"), robot("finger")
    goal = paper.set_point("finger", 0.5)
    from softdyn.validation.twin.plant_errors import PlantErrors

    log = simulate(model, Mpc(heavy), goal, duration=4, plant=PlantErrors(mass=1.2))
    assert 100 * np.linalg.norm(log.error[-1]) < 0.05


@pytest.mark.parametrize("which", ["finger", "helix", "sliding and turning"])
def test_cost_and_estimate_are_those_of_their_definitions(which: str) -> None:
    """Every term of the QP equals `tests.support.predictive_cost`, which simulates the horizon.

    The second call is compared, too, because it has estimated forces, which the first lacks.
    """
    model, rng, period = robot(which), np.random.default_rng(11), 0.002
    (first, _), (second, _) = drawn(which)[2:4]
    lower, upper = (np.where(np.isfinite(x), x, 0.0) for x in (model.lower, model.upper))
    at = model.coordinates(first.q).copy()
    at[0] = upper[0]  # held before, and now another joint
    first = model.state(model.configuration(at), first.v)
    at = np.clip(model.coordinates(second.q), 0.9 * lower, 0.9 * upper)
    at[2] = lower[2]
    second = model.state(model.configuration(at), second.v)
    held = [np.zeros(model.nv, bool) for _ in range(2)]
    for flags, state in zip(held, (first, second), strict=True):
        x = model.coordinates(state.q)
        near = 2e-3 * (upper - lower)
        flags[:] = np.isfinite(model.lower) & ((x > upper - near) | (x < lower + near))
    assert (held[0][0], held[1][0], held[1][2]) == (True, False, True)
    controller = Mpc(model, period=period)
    goal = Reference(first.y + 0.01, ydot=[0.1, -0.2, 0.3], yddot=[2.0, 1.0, -3.0])
    u = controller(first, goal).u
    assert np.abs(u).max() > 0
    base = predictive_cost.euler(first, u, np.zeros(model.nv), held[0], period)
    columns = [predictive_cost.euler(first, u, f, held[0], period) - base for f in np.eye(model.nv)]
    missed = np.linalg.solve(np.transpose(columns), second.v - base)
    # a state this far from its prediction is a new one for the filter
    assert np.abs(model.coordinates(second.q) - model.coordinates(first.q)).max() > 0.5
    assert np.abs(missed).max() > 0
    unmodelled = np.zeros(model.nv)
    seen = watch(controller)
    answer = controller(second, goal)
    problem = seen[0]

    def cost(x: np.ndarray) -> float:
        knots = u + x.reshape(-1, model.nu)
        return predictive_cost.cost(model, second, goal, u, held[1], unmodelled, knots)

    zero = np.zeros(len(problem.g))
    for x in rng.normal(size=(4, len(zero))) * np.tile(np.abs(u).max(), len(zero)):
        wanted = cost(x) - cost(zero)
        assert x @ problem.H @ x / 2 + problem.g @ x == pytest.approx(wanted, rel=1e-6)
    x = full(controller, seen)
    constant = cost(zero) - predictive_cost.size(model, u)
    least = constant + x @ problem.H @ x / 2 + problem.g @ x
    predicted = answer.V
    assert predicted == pytest.approx(least, rel=1e-6, abs=1e-9 * constant)


def test_forces_at_a_stop_are_no_estimate() -> None:
    """At a joint on its stop, now or a period ago, the stop causes the prediction error."""
    model, period, still = robot("helix"), 0.002, np.zeros(robot("helix").nv)
    inside = model.state(model.q0, still)
    moving = model.state(model.q0, still + 0.1)
    at = np.array(model.coordinates(model.q0))
    at[3] = model.upper[3]
    stopped = model.state(model.configuration(at), still)
    for states, estimated in (
        ((inside, moving), True),
        ((inside, stopped), False),
        ((stopped, inside), False),
        ((inside, moving, stopped), False),  # and the earlier estimate is dropped
    ):
        controller = Mpc(model, period=period)
        for state in states:
            controller(state, Reference(inside.y))
        assert (controller._filter.force[3] != 0) == estimated
        assert np.abs(controller._filter.force).max() > 0


def test_names_and_wrong_gains() -> None:
    assert find_controller("mpc") is Mpc
    model = robot("finger")
    assert Mpc(model).parameters == MpcParameters()
    assert Mpc(model, {"speed": 0.1}).parameters == MpcParameters(speed=0.1)
    for wrong in (5.0, "x", {"Kp": 1}, [], object(), {"speed": -1.0}, {"rate": float("nan")}):
        with pytest.raises(InputError):
            Mpc(model, wrong)


def test_a_robot_without_inputs_is_refused(tmp_path: Path) -> None:
    text = catalogue.BUNDLED.joinpath("finger.urdf").read_text()
    path = tmp_path / "passive.urdf"
    path.write_text("\n".join(x for x in text.splitlines() if "<actuator" not in x))
    with refused("model", "none"):
        Mpc(softdyn.load(path))


def test_steps_ahead_are_backward_euler() -> None:
    """Against its two equations, M (q̇⁺ - q̇) = T (f + B w - D q̇⁺ - K p⁺), p⁺ = p + T q̇⁺."""
    rng, n, T = np.random.default_rng(2), 4, 0.1
    M, K, D = (x @ x.T + np.eye(n) for x in rng.normal(size=(3, n, n)))
    force, p, v = rng.normal(size=(3, n))
    B, changes = rng.normal(size=(n, 2)), rng.normal(size=(3, 2))
    after = ahead((M, K, D, B), force, (p, v), changes, T)
    for w in changes:
        block = np.block([[np.eye(n), -T * np.eye(n)], [T * K, M + T * D]])
        both = np.linalg.solve(block, np.concatenate((p, M @ v + T * (force + B @ w))))
        p, v = both[:n], both[n:]
    np.testing.assert_allclose(after[0], p)
    np.testing.assert_allclose(after[1], v)
    np.testing.assert_allclose(after[2], M + T * D + T**2 * K)


def test_references_are_extrapolated() -> None:
    model = robot("finger")
    state = model.state(model.q0, np.zeros(model.nv))
    still = Mpc(model)(state, Reference(state.y)).u
    moving = Mpc(model)(state, Reference(state.y, ydot=np.array([0.0, 0.0, -0.5]))).u
    assert np.abs(moving - still).max() > 1e-3


def test_a_tip_that_no_joint_moves_is_refused() -> None:
    text = robots.hinge(0.3, "0.1 0 0", "1e-4 1e-3 1e-3", limit=(-3, 3), pull=(-1, 1))
    with refused("<task>", "'arm', which stands still"):
        Mpc(robots.build(text))
