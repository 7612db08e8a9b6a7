"""Controllers of several tasks against the paper's printed QPs, written for any number of rows."""

from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.controllers import CONTROLLERS, Gains, SoftIdClfQp
from softdyn.tasks import (
    AxisTask,
    JointTask,
    LinkKinematics,
    OrientationTask,
    PointTask,
    Poses,
    PoseTask,
    References,
    StackedReference,
    Target,
    Task,
    TaskError,
    compute_errors,
)
from softdyn.tasks.targets import exp3
from softdyn.validation import simulate
from tests.support import paper_qps
from tests.support.control_cases import drawn, gains_of, robot
from tests.support.paper_qps import TaskTerms
from tests.support.qp_solvers import LeastNorm, Quadprog, Unsolved, unknowns
from tests.support.refused import refused

RIDGE = 1e-7  # of the proximal iteration on CLF-QP's semidefinite QP


def middle(model: SoftModel) -> str:
    """A link half-way along the arm."""
    chain = model.robot.chain(model.robot.task)
    return chain[len(chain) // 2].child


def task_lists(model: SoftModel) -> dict[str, list[Task]]:
    tip = model.robot.task
    return {
        "pose": [PoseTask(tip, name="hand")],
        "two points": [PointTask(tip), PointTask(middle(model), (0.01, 0, 0), weight=0.3)],
        "point and direction": [
            PointTask(tip, axes=(0, 2), weight=(2.0, 0.5)),
            AxisTask(tip, [0.6, 0, -0.8], weight=0.05, Kp=40.0),
        ],
    }


def goals(state: State, tasks: list[Task], seed: int) -> StackedReference:
    """Moving targets near the present values."""
    rng, found = np.random.default_rng(seed), {}
    for task in tasks:
        at = LinkKinematics.of(state.model)(state, task.link)
        near = Reference(at.position + rng.normal(size=3) * 0.03, *rng.normal(size=(2, 3)) * 0.1)
        turn = Target(exp3(rng.normal(size=3) * 0.3) @ at.rotation, *rng.normal(size=(2, 3)) * 0.1)
        if isinstance(task, PointTask):
            found[task.name] = near
        elif isinstance(task, PoseTask):
            found[task.name] = Poses(lambda t, y=near: y, turn)(0.0)
        else:
            found[task.name] = Target(turn.y @ task.axis)
    return StackedReference(found)


@dataclass(frozen=True, eq=False)
class WeightedTerms(TaskTerms):
    """Stacked tasks, scaled by the roots of their weights, with a stiffness for each row."""

    Kp: np.ndarray

    def mu_ref(self, gains: Gains) -> np.ndarray:
        return -2 * np.sqrt(self.Kp) * self.edot - self.Kp * self.e


def stacked(state: State, reference: Reference, tasks: list[Task], gains: Gains) -> WeightedTerms:
    parts = []
    for task in tasks:
        e, edot, J, drift = task(state, reference)
        root = np.sqrt(np.broadcast_to(task.weight, e.shape))
        stiff = np.full(len(e), gains.Kp if task.Kp is None else task.Kp)
        parts.append((root[:, None] * J, 0 * J, root * e, root * edot, -root * drift, stiff))
    return WeightedTerms(*(np.concatenate(same) for same in zip(*parts, strict=True)))


def pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Like the oracle's own, but rounding errors of a zero matrix count as zero."""
    return paper_qps.inverse(np.where(np.abs(matrix) < 1e-12, 0.0, matrix))


def textbook(law: str, state: State, terms: TaskTerms, gains: Gains) -> np.ndarray:
    if law in paper_qps.PAPER_QPS:
        qp = paper_qps.PAPER_QPS[law](unknowns, state, terms, gains)
        if law != "clf-qp":
            return Quadprog().solve(qp)["u"]
        try:
            return LeastNorm(Quadprog(RIDGE)).solve(qp)["u"]
        except Unsolved:  # in its second stage; any minimiser will do
            return Quadprog(RIDGE).solve(qp)["u"]
    torque = paper_qps.impedance(state, terms, gains)
    if law == "uic":
        torque = paper_qps.underactuated(state, terms, torque, pseudo_inverse)
    return np.clip(paper_qps.inputs(state, torque), state.model.u_min, state.model.u_max)


def clf_cost(u: np.ndarray, state: State, terms: TaskTerms, gains: Gains) -> float:
    qdd = np.linalg.solve(state.M, state.B @ u - state.h)
    mu = terms.J @ qdd - terms.yddot
    V, drift, slope = paper_qps.lyapunov(terms, gains.eps)
    slack = max(0.0, drift + slope @ mu + V / gains.eps)
    return float(gains.w1 * np.sum((mu - terms.mu_ref(gains)) ** 2) + gains.rho * slack**2)


@pytest.mark.parametrize("law", sorted(CONTROLLERS))
@pytest.mark.parametrize("which", ["finger", "helix", "spirob"])
def test_inputs_are_those_of_the_textbook_form(which: str, law: str) -> None:
    model, gains = robot(which), gains_of(which)
    span = float((model.u_max - model.u_min).max())
    for name, tasks in task_lists(model).items():
        controller = CONTROLLERS[law](model, gains, tasks=tasks)
        for seed, (state, _) in enumerate(drawn(which)[:8]):
            reference = goals(state, tasks, seed)
            terms = stacked(state, reference, tasks, gains)
            command = controller(state, reference)
            exact = textbook(law, state, terms, gains)
            values = np.linalg.svd(terms.J @ np.linalg.solve(state.M, state.B))[1]
            if law == "clf-qp" and 1e-9 < values[values > 1e-9].min() / values[0] < 1e-5:
                continue  # beside the rank threshold, which the printed QP does not have
            if np.abs(command.u - exact).max() >= 1e-6 * span:
                # a solver cannot tell minimisers of CLF-QP whose costs agree to 1e-9
                assert law == "clf-qp", (name, seed)
                ours, theirs = (clf_cost(u, state, terms, gains) for u in (command.u, exact))
                assert ours <= theirs * (1 + 1e-9), (name, seed)
            assert pytest.approx(paper_qps.lyapunov(terms, gains.eps).V, rel=1e-9) == command.V
        assert controller.guard.fallbacks == 0


@pytest.mark.parametrize("law", sorted(CONTROLLERS))
def test_the_position_of_the_tip_alone_is_the_controller_without_tasks(law: str) -> None:
    model = robot("spirob")
    plain, listed = (CONTROLLERS[law](model, tasks=tasks) for tasks in (None, [PointTask("tip")]))
    for state, reference in drawn("spirob"):
        stack = StackedReference({"other": SetPoint([1, 2, 3]), "tip": reference})
        one = plain(state, reference)
        for same in (listed(state, reference), listed(state, stack)):
            assert np.array_equal(one.u, same.u)
            assert (one.V, one.delta) == pytest.approx((same.V, same.delta), abs=0, nan_ok=True)


class Height(Task):
    """A user's own task: the tip's height above a target."""

    size = 1

    def evaluate(self, state: State, target: Target) -> TaskError:
        height, rate = state.y[2:] - target.y, state.ydot[2:] - target.ydot
        return TaskError(height, rate, state.J[2:], state.Jdot[2:] @ state.v - target.yddot)


def test_a_user_s_own_task_is_one_class_with_one_method() -> None:
    model = robot("finger")
    own = SoftIdClfQp(model, tasks=[Height(name="height", target=Target([-0.1]))])
    ours = SoftIdClfQp(model, tasks=[PointTask("tip", axes=(2,))])
    for state, reference in drawn("finger"):
        one = own(state, StackedReference({"height": Target(reference.y[2:], reference.ydot[2:],
                                                            reference.yddot[2:]),
                                           "tip": reference}))  # fmt: skip
        np.testing.assert_allclose(one.u, ours(state, reference).u, atol=1e-9)
    assert own(state, SetPoint([0, 0, 0])).V >= 0  # its own target


def test_copies_of_a_controller_have_arrays_of_their_own() -> None:
    model, tasks = robot("finger"), [PoseTask("tip", name="hand")]
    controller = SoftIdClfQp(model, tasks=tasks)
    state = drawn("finger")[4][0]
    reference = goals(state, tasks, 1)
    u = controller(state, reference).u
    for other in (copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))):
        assert np.array_equal(other(state, reference).u, u)
        assert other.error.J is not controller.error.J


class Crooked(Height):
    """A task whose results have another shape than it says."""

    size = 2


@pytest.mark.parametrize(("tasks", "expected"), [
    ([], ("tasks", "none")), ([PointTask("tip"), PointTask("tip")], ("tasks", "'tip' twice")),
    ("tip", ("tasks", )), ([1], ("tasks[0]", 1)), (3, ("tasks", )),
    ([Crooked(name="h", target=Target([0.0]))], ("task 'h'", "[(1,), (1,), (1, 4), (1,)]")),
    ([OrientationTask("tip")], ("reference", "a plain reference")),
    ([PointTask("tipp")], ("link", "'tipp'; did you mean 'tip'?")),
    ([JointTask(["joint9"], target=Target([0.0]))], ("joints", "'joint9'; did you mean 'joint4'?")),
])  # fmt: skip
def test_every_misuse_is_one_line(tasks, expected) -> None:
    state, reference = drawn("finger")[0]
    with refused(*expected) as caught:
        SoftIdClfQp(robot("finger"), tasks=tasks)(state, reference)
    assert "\n" not in str(caught.value)


def test_errors_by_task_along_a_run() -> None:
    model = robot("finger")
    tasks = [PointTask("tip"), AxisTask("tip", [1, 0, 0], weight=0.01)]
    goal = References({"tip": SetPoint([0.13, 0, -0.13]), "tip.axis": Target([0, 0, -1])})
    log = simulate(model, SoftIdClfQp(model, tasks=tasks), goal, duration=0.3, period=0.005)
    errors = compute_errors(model, tasks, log, goal)
    np.testing.assert_allclose(errors["tip"], np.linalg.norm(log.error, axis=1), atol=1e-12)
    assert errors["tip.axis"][0] == pytest.approx(np.pi / 2)
    assert errors["tip"][-1] < 0.5 * errors["tip"][0]
    np.testing.assert_array_equal(log.tasks, np.column_stack([*errors.values()]))
    last = log.report()["tasks"]["tip.axis"]
    assert last["unit"] == "degrees"
    assert last["last"] == pytest.approx(np.degrees(errors["tip.axis"][-1]))


def test_a_pose_has_an_error_in_m_and_one_in_rad() -> None:
    model = robot("finger")
    at = LinkKinematics.of(model)(model.state(model.q0, np.zeros(model.nv)), "tip")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = at.rotation, at.position + np.array([0.003, 0, -0.004])
    hand = PoseTask("tip", name="hand")
    run, goal = SimpleNamespace(t=[0.0], q=[model.q0], v=[np.zeros(model.nv)]), Target(pose)
    found = compute_errors(model, [hand], run, lambda t: StackedReference({"hand": goal}))
    assert found["hand.position"] == pytest.approx(0.005)
    assert found["hand.angle"] == pytest.approx(0.0, abs=1e-12)
    assert list(PoseTask("tip", axes=(0, 4)).columns(2)) == ["tip.pose.position", "tip.pose.angle"]
