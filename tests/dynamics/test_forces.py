"""Forces of one's own: everywhere in the model, against sums and solvers written here."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import softdyn
from softdyn import ForceError, InputError, SoftModel, statics
from softdyn.controllers import Impedance, SoftIdClfQp, best
from softdyn.controllers.qps.horizon import Horizon
from softdyn.dynamics import (
    ForceBalance,
    Wrench,
    acceleration_derivatives,
    discrete_step,
    gravity_stiffness,
    step_implicit,
)
from softdyn.estimation import Ekf
from softdyn.identification.trajectory import Start, follow
from softdyn.sensing import Sensor, SensorKind
from softdyn.statics.zero_dynamics import examine
from tests.support.arms import PROJECTIONS
from tests.support.named_models import named_model
from tests.support.oracles import gradient, relative, slopes

ROBOTS = ("finger", "helix", "spirob48", "walker", "walking gripper", *PROJECTIONS)


class Toy:
    """A cubic spring and a drag, which grows with the position."""

    name = "toy"

    def __init__(self, spring: float = 0.2, drag: float = 0.1) -> None:
        self.spring, self.drag = spring, drag

    def __call__(self, model, q, v):
        at = model.coordinates(q)
        return -self.spring * at**3 - self.drag * (1 + at**2) * v


class ExactToy(Toy):
    """The same with its derivatives, for a robot whose coordinates are its q."""

    name = "exact"

    def derivatives(self, model, q, v):
        by_q = -3 * self.spring * q**2 - 2 * self.drag * q * v
        return np.diag(by_q), np.diag(-self.drag * (1 + q**2))

    def energy(self, model, q):
        return self.spring * np.sum(q**4) / 4


class Drag:
    """A drag on each link by its velocity, in ten lines."""

    name = "drag"

    def __init__(self, coefficient: float = 0.1) -> None:
        self.coefficient = coefficient

    def __call__(self, model, q, v):
        jacobians = [model.link_jacobian(q, link.name) for link in model.robot.links]
        return -self.coefficient * sum(J[:3].T @ (J[:3] @ v) for J in jacobians)


class Turning:
    """A force without a potential."""

    name = "turning"

    def __call__(self, model, q, v):
        skew = np.triu(np.ones((model.nv, model.nv)), 1)
        return 0.01 * (skew - skew.T) @ q


@pytest.fixture(params=ROBOTS, ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def random_state(model: SoftModel, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low, high = np.maximum(model.lower, -0.5), np.minimum(model.upper, 0.5)
    u = rng.uniform(np.maximum(model.u_min, -1), np.minimum(model.u_max, 1))
    return model.configuration(rng.uniform(low, high)), rng.normal(size=model.nv), u


def expected(model: SoftModel, force, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The force by its definition: on the tree's joints, projected."""
    if isinstance(model, softdyn.dynamics.tree.TreeModel):
        return force(model, q, v)
    return model.S.T @ force(model.tree, model.expand(q), model.S @ v)


@pytest.mark.parametrize("force", [Toy(), Drag()], ids=["toy", "drag"])
def test_it_acts_in_state_balance_and_accelerations(model, force):
    wet, (q, v, u) = model.with_forces(force), random_state(model)
    dry, found, F = model.state(q, v), wet.state(q, v), expected(model, force, q, v)
    assert np.abs(F).max() > 1e-4
    assert relative(found.F, F) < 1e-13
    assert relative(found.h, dry.h - F) < 1e-12
    assert (dry.F == 0).all()
    for name in ("M", "K", "D", "bias", "B", "J", "Jdot"):
        assert (getattr(found, name) == getattr(dry, name)).all()
    qdd = wet.forward_dynamics(q, v, u)
    size = np.abs(found.B @ u).max() + np.abs(found.h).max()
    assert np.abs(found.M @ qdd - found.B @ u + found.h).max() < 1e-9 * size
    assert np.abs(ForceBalance(wet, motors=())(q, v, qdd, u).residual).max() < 1e-9 * size


@pytest.mark.parametrize("force", [Toy(), Drag()], ids=["toy", "drag"])
def test_derivatives_contain_it(model, force):
    wet, (q, v, u) = model.with_forces(force), random_state(model, 1)
    found = acceleration_derivatives(wet, q, v, u)
    by_q = gradient(wet, lambda x: wet.forward_dynamics(x, v, u), q, 1e-4)
    by_v = slopes(lambda x: wet.forward_dynamics(q, v + x, u), wet.nv, 1e-3)
    assert relative(found.q, by_q) < 1e-6
    assert relative(found.v, by_v) < 1e-6
    assert relative(found.q, acceleration_derivatives(model, q, v, u).q) > 1e-6


def test_differences_are_the_exact_derivatives():
    finger = softdyn.load("finger")
    q, v, _ = random_state(finger)
    exact, default = (finger.with_forces(one) for one in (ExactToy(), Toy()))
    for one, other in zip(exact.force_derivatives(q, v), default.force_derivatives(q, v),
                          strict=True):  # fmt: skip
        assert relative(one, other) < 1e-9


@pytest.mark.parametrize("name", ["finger", "spirob"])
@pytest.mark.parametrize("force", [Toy(), ExactToy(), Turning()], ids=lambda one: one.name)
def test_settle_finds_the_root_that_another_solver_finds(name, force):
    model = softdyn.load(name)
    u, still = np.linspace(0.05, 0.15, model.nu) * model.u_max, np.zeros(model.nv)

    def unbalanced(q):
        state = model.state(q, still)
        return state.K + state.g - state.B @ u - force(model, q, still)

    found = statics.settle(model.with_forces(force), u)
    assert not found.held.any()
    root = fsolve(unbalanced, found.q + 0.01, xtol=1e-13)
    assert relative(found.q, root) < 1e-6
    assert relative(found.q, statics.settle(model, u).q) > 1e-3
    assert found.stable
    assert found.poles[0].real < 0
    again = statics.balance(model.with_forces(force), u, found.q)
    assert relative(again.q, root) < 1e-6


def test_inputs_for_the_tip_hold_it_against_the_force():
    finger = softdyn.load("finger")
    y = statics.settle(finger, 0.2 * finger.u_max).y
    wet = finger.with_forces(Wrench("tip", force=[0, 0, -0.05]))
    found = statics.inputs_for_tip(wet, y).nearest
    np.testing.assert_allclose(found.y, y, atol=1e-6)
    # the same wrench in the balance as a disturbance at the tip
    balance = ForceBalance(finger, (softdyn.dynamics.Disturbance.TIP_FORCE,), motors=())
    zero = np.zeros(finger.nv)
    r = balance(found.q, zero, zero, found.u, np.array([0, 0, -0.05])).residual
    assert np.abs(r - found.limit_forces).max() < 1e-8


def test_a_step_and_its_jacobians_contain_it():
    finger = softdyn.load("finger")
    wet, (q, v, u), T = finger.with_forces(Toy()), random_state(finger), 2e-3
    step = discrete_step(wet, q, v, u, T)
    a = (step.v - v) / T
    state = wet.state(step.q, step.v)
    np.testing.assert_allclose(state.M @ a + state.h, state.B @ u, atol=1e-7)

    def after(x):
        one = discrete_step(wet, q + x[:4], v + x[4:], u, T)
        return np.concatenate((one.q, one.v))

    assert relative(step.A, slopes(after, 8, 1e-5)) < 1e-5


def test_a_stiff_drag_does_not_blow_up_the_semi_implicit_step():
    """-0.1 v on the finger, applied explicitly, is 1e4 rad/s after a dozen steps of 0.5 ms."""
    wet = softdyn.load("finger").with_forces(Toy(spring=0.0, drag=0.1))
    q, v, u = wet.q0, np.zeros(4), 0.2 * wet.u_max
    for _ in range(100):
        q, v = step_implicit(wet, q, v, u, 5e-4)
    assert np.abs(v).max() < 10


def test_the_observer_predicts_with_it():
    """The motion of the robot with the force, seen by its lengths and tip without noise."""
    finger = softdyn.load("finger")
    wet, u, period = finger.with_forces(Toy(0.5, 0.05)), 0.3 * finger.u_max, 0.005
    sensors = [
        Sensor(one.name, SensorKind.LENGTH, tendon=one.name, noise=(1e-3,))
        for one in finger.robot.tendons
    ]
    errors = []
    for known in (wet, finger):
        ekf, q, v = Ekf(known, sensors), wet.q0, np.zeros(4)
        total = 0.0
        for k in range(100):
            found = ekf.step(k * period, wet.tendon_lengths(q), u)
            total += float(np.square(found.q - q).sum())
            step = discrete_step(wet, q, v, u, period)
            q, v = step.q, step.v
        errors.append(np.sqrt(total / 100))
    assert errors[0] < 0.1 * errors[1]


def test_identification_follows_the_motion_with_it():
    finger = softdyn.load("finger")
    wet, t = finger.with_forces(Toy()), np.arange(20) * 0.005
    u = np.tile(0.2 * finger.u_max, (20, 1))
    none = np.zeros((4, 0))
    path, _ = follow(wet, (), t, u, Start(np.zeros(4), np.zeros(4), none, none))

    def rates(_, x):
        state = finger.state(x[:4], x[4:])
        force = state.B @ u[0] - state.h + Toy()(finger, state.q, state.v)
        return np.concatenate((x[4:], np.linalg.solve(state.M, force)))

    x = solve_ivp(rates, (0, t[-1]), np.zeros(8), "Radau", rtol=1e-8, atol=1e-10).y[:, -1]
    q = x[:4]
    assert relative(path[-1], q) < 1e-5
    without, _ = follow(finger, (), t, u, Start(np.zeros(4), np.zeros(4), none, none))
    assert relative(without[-1], q) > 1e-2


@pytest.mark.parametrize("controller", [Impedance, SoftIdClfQp])
def test_controllers_see_it_in_h(controller):
    helix = softdyn.load("helix")
    wet, (q, v, _) = helix.with_forces(Turning()), random_state(helix)
    dry, more = helix.state(q, 0.01 * v), {}
    if controller is SoftIdClfQp:
        more["horizon"] = 0.0
    goal = softdyn.SetPoint(dry.y + 0.01)
    own = controller(helix, **more)(replace(dry, h=dry.h - Turning()(helix, q, v)), goal)
    found = controller(wet, **more)(wet.state(q, 0.01 * v), goal)
    np.testing.assert_allclose(found.u, own.u, rtol=1e-9, atol=1e-9)
    assert np.abs(found.u - controller(helix, **more)(dry, goal).u).max() > 1e-6


def test_the_horizon_of_the_hold_has_its_derivatives():
    finger, tau = softdyn.load("finger"), 0.02
    wet, (q, v, _) = finger.with_forces(ExactToy()), random_state(finger)
    state, (by_q, by_v) = wet.state(q, v), ExactToy().derivatives(finger, q, v)
    stiffness = finger.tangent_stiffness(q) - by_q
    M, h = Horizon(wet, tau)(state)
    np.testing.assert_allclose(M, state.M + tau * (state.D - by_v) + tau**2 * stiffness, rtol=1e-12)
    np.testing.assert_allclose(h, state.h + tau * stiffness @ v, rtol=1e-12)


def test_directions_without_an_input_have_its_stiffness():
    finger = softdyn.load("finger")
    at = random_state(finger)[0]
    dry, wet = examine(finger, at), examine(finger.with_forces(ExactToy()), at)
    own = 3 * 0.2 * np.diag(at**2)
    U = dry.unactuated
    whole = finger.tangent_stiffness(at) + gravity_stiffness(finger, at) + own
    np.testing.assert_allclose(wet.stiffness, np.linalg.eigvalsh(U @ whole @ U.T), rtol=1e-8)
    assert np.abs(wet.stiffness - dry.stiffness).max() > 1e-3


def test_best_holds_the_tip_against_it():
    """The plant is the model with the forces, in steps of backward Euler."""
    finger, period = softdyn.load("finger"), 0.005
    wet = finger.with_forces(ExactToy(spring=0.1, drag=0.01), Wrench("tip", [0, 0, -0.05]))
    goal = softdyn.SetPoint(statics.settle(wet, np.array([0.05, 0.1]) * wet.u_max).y)
    controller, q, v = best(wet), wet.q0, np.zeros(4)
    controller.waits = True
    controller.reset(period)
    for _ in range(300):
        command = controller(wet.state(q, v), goal)
        step = discrete_step(wet, q, v, command.u, period)
        q, v = step.q, step.v
    assert np.linalg.norm(wet.state(q, v).y - goal.y) < 1e-3
    assert controller.guard.fallbacks == 0


def test_both_ways_to_a_state_have_it(model):
    tree = getattr(model, "tree", model).with_forces(Toy())
    q, v, _ = random_state(tree)
    state = tree.state(q, v)
    other = tree._in_numpy(state.q.copy(), tree.about_base(state.q), state.v, tree._scratch)
    assert (other.F == state.F).all()
    assert relative(other.h, state.h) < 1e-12


def test_a_model_tells_its_forces():
    assert "toy, drag" in str(softdyn.load("finger", forces=[Toy(), Drag()]))


def test_copies_pickles_and_digests(model):
    wet = model.with_forces(Toy())
    other, stiffer = model.with_forces(Toy()), model.with_forces(Toy(spring=0.3))
    digests = [one.robot.digest for one in (wet, other, stiffer, model, wet.with_forces(Drag()))]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 4
    q, v, _ = random_state(model)
    for twin in (pickle.loads(pickle.dumps(wet)), copy.deepcopy(wet)):
        assert twin.robot.digest == wet.robot.digest
        assert (twin.state(q, v).h == wet.state(q, v).h).all()
    assert (pickle.loads(pickle.dumps(wet.state(q, v))).F == wet.state(q, v).F).all()
    assert not model.forces


def test_a_digest_contains_what_the_class_states():
    class Law(Toy):
        factor = 1.0

    finger = softdyn.load("finger")
    before = finger.with_forces(Law()).robot.digest
    assert finger.with_forces(Law()).robot.digest == before
    Law.factor = 2.0
    assert finger.with_forces(Law()).robot.digest != before


def test_a_model_keeps_copies_of_its_forces():
    force = Toy()
    wet = softdyn.load("finger", forces=[force])
    q, v, _ = random_state(wet)
    before = wet.state(q, v).F
    force.spring = 5.0
    np.testing.assert_array_equal(wet.state(q, v).F, before)


def test_the_energy_of_forces_is_potential_energy():
    finger = softdyn.load("finger")
    wet, (q, _, _) = (
        finger.with_forces(ExactToy(), Drag(), Wrench("tip", [0, 1, 2])),
        random_state(finger),
    )
    still = np.zeros(4)
    own = [one for one in wet.forces if one.name != "drag"]
    slope = gradient(wet, lambda x: wet.potential_energy(x) - finger.potential_energy(x), q)
    assert relative(-slope, sum(one(finger, q, still) for one in own)) < 1e-9


class Bad:
    name = "bad"

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __call__(self, model, q, v):
        if self.kind == "raises":
            raise KeyError("no such link")
        if self.kind == "writes":
            v[0] = 1.0
        if self.kind == "keeps":
            self.q = q
        return {"shape": v[1:], "not finite": v + np.nan, "text": "drag"}.get(self.kind, -v)

    def derivatives(self, model, q, v):
        return np.zeros((2, 2)) if self.kind == "derivatives" else None


@pytest.mark.parametrize("kind", ["raises", "writes", "keeps", "shape", "not finite", "text"])
def test_a_force_that_breaks_its_contract_is_refused(kind):
    wet = softdyn.load("finger").with_forces(Bad(kind))
    q, v, u = random_state(wet)
    calls = (lambda: wet.state(q, v), lambda: wet.forward_dynamics(q, v, u))
    for call in (*calls, lambda: ForceBalance(wet)(q, v, v, u)):
        with pytest.raises(ForceError) as caught:
            call()
        assert (caught.value.kind, caught.value.method) == ("Bad", "__call__")
        assert caught.value.q == tuple(q)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)


@pytest.mark.parametrize("kind", ["derivatives", "fine"])
def test_derivatives_of_another_kind_are_refused(kind):
    wet = softdyn.load("finger").with_forces(Bad(kind))
    with pytest.raises(ForceError) as caught:
        wet.force_derivatives(wet.q0, np.zeros(4))
    assert caught.value.method == "derivatives"


@pytest.mark.parametrize("forces", [Toy, [Toy], [Toy(), Toy()], [object()], ["toy"], [np.sin]])
def test_what_is_no_force_is_refused(forces):
    with pytest.raises(InputError):
        softdyn.load("finger", forces=forces)


def test_the_jacobian_of_a_link_is_that_of_its_pose(model):
    q, v, _ = random_state(model)
    for link in model.robot.links[1::3]:
        J = model.link_jacobian(q, link.name)
        place = model.link_poses(q)[link.name]
        by_q = gradient(model, lambda x, name=link.name: model.link_poses(x)[name], q)
        spin = np.einsum("ijk,lj->ilk", by_q[:3, :3], place[:3, :3])
        turning = np.stack((spin[2, 1], spin[0, 2], spin[1, 0]))
        assert relative(J[:3], by_q[:3, 3], 0.1) < 1e-9
        assert relative(J[3:], turning, 1.0) < 1e-9
        np.testing.assert_allclose(model.link_velocity(q, v, link.name), J @ v, atol=1e-14)
    with pytest.raises(InputError):
        model.link_jacobian(q, "no such link")


class NoSlope(Toy):
    """Its derivatives fail beyond a speed."""

    def derivatives(self, model, q, v):
        if np.abs(v).max() > 1.0:
            raise ArithmeticError("too fast")
        return np.zeros((model.nv, model.nv)), -self.drag * np.eye(model.nv)


def test_a_control_step_falls_back_where_a_force_fails():
    finger = softdyn.load("finger").with_forces(NoSlope())
    controller = SoftIdClfQp(finger, horizon=0.01)
    goal = softdyn.SetPoint(finger.state(finger.q0, np.zeros(4)).y)
    slow, fast = (finger.state(np.full(4, 0.1), np.full(4, speed)) for speed in (0.1, 2.0))
    good = controller(slow, goal)
    assert good.status.value == "ok"
    held = controller(fast, goal)
    assert (held.u == good.u).all()
    assert held.status.value != "ok"
    assert controller.guard.fallbacks == 1
