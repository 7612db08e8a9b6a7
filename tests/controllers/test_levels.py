"""Strict levels of priority against an independent solution, level by level with quadprog."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.controllers import (
    CONTROLLERS,
    Gains,
    ImpedanceQp,
    SoftIdClfQp,
    Status,
    TaskCondition,
)
from softdyn.controllers.barriers import JointLimits
from softdyn.tasks import AxisTask, PointTask, StackedReference, Target, Task
from softdyn.validation.loop.certificate import TrueRate
from tests.controllers.test_several_tasks import goals, middle, stacked
from tests.support.control_cases import drawn, gains_of, robot
from tests.support.paper_qps import (
    RANK_TOLERANCE,
    TaskTerms,
    actuated_rows,
    lyapunov,
    null_projector,
)
from tests.support.qp_solvers import Quadprog, SymbolicQp, Term, unknowns
from tests.support.refused import refused

RIDGE = 1e-7  # of the proximal iteration on semidefinite QPs
OF_QPS = ("soft-id-clf-qp", "id-clf-qp", "ic-qp", "clf-qp")


def task_lists(model: SoftModel) -> dict[str, list[Task]]:
    tip, mid = model.robot.task, middle(model)
    return {
        "point, then direction": [PointTask(tip), AxisTask(tip, [0.6, 0, -0.8], level=1)],
        "mid-point, then tip": [PointTask(tip, level=2, weight=3.0), PointTask(mid, level=1)],
        "three levels": [
            PointTask(tip, axes=(2,), Kp=200.0),
            PointTask(mid, axes=(0, 1), level=1),
            AxisTask(tip, [0, 0.6, -0.8], level=4, weight=0.1),
        ],
        "redundant": [PointTask(tip), PointTask(tip, name="again", level=1, axes=(0,)),
                      AxisTask(tip, [0.6, 0, -0.8], level=2)],
    }  # fmt: skip


def level_by_level(
    law: str, state: State, levels: list[TaskTerms], every: TaskTerms, gains: Gains
) -> tuple[np.ndarray, list[bool]]:
    """The input with every unknown explicit: each level is a QP on the optima of those above.

    The list says of each level whether its optimum has an input at a bound.
    """
    n, m = state.B.shape
    hard = law in ("id-clf-qp", "clf-qp")
    R, S = (np.eye(n), state.B) if hard else actuated_rows(state.B)
    E = np.hstack((R @ state.M, -S))
    X, free = np.linalg.lstsq(E, -R @ state.h)[0], scipy.linalg.null_space(E)
    N = null_projector(every.J)
    regulariser = {
        "acceleration": Term(gains.w2, lambda qdd, u: qdd),
        "input": Term(gains.w3, lambda qdd, u: u),
        "null": Term(gains.w4, lambda qdd, u: N @ qdd + gains.null_damping * N @ state.v),
    }
    if law == "clf-qp":
        regulariser = {"input": Term(1.0, lambda qdd, u: u)}
        levels = [*levels, None]
    saturated, model = [], state.model
    for k, terms in enumerate(levels):
        if free.shape[1] == 0:
            break
        z, delta = unknowns(free.shape[1], 1)
        all_of = free @ z + X
        qdd, u = np.eye(n, n + m) @ all_of, np.eye(m, n + m, n) @ all_of
        below = {"upper": u - model.u_max, "lower": model.u_min - u}
        if k:
            below = {name: loosened(rows) for name, rows in below.items()}
        cost = {}
        if terms is not None:
            mu = terms.J @ qdd + (terms.Jdot @ state.v - terms.yddot)
            cost["task"] = Term(gains.w1, mu - terms.mu_ref(gains))
            if law != "ic-qp":
                V, drift, slope = lyapunov(terms, gains.eps)
                cost["slack"] = Term(gains.rho, delta)
                below["decrease"] = slope[None] @ mu - delta + (drift + V / gains.eps)
        last = k == len(levels) - 1
        if last:
            cost |= {key: Term(w, of(qdd, u)) for key, (w, of, _) in regulariser.items()}
        if law == "ic-qp" or terms is None:
            cost["idle"] = Term(1.0, delta)
        qp = SymbolicQp({"z": z, "delta": delta}, cost, {}, below)
        found = Quadprog(0.0 if last else RIDGE).solve(qp)
        X = X + free @ found["z"]
        room = np.minimum(X[n:] - model.u_min, model.u_max - X[n:])
        saturated.append(bool((room < 1e-6 * (model.u_max - model.u_min)).any()))
        if not last:
            held = np.hstack((terms.J, np.zeros((len(terms.J), m)))) @ free
            values = np.linalg.svd(held)
            rank = int((values[1] > RANK_TOLERANCE * np.linalg.norm(terms.J, 2)).sum())
            free = free @ values[2][rank:].T
    return X[n:], saturated


def loosened(rows):
    """Rows of bounds without those that nothing moves, met at present whatever rounding says."""
    moves = np.linalg.norm(rows.matrix, axis=1) > 1e-9
    return type(rows)(rows.matrix[moves], np.minimum(rows.constant[moves], 0.0))


def worst(which: str, law: str, name: str, count: int) -> tuple[float, np.ndarray]:
    """The largest difference from the oracle, as a share of the input range.

    The array counts the states with an input at a bound, level by level.
    """
    model, gains = robot(which), gains_of(which)
    tasks = task_lists(model)[name]
    order = sorted({task.level for task in tasks})
    controller = CONTROLLERS[law](model, gains, tasks=tasks)
    span, found = float((model.u_max - model.u_min).max()), 0.0
    at_bounds = np.zeros(len(order) + 1, int)
    for seed, (state, _) in enumerate(drawn(which, count)):
        reference = goals(state, tasks, seed)
        by_level = [
            stacked(state, reference, [task for task in tasks if task.level == level], gains)
            for level in order
        ]
        every = stacked(state, reference, tasks, gains)
        exact, saturated = level_by_level(law, state, by_level, every, gains)
        at_bounds[: len(saturated)] += saturated
        command = controller(state, reference)
        assert command.status is Status.OK
        assert pytest.approx(sum(lyapunov(t, gains.eps).V for t in by_level)) == command.V
        found = max(found, float(np.abs(command.u - exact).max()) / span)
    return found, at_bounds


@pytest.mark.parametrize("which", ["finger", "helix", "spirob"])
def test_a_hundred_states_with_inputs_at_bounds_on_every_level(which: str) -> None:
    found, at_bounds = worst(which, "soft-id-clf-qp", "three levels", 100)
    assert found < 1e-6
    assert (at_bounds[:3] >= 5).all(), at_bounds


@pytest.mark.parametrize("law", ["soft-id-clf-qp", "id-clf-qp", "ic-qp"])
@pytest.mark.parametrize("which", ["finger", "helix", "spirob"])
def test_inputs_are_those_of_the_oracle(which: str, law: str) -> None:
    for name in task_lists(robot(which)):
        assert worst(which, law, name, 6)[0] < 1e-6, name


@pytest.mark.parametrize("which", ["finger", "spirob"])
def test_clf_qp_takes_the_least_input_on_all_levels(which: str) -> None:
    for name in ("point, then direction", "mid-point, then tip"):
        assert worst(which, "clf-qp", name, 6)[0] < 1e-6, name


def test_a_list_of_one_level_is_one_qp_whatever_its_number() -> None:
    model = robot("helix")
    lists = [
        [PointTask("tip", level=k), PointTask(middle(model), level=k, weight=0.5)] for k in (0, 3)
    ]
    one, other = (SoftIdClfQp(model, tasks=tasks) for tasks in lists)
    for seed, (state, _) in enumerate(drawn("helix")[:6]):
        reference = goals(state, lists[0], seed)
        assert np.array_equal(one(state, reference).u, other(state, reference).u)


def test_a_lower_level_never_costs_a_higher_one_anything() -> None:
    """The tip's own optimum stays, where a weight, however small, moves it."""
    model = robot("spirob")
    alone = ImpedanceQp(model, tasks=[PointTask("tip"), PointTask(middle(model), level=1)])
    rng = np.random.default_rng(0)
    for state, _ in drawn("spirob")[:6]:
        shortfalls, away = [], rng.normal(size=3)
        for goal in (0.0, 3.0):
            reference = StackedReference({
                "tip": Reference(state.y + 0.02, np.zeros(3)),
                middle(model): SetPoint(state.y + goal * away),
            })  # fmt: skip
            shortfalls.append(alone(state, reference).tasks[0].shortfall)
        assert shortfalls[1] == pytest.approx(shortfalls[0], rel=1e-6, abs=1e-6)


def test_what_a_command_reports_of_its_tasks() -> None:
    model = robot("helix")
    tip, mid = model.robot.task, middle(model)
    tasks = [
        PointTask(tip),
        PointTask(tip, name="same", level=1),
        PointTask(tip, name="other", level=1, axes=(2,)),
        PointTask(mid, level=2),
    ]
    controller = CONTROLLERS["id-clf-qp"](model, tasks=tasks)
    state, up = model.state(model.q0, np.zeros(model.nv)), np.array((0.0, 0.0, 1.0))
    here, far = SetPoint(state.y), SetPoint(state.y + 0.1 * up)
    middle_point = Reference(goals(state, [tasks[3]], 0).y)

    def reports(tip_goal, other_goal):
        goal = {tip: tip_goal, "same": tip_goal, "other": other_goal, mid: middle_point}
        command = controller(state, StackedReference(goal))
        assert [one.name for one in command.tasks] == [tip, "same", "other", mid]
        assert [one.level for one in command.tasks] == [0, 1, 1, 2]
        return command.tasks

    first, same, other, last = reports(here, far)
    assert (same.condition, same.independent) == (TaskCondition.REDUNDANT, 0)
    assert (other.condition, other.independent) == (TaskCondition.CONFLICTING, 0)
    assert first.condition is TaskCondition.MET
    assert first.independent == 3
    assert first.shortfall < 1e-6
    assert last.independent > 0
    beyond = reports(SetPoint(state.y + 1e4 * up), here)[0]
    assert beyond.condition is TaskCondition.UNREACHABLE
    assert beyond.shortfall > 1.0
    assert SoftIdClfQp(model)(state, here).tasks == ()


def test_the_true_rate_of_v_is_that_of_all_levels() -> None:
    model, tasks = robot("finger"), task_lists(robot("finger"))["mid-point, then tip"]
    gains = gains_of("finger")
    controller = CONTROLLERS["id-clf-qp"](model, gains, tasks=tasks)
    state = drawn("finger")[7][0]
    reference = goals(state, tasks, 2)
    command = controller(state, reference)

    def V(h: float) -> float:
        qdd = np.linalg.solve(state.M, state.B @ command.u - state.h)
        at = model.state(model.integrate(state.q, h * state.v + h * h / 2 * qdd),
                         state.v + h * qdd)  # fmt: skip
        moved = {
            name: Reference(g.y + h * g.ydot + h * h / 2 * g.yddot, g.ydot + h * g.yddot, g.yddot)
            for name, g in reference.targets.items()
        }
        return lyapunov(stacked(at, StackedReference(moved), tasks, gains), gains.eps).V

    h = 1e-5
    Vdot, _ = TrueRate(controller)(state, reference, command.u, command.V)
    assert Vdot == pytest.approx((V(h) - V(-h)) / (2 * h), rel=1e-5)
    assert len(command.tasks) == 2


@pytest.mark.parametrize("law", OF_QPS)
def test_hostile_numbers_lead_to_a_bounded_input(law: str) -> None:
    model = robot("finger")
    tasks = [PointTask("tip"), AxisTask("tip", [1, 0, 0], level=1)]
    controller = CONTROLLERS[law](model, gains_of("finger"), tasks=tasks)
    state = drawn("finger")[4][0]
    for size in (1e-300, 1e6, 1e150, 1e300):
        reference = StackedReference(
            {"tip": Reference(np.full(3, size), np.full(3, -size)), "tip.axis": Target([0, 0, 1])}
        )
        u = controller(state, reference).u
        assert ((model.u_min <= u) & (u <= model.u_max)).all()


@pytest.mark.parametrize("weights", [{"w3": 0.0}, {"w2": 0.0, "w4": 0.0}, {"rho": 1e-3}])
def test_edges_of_the_weights(weights: dict[str, float]) -> None:
    model, gains = robot("spirob"), replace(gains_of("spirob"), **weights)
    tasks = task_lists(model)["mid-point, then tip"]
    controller = SoftIdClfQp(model, gains, tasks=tasks)
    for seed, (state, _) in enumerate(drawn("spirob")[:6]):
        assert controller(state, goals(state, tasks, seed)).status is Status.OK


def test_what_keeps_no_levels_is_refused() -> None:
    model = robot("finger")
    tasks = [PointTask("tip"), AxisTask("tip", [1, 0, 0], level=1)]
    for law in ("ic", "uic"):
        with refused("tasks", "several"):
            CONTROLLERS[law](model, tasks=tasks)
    with refused("tasks", "several"):
        SoftIdClfQp(model, tasks=tasks, barriers=[JointLimits(model)])
    with refused("gains.w1"):
        SoftIdClfQp(model, Gains(Kp=1.0, w1=0.0), tasks=tasks)
