"""Barriers: their derivatives, the rows they become, the QP with them solved exactly."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import quadprog
from scipy.optimize import least_squares

from softdyn import SetPoint, SoftModel, State, statics
from softdyn.controllers import SoftIdClfQp, Status
from softdyn.controllers.barriers import (
    BarrierRows,
    JointLimits,
    LoadedStop,
    UnsafeStart,
)
from softdyn.controllers.qps.horizon import Horizon
from softdyn.controllers.qps.lexicographic_qp import ROOM, LexicographicQp, Rows
from softdyn.controllers.qps.qp import QpProblem
from softdyn.controllers.qps.task_qp import BACKOFF
from softdyn.safety import HalfSpace, KeepOutSphere
from softdyn.validation import simulate
from softdyn.validation.loop.setups import setup_of
from tests.support.control_cases import BUNDLED, GAINS, drawn, gains_of, robot
from tests.support.exact_qps import printed, solve_quadprog
from tests.support.qp_solvers import SymbolicQp
from tests.support.refused import refused

TAU = 0.03
ROBOTS = ("finger", "helix", "spirob", "sliding and turning")


def some_barriers(model: SoftModel, y: np.ndarray) -> tuple:
    return (
        JointLimits(model, 0.1),
        HalfSpace([1.0, 0.5, -2.0], float(y @ [1.0, 0.5, -2.0]) / 5.25**0.5 - 0.01, 15.0),
        KeepOutSphere(np.add(y, [0.02, 0.01, -0.01]), 0.02),
    )


def gains(name: str) -> object:
    return gains_of(name) if name in BUNDLED else GAINS


@pytest.mark.parametrize("name", ROBOTS)
def test_values_and_derivatives(name: str) -> None:
    model, rng = robot(name), np.random.default_rng(4)
    for state, _ in drawn(name)[2:8:3]:
        a = rng.normal(size=model.nv)  # q(t) = q ⊕ (v t + a t²/2) has q̈ = a at t = 0

        def moved(t: float, a: np.ndarray = a, start: State = state) -> State:
            return model.state(model.integrate(start.q, t * start.v + t * t / 2 * a), start.v)

        link = model.robot.chain(model.robot.task)[1].child
        of_a_link = (
            HalfSpace([1.0, 0.5, -2.0], 0.1, link=link, point=[0.01, 0.0, -0.02]),
            KeepOutSphere(np.add(state.y, 0.3), 0.02, link=link),
        )
        for barrier in (*some_barriers(model, state.y), *of_a_link):
            b, G, drift, unit = barrier(state)
            first, second = np.zeros((2, 2, len(b)))
            for i, t in enumerate((1e-4, 2e-4)):
                ahead, behind = barrier(moved(t)).b, barrier(moved(-t)).b
                first[i] = (ahead - behind) / (2 * t)
                second[i] = (ahead - 2 * b + behind) / t**2
            for analytic, (fine, coarse) in ((G @ state.v, first), (G @ a + drift, second)):
                numeric = (4 * fine - coarse) / 3  # Richardson
                scale = max(1.0, np.abs(numeric).max())
                np.testing.assert_allclose(analytic, numeric, rtol=0, atol=1e-5 * scale)
            assert ((unit == 1e-3) | (unit == 1e-2)).all()


def test_a_half_space_is_measured_along_its_unit_normal_into_the_allowed_side() -> None:
    model = robot("finger")
    state = model.state(np.full(4, 0.3), np.full(4, 0.2))
    wall = HalfSpace([0.0, 0.0, -5.0], 0.04)
    assert np.array_equal(wall.normal, [0.0, 0.0, -1.0])
    values = wall(state)
    assert values.b == pytest.approx([-state.y[2] - 0.04])
    np.testing.assert_allclose(values.gradient, -state.J[2:])
    np.testing.assert_allclose(values.drift, -state.Jdot[2:] @ state.v)


def test_the_tip_is_a_point_of_its_link() -> None:
    state = drawn("helix")[5][0]
    for of_tip in some_barriers(robot("helix"), state.y)[1:]:
        named = replace(of_tip, link=robot("helix").robot.task)
        for own, linked in zip(of_tip(state), named(state), strict=True):
            np.testing.assert_allclose(own, linked, rtol=1e-10, atol=1e-10)


def test_a_link_stays_behind_its_wall_while_the_tip_moves_on() -> None:
    model = robot("finger")
    link, start = "link3", model.link_poses(model.q0)["link3"][:3, 3]
    goal = SetPoint([0.14, 0, -0.13])
    wall = HalfSpace([0, 0, 1.0], float(start[2]) - 0.02, link=link)
    lowest = {}
    for barriers in ((), (wall,)):
        controller = SoftIdClfQp(model, barriers=barriers)
        log = simulate(model, controller, goal, duration=1.0, period=0.005)
        lowest[len(barriers)] = min(model.link_poses(q)[link][2, 3] for q in log.q)
    assert lowest[0] < start[2] - 0.025
    assert lowest[1] > start[2] - 0.0201


def test_joint_limits_are_those_of_the_file() -> None:
    model = robot("helix")
    state = model.state(model.q0, np.zeros(model.nv))
    values = JointLimits(model)(state)
    assert len(values.b) == 2 * model.nv
    np.testing.assert_allclose(values.b[: model.nv], -model.lower)
    np.testing.assert_allclose(values.b[model.nv :], model.upper)
    inset = JointLimits(model, 0.1)(state)
    np.testing.assert_allclose(inset.b + 0.1 * np.tile(model.upper - model.lower, 2), values.b)


def test_units_are_millimetres_where_joints_slide_and_hundredths_of_a_radian_elsewhere() -> None:
    model = robot("sliding and turning")  # a slide, a joint without limits, two that turn
    state = model.state(model.q0, np.zeros(model.nv))
    np.testing.assert_array_equal(JointLimits(model)(state).unit, [1e-3, 1e-2, 1e-2] * 2)
    for barrier in some_barriers(model, state.y)[1:]:
        np.testing.assert_array_equal(barrier(state).unit, [1e-3])
    # violations in view of the barriers: the slide by 5 mm, then a joint by 0.05 rad
    rows = BarrierRows(model, (JointLimits(model),), TAU)
    for joint, beyond in ((0, 5e-3), (2, 0.08)):
        at = np.zeros(model.nv)
        at[joint] = model.upper[joint] + beyond
        here = model.state(model.configuration(at), np.zeros(model.nv))
        rows.at(here)
        assert rows.violation == pytest.approx({0: 5.0, 2: 8.0}[joint])


def test_the_least_by_which_rows_give_way() -> None:
    """min ‖s‖² with matrix u - unit s ≤ upper and u in bounds, by another solver.

    Inputs of ranges from 1e-3 to 1e3, and rows of which two or three cannot be met together.
    """
    rng = np.random.default_rng(6)
    for _ in range(5):
        span = 10.0 ** rng.uniform(-3, 3, 3)
        first = rng.normal(size=(2, 3)) / span
        matrix = np.vstack((first, -first[:1] - 0.1 * first[1:], rng.normal(size=3) / span))
        unit = 10.0 ** rng.uniform(-3, -1, 4)
        upper = np.array([-0.3, -0.4, -0.2, 5.0])
        found, _ = LexicographicQp(-span, span).least_slack(Rows(matrix, upper, unit), np.zeros(3))

        # in u / span and s, with a weight on u far below the tested accuracy
        scaled, bound = matrix * span / unit[:, None], upper / unit
        sides = np.block([[-scaled, np.eye(4)], [np.eye(3), np.zeros((3, 4))],
                          [-np.eye(3), np.zeros((3, 4))]])  # fmt: skip
        H, ends = np.diag([1e-9] * 3 + [1.0] * 4), np.concatenate((-bound, -np.ones(6)))
        exact = quadprog.solve_qp(H, np.zeros(7), sides.T, ends)[0][3:]
        assert found.max() > 1
        np.testing.assert_allclose(found, np.maximum(exact, 0.0), atol=0.05)  # mm


def test_without_an_accurate_answer_the_input_is_that_of_least_excess(monkeypatch) -> None:
    qp = LexicographicQp(np.full(2, -1.0), np.ones(2))
    monkeypatch.setattr(qp, "_restricted", lambda *a: None)
    A, (lower, upper) = np.eye(2), np.array([[-1.0, -1.0], [1.0, 1.0]])
    problem = QpProblem(np.eye(2), np.zeros(2), A, lower, upper)
    rows = Rows(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([-0.5, -0.5]), np.ones(2))
    found = qp.ordered(problem, np.array([0.0, 0.3]), rows)
    assert found is not None
    assert found.least
    np.testing.assert_allclose(found.solution.x, [0.0, 0.3], atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_rows_are_the_barriers_over_the_hold(name: str) -> None:
    # for any u: slack of a row = (b̈ + 2α ḃ⁺ + α² b⁺) / (1 + ατ)² with everything at the end of τ
    model, rng = robot(name), np.random.default_rng(5)
    for state, _ in drawn(name)[:6:2]:
        barriers = some_barriers(model, state.y)
        M, h = Horizon(model, TAU)(state)
        rows = BarrierRows(model, barriers, TAU).at(state)
        u = rng.uniform(model.u_min, model.u_max)
        qdd = np.linalg.solve(M, state.B @ u - h)
        wanted = []
        for barrier in barriers:
            b, G, drift, _ = barrier(state)
            second, alpha = G @ qdd + drift, barrier.rate
            first = G @ state.v + TAU * second
            wanted.append(
                (second + 2 * alpha * first + alpha**2 * (b + TAU * first)) / (1 + alpha * TAU) ** 2
            )
            # one unit of relaxation lets b decrease by its own unit
            (unit,) = rows.unit[len(np.concatenate(wanted)) - 1 :][:1]
            assert unit == pytest.approx(
                alpha**2 * barrier(state).unit[-1] / (1 + alpha * TAU) ** 2
            )
        slack = rows.upper - rows.matrix @ u
        size = max(1.0, np.abs(rows.matrix * u).max(), np.abs(rows.upper).max())
        np.testing.assert_allclose(slack, np.concatenate(wanted), atol=1e-9 * size)


def with_rows(qp: SymbolicQp, matrix: np.ndarray, upper: np.ndarray) -> SymbolicQp:
    rows = {"barriers": matrix @ qp.variables["u"] - upper}
    return replace(qp, below=qp.below | rows)


@pytest.mark.parametrize("name", ["finger", "spirob", "sliding and turning"])
def test_inputs_are_those_of_the_textbook_form_with_the_rows(name: str) -> None:
    model, active = robot(name), 0
    spread = float((model.u_max - model.u_min).max())
    for state, reference in drawn(name)[::2]:
        barriers = some_barriers(model, state.y)
        controller = SoftIdClfQp(model, gains(name), horizon=TAU, barriers=barriers)
        command = controller(state, reference)
        assert command.status is Status.OK
        M, h = Horizon(model, TAU)(state)
        rows = BarrierRows(model, barriers, TAU).at(state)
        if controller.barrier_rows.relaxed:
            continue
        upper = rows.upper + ROOM * rows.unit
        assert ((rows.matrix @ command.u - upper) / np.maximum(1.0, np.abs(upper))).max() < 1e-6
        free = SoftIdClfQp(model, gains(name), horizon=TAU)(state, reference).u
        active += np.abs(free - command.u).max() > 1e-6 * spread
        qp = printed(replace(state, M=M, h=h), reference, controller.gains, margin=BACKOFF)
        exact = solve_quadprog(with_rows(qp, rows.matrix, upper))
        if exact.residual < 1e-9:
            np.testing.assert_allclose(command.u, exact["u"], rtol=0, atol=1e-5 * spread)
    assert active  # at least one row changed an input


def test_rows_that_cannot_all_be_met_give_way_and_say_so() -> None:
    # two disjoint half-spaces: the input bounds stay hard, and both barriers relax equally
    model = robot("finger")
    state = model.state(np.full(4, 0.3), np.zeros(4))
    walls = [
        HalfSpace([1.0, 0.0, 0.0], state.y[0] + 0.05),
        HalfSpace([-1.0, 0.0, 0.0], -state.y[0] + 0.05),
    ]
    controller = SoftIdClfQp(model, horizon=TAU, barriers=walls)
    command = controller(state, SetPoint(state.y))
    assert command.status is Status.OK
    assert (command.u >= model.u_min).all()
    assert (command.u <= model.u_max).all()
    report = controller.barrier_rows
    assert report.relaxed == 1
    assert report.relaxation == pytest.approx(50.0, rel=0.02)  # millimetres
    assert report.violation == pytest.approx(50.0)


def test_a_limit_whose_stop_carries_load_is_named_once() -> None:
    """On the hanging helix gravity presses sliding joints on their stops, by statics too."""
    model = robot("helix")
    held = statics.rest(model).held
    law, goal = SoftIdClfQp(model, barriers=[JointLimits(model)]), setup_of(model).set_point(0.5)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        simulate(model, law, goal, duration=0.06, period=0.0075)
    loads = [str(one.message) for one in said if one.category is LoadedStop]
    assert len(loads) == 1
    named = {name for name in model.joint_names if re.search(rf"\b{name}\b", loads[0])}
    assert named
    assert named <= {model.joint_names[j] for j in np.flatnonzero(held)}
    finger = robot("finger")  # hangs on no stop
    law = SoftIdClfQp(finger, barriers=[JointLimits(finger)])
    with warnings.catch_warnings():
        warnings.simplefilter("error", LoadedStop)
        simulate(finger, law, setup_of(finger).set_point(0.5), duration=0.2, period=0.005)


def test_rows_give_way_on_the_helix_whatever_the_state() -> None:
    """Earlier, 11 of 90 such states were not solved: sets thinner than the tolerance."""
    model, rng = robot("helix"), np.random.default_rng(2)
    size = model.upper - model.lower
    controller = SoftIdClfQp(model, horizon=TAU, barriers=[JointLimits(model)])
    report, span = controller.barrier_rows, model.u_max - model.u_min
    rows = BarrierRows(model, [JointLimits(model)], TAU)
    for count in range(1, 9):
        q = (model.lower + model.upper) / 2 + rng.uniform(-0.4, 0.4, model.nv) * size
        state = model.state(q, 0.1 * rng.normal(size=model.nv) * size)
        goal = np.clip(q + 0.1 * rng.normal(size=model.nv) * size, model.lower, model.upper)
        command = controller(state, SetPoint(model.state(goal, np.zeros(model.nv)).y))
        assert command.status is Status.OK
        assert ((model.u_min <= command.u) & (command.u <= model.u_max)).all()
        assert report.relaxed == count
        # the least squares of the excess, by SciPy, in u / span
        matrix, upper, unit = rows.at(state)
        scaled, bound = matrix / unit[:, None], upper / unit

        def excess(u: np.ndarray, scaled=scaled, bound=bound) -> np.ndarray:
            return np.maximum(scaled @ u - bound, 0.0)

        best = least_squares(
            lambda part, excess=excess: excess(model.u_min + part * span),
            np.clip((command.u - model.u_min) / span, 1e-6, 1 - 1e-6),
            bounds=(0.0, 1.0),
        )
        room = ROOM * len(upper) ** 0.5
        assert np.linalg.norm(excess(command.u)) <= 1.01 * (2 * best.cost) ** 0.5 + room
    assert report.least == 0  # every relaxed QP has an accurate answer


def test_the_tip_stays_out_of_a_ball_at_which_it_chattered() -> None:
    # with rows over the horizon alone 13.1 mm deep, no row relaxed
    model = robot("finger")
    ball = KeepOutSphere([0.2143343, 0.0, -0.07078731], 0.0192)
    controller = SoftIdClfQp(model, horizon=TAU, barriers=[ball])
    goal = setup_of(model).set_point(0.0)
    log = simulate(model, controller, goal, duration=0.7, period=0.005)
    assert np.linalg.norm(log.y - ball.centre, axis=1).min() > ball.radius
    assert controller.barrier_rows.relaxed == 0


def test_a_start_without_a_promise_is_warned_of_and_such_states_are_counted() -> None:
    model, alpha = robot("finger"), 10.0
    q = np.full(4, 0.3)
    state = model.state(q, np.full(4, 0.5))
    down = -state.ydot[2]
    assert down > 0.01
    for room, safe in ((1.01 * down / alpha, True), (0.99 * down / alpha, False), (-1e-3, False)):
        wall = HalfSpace([0.0, 0.0, 1.0], state.y[2] - room, rate=alpha)
        controller = SoftIdClfQp(model, horizon=TAU, barriers=[wall])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(2):
                controller(state, SetPoint(state.y))
        assert [w.category for w in caught] == ([] if safe else [UnsafeStart])
        assert controller.barrier_rows.outside == (0 if safe else 2)
        controller.reset(0.005)
        assert controller.barrier_rows.outside == 0


@pytest.mark.parametrize(("alpha", "tau"), [(10.0, 0.03), (40.0, 0.2), (3.0, 0.0)])
def test_what_the_row_keeps(alpha: float, tau: float) -> None:
    # at the bound of the row, backward Euler: b >= 0 and db/dt + alpha b >= 0 stay so
    rng, step = np.random.default_rng(1), tau or 1e-6
    for b, s in rng.uniform(0, [1.0, 5.0], (50, 2)) * rng.integers(0, 2, (50, 2)):
        rate = s - alpha * b
        second = -(alpha * (2 + alpha * tau) * rate + alpha**2 * b) / (1 + alpha * tau) ** 2
        later = rate + step * second
        assert b + step * later >= -1e-10
        assert later + alpha * (b + step * later) >= -1e-10


def test_a_barrier_out_of_the_way_changes_nothing() -> None:
    model = robot("finger")
    far = [KeepOutSphere([5.0, 0.0, 0.0], 0.1), HalfSpace([0.0, 0.0, 1.0], -9.0)]
    # without a horizon the damping force at its start alone would break the rows
    one, two = (SoftIdClfQp(model, horizon=TAU, barriers=b) for b in ((), far))
    for state, reference in drawn("finger"):
        np.testing.assert_array_equal(one(state, reference).u, two(state, reference).u)
    assert two.barrier_rows.relaxed == 0


def test_the_tip_stops_at_a_wall_the_published_law_passes() -> None:
    model = robot("finger")
    start = model.state(model.q0, np.zeros(4)).y
    goal = SetPoint(np.add(start, [-0.05, 0.0, -0.1]))
    wall = HalfSpace([0.0, 0.0, 1.0], start[2] - 0.06)
    lowest = {}
    for name, barriers in (("free", ()), ("walled", (wall,))):
        controller = SoftIdClfQp(model, horizon=TAU, barriers=barriers)
        log = simulate(model, controller, goal, duration=1.0, period=0.005)
        lowest[name] = log.y[:, 2].min() - wall.offset
    assert lowest["free"] < -0.02
    assert lowest["walled"] > -1e-3


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: HalfSpace([0.0, 0.0, 0.0], 0.0), "normal"),
        (lambda: HalfSpace([0.0, 1.0], 0.0), "normal"),
        (lambda: HalfSpace([0.0, 0.0, 1.0], float("nan")), "offset"),
        (lambda: KeepOutSphere([0.0, 0.0, 0.0], 0.0), "radius"),
        (lambda: KeepOutSphere([0.0, 0.0, float("inf")], 1.0), "centre"),
        (lambda: KeepOutSphere([0.0, 0.0, 0.0], 1.0, rate=-1.0), "rate"),
        (lambda: HalfSpace([0.0, 0.0, 1.0], 0.0, link=3), "link"),
        (lambda: KeepOutSphere([0.0, 0.0, 0.0], 1.0, point=[1.0, 0.0, 0.0]), "point"),
        (lambda: JointLimits(robot("finger"), -0.1), "margin"),
    ],
)
def test_barriers_that_make_no_sense(make: object, name: str) -> None:
    with refused(name):
        make()  # type: ignore[operator]


def test_the_former_place_of_an_obstacle_warns():
    with pytest.warns(DeprecationWarning, match="softdyn.safety"):
        from softdyn.controllers.barriers import HalfSpace as Former
    assert Former is HalfSpace
