"""Every kind of task against central differences and MuJoCo's frame Jacobians."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import softdyn
from softdyn import InputError, Reference, SetPoint, SoftModel, design
from softdyn.dynamics.reduced import Basis
from softdyn.tasks import (
    AxisTask,
    JointTask,
    LinkKinematics,
    OrientationTask,
    PointTask,
    Poses,
    PoseTask,
    ShapeTask,
    StackedReference,
    StrainTask,
    Target,
    Task,
    TaskError,
)
from softdyn.tasks.targets import exp3
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin
from tests.support.arms import EVERYTHING, loaded
from tests.support.named_models import named_model
from tests.support.oracles import relative
from tests.support.robots import WALKER, build

BAR = 1e-7
ANGLES = (0.0, 1e-4, 1.5, math.pi - 1e-3)
ROBOTS = ("finger", "helix", "mimic", "walker")


@pytest.fixture(params=ROBOTS, ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def unit(vector) -> np.ndarray:
    return np.asarray(vector) / np.linalg.norm(vector)


class Path:
    """A state that accelerates, and targets that move, an angle away from it."""

    def __init__(self, model: SoftModel, angle: float, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.model, self.link = model, model.robot.task
        low, high = np.maximum(model.lower, -0.5), np.minimum(model.upper, 0.5)
        self.q = model.configuration(rng.uniform(low, high))
        self.v, self.a = 0.3 * rng.normal(size=(2, model.nv))
        at = LinkKinematics.of(model)(model.state(self.q, self.v), self.link)
        self.R, self.place, self.turn = at.rotation, at.position, unit(rng.normal(size=3))
        self.start = exp3(-angle * unit(rng.normal(size=3))) @ at.rotation
        self.axis, self.shift = unit(rng.normal(size=3)), 0.1 * rng.normal(size=(3, 3))
        aside = unit(np.cross(self.R @ self.axis, self.turn))
        self.direction = exp3(angle * aside) @ self.R @ self.axis

    def state(self, t: float, v: np.ndarray | None = None):
        v = self.v if v is None else v
        dq = v * t + (self.a * t * t / 2 if v is self.v else 0)
        return self.model.state(self.model.integrate(self.q, dq), v + self.a * t)

    def point(self, t: float) -> Reference:
        p, v, a = self.shift
        return Reference(self.place + p + v * t + a * t * t / 2, v + a * t, a)

    def rotation(self, t: float) -> Target:
        turned = exp3((0.3 * t + 0.35 * t * t) * self.turn) @ self.start
        return Target(turned, (0.3 + 0.7 * t) * self.turn, 0.7 * self.turn)

    def heading(self, t: float) -> Target:
        d = exp3((0.3 * t + 0.35 * t * t) * self.turn) @ self.direction
        omega, alpha = (0.3 + 0.7 * t) * self.turn, 0.7 * self.turn
        rate = np.cross(omega, d)
        return Target(d, rate, np.cross(alpha, d) + np.cross(omega, rate))

    def points(self, t: float) -> Target:
        one = self.point(t)
        return Target(*(np.array([part, 2 * part]) for part in (one.y, one.ydot, one.yddot)))

    def joints(self, t: float) -> Target:
        n = self.model.nv
        ramp = np.linspace(-0.2, 0.3, n)
        return Target(ramp + ramp * t + ramp * t * t / 2, ramp + ramp * t, ramp)

    def cases(self) -> dict[str, tuple[Task, Callable[[float], object]]]:
        found: dict[str, tuple[Task, Callable[[float], object]]] = {
            "point": (PointTask(self.link, (0.01, 0.02, -0.03)), self.point),
            "orientation": (OrientationTask(self.link), self.rotation),
            "pose": (PoseTask(self.link, (0.01, 0, 0.02)), Poses(self.point, self.rotation)),
            "axis": (AxisTask(self.link, self.axis), self.heading),
        }
        if not self.model.robot.floating:
            length = self.model.robot.length
            names, n = self.model.joint_names, self.model.nv
            S = np.random.default_rng(1).normal(size=(n, 2))[::-1]
            strains = StrainTask(Basis(S, names[::-1], ("a", "b")))
            found |= {
                "shape": (ShapeTask([0.4 * length, length]), self.points),
                "joints": (JointTask(), self.joints),
                "strains": (strains, lambda t: Target(np.array([0.1 * t * t, -t]), [0.2 * t, -1],
                                                      [0.2, 0])),
            }  # fmt: skip
        return found


def rate(f: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    def central(h: float) -> np.ndarray:
        return (f(h) - f(-h)) / (2 * h)

    return (4 * central(h) - central(2 * h)) / 3


@pytest.mark.parametrize("angle", ANGLES)
def test_both_rates_and_the_jacobian_are_central_differences(model, angle):
    path = Path(model, angle)
    for kind, (task, target) in path.cases().items():
        # directions near the antipode turn within the distance from it
        h = 1e-3 if angle < 3 else (3e-6 if kind == "axis" else 1e-4)
        found = task.evaluate(path.state(0.0), target(0.0))

        def at(t: float, task=task, target=target) -> TaskError:
            return task.evaluate(path.state(t), target(t))

        assert relative(rate(lambda t: at(t).error, h), found.rate, 1.0) < BAR, kind
        second = rate(lambda t: at(t).rate, h)
        assert relative(second, found.jacobian @ path.a + found.drift, 1.0) < BAR, kind
        fixed = target(0.0)
        columns = [
            rate(lambda t, x=x, f=task.evaluate, y=fixed: f(path.state(t, x), y).error, h)
            for x in np.eye(model.nv)
        ]
        assert relative(np.array(columns).T, found.jacobian, 1.0) < BAR, kind
        if kind in ("orientation", "axis"):
            assert np.linalg.norm(found.error) == pytest.approx(angle, abs=1e-9)


@given(st.floats(0, math.pi - 1e-3), st.integers(0, 1000))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_the_drift_is_a_central_difference_at_any_angle(angle, seed):
    path = Path(FINGER, angle, seed)
    for kind in ("orientation", "pose", "axis"):
        task, target = path.cases()[kind]
        h = min(1e-3, (math.pi - angle) / (200 if kind == "axis" else 10))
        second = rate(lambda t, f=task.evaluate, at=target: f(path.state(t), at(t)).rate, h)
        found = task.evaluate(path.state(0.0), target(0.0))
        assert relative(second, found.jacobian @ path.a + found.drift, 1.0) < BAR, kind


@pytest.mark.parametrize("which", ["finger", "helix", "mimic", "walker", 1, 12, 16])
def test_frames_are_those_of_mujoco(which, tmp_path):
    """Jacobians and J̇ q̇ of every link's frame, by another engine's reading of the file."""
    model = named_model(which, tmp_path)
    rng = np.random.default_rng(4)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    q, v = model.configuration(rng.uniform(low, high)), rng.normal(size=model.nv)
    state = model.state(q, v)
    for link in [each.name for each in model.robot.links][:: max(1, len(model.robot.links) // 6)]:
        twin = Twin(replace(model.robot, task=link))
        states = StateMap(model, twin)
        body, point = twin.task
        qpos, qvel = states.to_twin(q, v)
        mj, data = twin.model, mujoco.MjData(twin.model)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_fwdPosition(mj, data)
        mujoco.mj_fwdVelocity(mj, data)
        spot = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
        J, Jdot = np.zeros((2, 6, mj.nv))
        mujoco.mj_jac(mj, data, J[:3], J[3:], spot, body)
        mujoco.mj_jacDot(mj, data, Jdot[:3], Jdot[3:], spot, body)
        ours = LinkKinematics.of(model)(state, link)
        mapped, rated = states.velocity_map(qpos), states.velocity_map_rate(qpos, qvel)
        assert relative(ours.position, spot, 0.1) < 1e-10
        assert relative(ours.jacobian, J @ mapped, 0.1) < 1e-10
        assert relative(ours.velocity, J @ qvel, 0.1) < 1e-10
        assert relative(ours.drift, Jdot @ qvel + J @ (rated @ v), 1.0) < 1e-10
        kinematics, frames = (
            LinkKinematics.of(model),
            [(link, (0.0, 0.0, 0.0)), (link, (0.1, 0.2, 0.3))],
        )
        both = kinematics.motions(state, kinematics.places(frames))
        for k, frame in enumerate(frames):
            for part, alone in zip(both, kinematics(state, *frame), strict=True):
                np.testing.assert_array_equal(part[k], alone)


def test_the_position_of_the_tip_is_the_state_s():
    model = softdyn.load("helix")
    rng = np.random.default_rng(2)
    state = model.state(0.1 * rng.normal(size=model.nv), rng.normal(size=model.nv))
    goal = Reference([0.1, 0.2, -0.3], [0.1, 0, 0], [0, 0.3, 0])
    error = PointTask(model.robot.task)(state, goal)
    assert relative(error.error, state.y - goal.y) < 1e-13
    assert relative(error.rate, state.ydot - goal.ydot) < 1e-12
    assert relative(error.jacobian, state.J) < 1e-13
    assert relative(error.drift, state.Jdot @ state.v - goal.yddot) < 1e-12


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, -1), (-0.6, 0.8, 0), (0, -0.6, 0.8)])
def test_at_half_a_turn_the_branch_is_that_of_the_stated_axis(axis):
    path = Path(softdyn.load("finger"), 0.0)
    state = path.state(0.0)
    # a finite branch for π itself, and for the numbers next to it
    for angle in (math.pi, np.nextafter(math.pi, 0), np.nextafter(math.pi, 4)):
        target = Target(exp3(angle * np.array(axis, float)).T @ path.R)
        found = OrientationTask("tip").evaluate(state, target)
        first = next(x for x in axis if x)
        assert found.error == pytest.approx(math.copysign(math.pi, first) * np.array(axis))
        pose = PoseTask("tip").evaluate(state, Poses(SetPoint(path.place), target)(0.0))
        assert all(np.isfinite(part).all() for part in (*found, *pose))


def test_an_antiparallel_axis_has_a_stated_finite_branch():
    path = Path(softdyn.load("finger"), 0.0)
    state = path.state(0.0)
    for k in range(3):
        d = np.zeros(3)
        d[k] = 1.0
        task = AxisTask("tip", path.R.T @ -d)
        found = task.evaluate(state, Target(d, np.eye(3)[(k + 1) % 3], -d))
        first = np.eye(3)[0 if k else 1]
        assert found.error == pytest.approx(math.pi * np.cross(d, first), abs=1e-6)
        assert all(np.isfinite(part).all() for part in found)
        # its Jacobian is the turn about the stated axis
        n = np.cross(d, first)
        jacobian = LinkKinematics.of(state.model)(state, "tip").jacobian[3:]
        assert found.jacobian == pytest.approx(np.outer(n, n @ jacobian), abs=1e-9)


def test_a_continuous_joint_takes_the_shorter_way():
    model = build(WALKER)
    q = model.configuration(np.where([n == "jz" for n in model.joint_names], 3.0, 0.0))
    error = JointTask(["jz"]).evaluate(model.state(q, np.zeros(model.nv)), Target([-3.0]))
    assert error.error == pytest.approx([6 - 2 * math.pi])


def test_points_of_the_arm_lie_on_its_axis():
    model = softdyn.load("spirob")
    state, length = model.state(model.q0, np.zeros(model.nv)), model.robot.length
    arcs = np.linspace(0, length, 9)
    nowhere = Target(np.zeros((9, 3)))
    found = ShapeTask(arcs).evaluate(state, nowhere).error.reshape(9, 3)
    root = LinkKinematics.of(model)(state, model.robot.root).position
    assert np.linalg.norm(found - root, axis=1) == pytest.approx(arcs, abs=1e-12)
    assert found[-1] == pytest.approx(state.y)


def test_strains_are_those_of_a_reduced_model(tmp_path):
    model, basis = loaded(EVERYTHING, tmp_path), design.strain_basis(EVERYTHING, 0)
    xi = np.random.default_rng(0).normal(size=len(basis.names))
    q = basis.matrix @ xi
    q = q[[basis.joints.index(name) for name in model.joint_names]]
    error = StrainTask(basis).evaluate(model.state(q, 2 * q), Target(np.zeros(len(xi))))
    assert error.error == pytest.approx(xi)
    assert error.rate == pytest.approx(2 * xi)


def test_axes_select_rows_and_a_target_is_found_by_name():
    model = softdyn.load("finger")
    state = model.state(np.full(4, 0.2), np.ones(4))
    whole, part = PointTask("tip", name="end"), PointTask("tip", name="end", axes=(2, 0))
    there = StackedReference({"other": SetPoint([9, 9, 9]), "end": SetPoint([0.1, 0.2, 0.3])})
    for whole_part, own in zip(whole(state, there), part(state, there), strict=True):
        assert np.array_equal(whole_part[[2, 0]], own)
    assert np.array_equal(whole(state, SetPoint([0.1, 0.2, 0.3])).error, whole(state, there).error)
    level = AxisTask("tip", [0, 0, 2])
    assert np.isfinite(level(state, there).error).all()  # its own target
    assert level.target.y == pytest.approx([0, 0, 1])


FINGER = softdyn.load("finger")
AT_REST = FINGER.state(FINGER.q0, np.zeros(4))
MISUSES = {
    "level": lambda: PointTask("tip", level=-1),
    "weight": lambda: PointTask("tip", weight=0),
    "weight of rows": lambda: PointTask("tip", weight=[1, -1, 1]),
    "Kp": lambda: PointTask("tip", Kp=0.0),
    "axes": lambda: PointTask("tip", axes=(0, 0)),
    "axes beyond": lambda: PointTask("tip", axes=(3,))(AT_REST, SetPoint([0, 0, 0])),
    "link": lambda: PointTask("tipp")(AT_REST, SetPoint([0, 0, 0])),
    "no link": lambda: PointTask(3),
    "point": lambda: PointTask("tip", [0, 0]),
    "axis": lambda: AxisTask("tip", [0, 0, 0]),
    "arcs": lambda: ShapeTask([])(AT_REST, Target([[0, 0, 0]])),
    "arcs beyond": lambda: ShapeTask([9.0])(AT_REST, StackedReference(
        {"shape": Target([[0, 0, 0]]), "tip": SetPoint([0, 0, 0])})),
    "joint": lambda: JointTask(["joint9"]).evaluate(AT_REST, Target([0.0])),
    "basis": lambda: StrainTask("pcc"),
    "kind of target": lambda: OrientationTask("tip").evaluate(AT_REST, SetPoint([0, 0, 0])),
    "no target": lambda: OrientationTask("tip")(AT_REST, SetPoint([0, 0, 0])),
    "no unit vector": lambda: AxisTask("tip", [1, 0, 0]).evaluate(AT_REST, Target([1, 1, 0])),
    "own target": lambda: PointTask("tip", target=[0, 0, 0]),
}  # fmt: skip


@pytest.mark.parametrize("misuse", MISUSES)
def test_every_misuse_is_one_line(misuse):
    with pytest.raises(InputError) as caught:
        MISUSES[misuse]()
    assert "expected" in str(caught.value)
    assert "\n" not in str(caught.value)
