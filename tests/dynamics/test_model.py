"""Interior identities of the dynamics, by central differences; loading; hostile arguments."""

from __future__ import annotations

import pickle
from copy import deepcopy

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel, UrdfError
from tests.support.arms import PROJECTIONS
from tests.support.named_models import named_model
from tests.support.oracles import gradient, rate, relative
from tests.support.refused import refused
from tests.support.robots import GRIPPER, build, hinge, joint, link, robot, write

BUNDLED = ("finger", "helix", "spirob", "spirob48")
BAR = 1e-7


FLOATING = "walker", "walking gripper"


@pytest.fixture(params=[*BUNDLED, *range(12), *FLOATING, *PROJECTIONS], ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def random_state(model: SoftModel, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A configuration well inside the limits."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    q = model.configuration(rng.uniform(low, high))
    return q, rng.normal(size=model.nv)


def step_of(model: SoftModel) -> float:
    """Difference step; short strokes of prismatic joints need a smaller one."""
    return 1e-3 if np.all(model.upper - model.lower > 0.05) else 2e-4


def test_mass_matrix_is_symmetric_and_positive(model):
    M = model.state(*random_state(model)).M
    assert relative(M, M.T) < 1e-14
    assert np.linalg.eigvalsh(M)[0] > 0


def test_mass_matrix_rate_minus_twice_coriolis_is_skew(model):
    q, v = random_state(model)
    S = rate(model, lambda x: model.state(x, v).M, q, v, step_of(model)) - 2 * model.state(q, v).C
    scale = np.abs(S).max()
    assert relative(S, -S.T, scale) <= BAR


def test_bias_is_coriolis_and_gravity(model):
    q, v = random_state(model)
    s = model.state(q, v)
    assert relative(s.bias, s.C @ v + s.g) < 1e-12
    assert relative(s.h, s.C @ v + s.D @ v + s.K + s.g) < 1e-12


def test_gravity_is_the_gradient_of_its_energy(model):
    q, v = random_state(model)
    g = model.state(q, v).g
    assert relative(gradient(model, model.gravity_energy, q), g) <= BAR


def test_spring_force_is_the_gradient_of_its_energy(model):
    q, v = random_state(model)
    K = model.state(q, v).K
    assert relative(gradient(model, model.elastic_energy, q), K, 1e-6) <= BAR


def test_tangent_stiffness_is_the_gradient_of_the_spring_force(model):
    q, v = random_state(model)
    expected = gradient(model, lambda x: model.state(x, v).K, q, step_of(model))
    assert relative(expected, model.tangent_stiffness(q), 1e-6) <= BAR


def test_jacobian_is_the_gradient_of_the_tip(model):
    q, v = random_state(model)
    s = model.state(q, v)
    assert relative(gradient(model, lambda x: model.state(x, v).y, q), s.J) <= BAR
    assert relative(s.J @ v, s.ydot) < 1e-14


def test_jacobian_rate(model):
    q, v = random_state(model)
    expected = rate(model, lambda x: model.state(x, v).J, q, v)
    s = model.state(q, v)
    assert relative(expected, s.Jdot, np.abs(s.J).max()) <= BAR  # J̇ = 0 where the tip slides


def test_input_matrix_is_gear_times_the_gradient_of_length(model):
    q, v = random_state(model)
    lengths = gradient(model, model.tendon_lengths, q, step_of(model))
    names = [tendon.name for tendon in model.robot.tendons]
    B = np.zeros((model.nv, model.nu))
    for i, actuator in enumerate(model.robot.actuators):
        B[:, i] = actuator.gear * lengths[names.index(actuator.tendon)]
    assert relative(B, model.state(q, v).B, 1e-6) <= BAR
    assert relative(model.tendon_lengths(q), model.state(q, v).lengths) < 1e-14


def test_tendon_hessian_is_the_gradient_of_the_moment_arms(model):
    q, _ = random_state(model)
    expected = gradient(model, model.tendon_moment_arms, q, step_of(model))
    assert relative(expected, model.tendon_hessians(q), 1e-6) <= BAR


def test_forward_dynamics_solves_the_equation_of_motion(model):
    q, v = random_state(model)
    u = np.random.default_rng(1).uniform(model.u_min, model.u_max)
    s = model.state(q, v)
    qdd = model.forward_dynamics(q, v, u)
    scale = np.abs(s.M).max() * np.abs(qdd).max()
    assert relative(s.M @ qdd + s.h, s.B @ u, scale) < 1e-11


def test_power_balance(model):
    """Ė = q̇ᵀ B u - q̇ᵀ D q̇ along the motion, the energy's rate by central differences in time."""
    q, v = random_state(model)
    u = np.random.default_rng(2).uniform(model.u_min, model.u_max)
    s = model.state(q, v)
    qdd = model.forward_dynamics(q, v, u)
    h = min(1e-4, 1e-2 / (1 + np.abs(qdd).max()))  # shorter, the energies differ by rounding

    def energy(t: float) -> float:
        at = model.integrate(q, t * v + t * t / 2 * qdd)
        return model.kinetic_energy(at, v + t * qdd) + model.potential_energy(at)

    slope = (
        4 * (energy(h) - energy(-h)) / (2 * h) - (energy(2 * h) - energy(-2 * h)) / (4 * h)
    ) / 3
    power = v @ (s.B @ u) - v @ s.D @ v
    scale = max(abs(v @ (s.B @ u)), abs(v @ s.D @ v), abs(v @ (s.M @ qdd)), abs(v @ s.h))
    assert abs(slope - power) / scale <= BAR


def test_coordinates_invert_configuration(model):
    q, _ = random_state(model)
    assert relative(model.configuration(model.coordinates(q)), q) < 1e-14


def test_states_are_read_only_and_independent(model):
    q, v = random_state(model)
    s = model.state(q, v)
    copies = {name: getattr(s, name).copy() for name in ("M", "h", "J", "B", "y", "C", "g")}
    for name in copies:
        with pytest.raises(ValueError, match="read-only"):
            getattr(s, name)[...] = 0.0
    with pytest.raises(AttributeError):
        s.M = np.eye(model.nv)
    model.state(*random_state(model, 1))
    for name, copy in copies.items():
        assert np.array_equal(getattr(s, name), copy)
    assert np.array_equal(model.state(q, v).C, copies["C"])


@pytest.mark.parametrize("copied", [lambda m: pickle.loads(pickle.dumps(m)), deepcopy])
def test_a_copy_of_a_model_has_an_engine_of_its_own(tmp_path, copied):
    for model in (softdyn.load("spirob"), softdyn.load(write(tmp_path, GRIPPER))):
        other, v = copied(model), np.full(model.nv, 0.3)
        q = model.integrate(model.q0, v)
        apart = other.state(q, v)
        state = model.state(q, v)
        model.state(model.q0, 0 * v)
        assert other.bundled == model.bundled
        for name in ("M", "J", "Jdot", "h", "B", "y"):
            np.testing.assert_array_equal(getattr(apart, name), getattr(state, name))
        np.testing.assert_array_equal(other.state(q, v).M, state.M)


def test_arguments_may_be_lists_and_are_copied():
    model = softdyn.load("finger")
    q = np.full(4, 0.1)
    s = model.state(q, [0, 0, 0, 0])
    q[:] = 9.0
    assert s.q[0] == 0.1


@pytest.mark.parametrize(
    "bad", [[0.0], np.zeros((4, 1)), [np.nan, 0, 0, 0], [np.inf, 0, 0, 0], "abcd", None, [[1], 2]]
)
@pytest.mark.parametrize("argument", ["q", "v"])
def test_bad_states_are_refused(bad, argument):
    model = softdyn.load("finger")
    arguments = {"q": np.zeros(4), "v": np.zeros(4)} | {argument: bad}
    with refused(argument):
        model.state(**arguments)


def test_huge_finite_states_do_not_raise():
    model = softdyn.load("finger")
    with np.errstate(all="ignore"):
        model.state(np.full(4, 1e200), np.full(4, 1e200))


def test_a_copy_of_a_bundled_file_is_not_bundled(tmp_path):
    path = softdyn.load("finger").robot.path
    copy = tmp_path / "finger.urdf"
    copy.write_bytes(path.read_bytes())
    assert softdyn.load("finger").bundled == softdyn.load(path).bundled == "finger"
    assert softdyn.load(copy).bundled is None
    assert softdyn.load(copy).name == softdyn.load("finger").name


def one(kind: str, axis: str) -> SoftModel:
    return build(hinge(1, "0.1 0 0", 0, kind=kind, axis=axis))


def test_one_degree_of_freedom():
    """A point mass on a weightless rod: M = m r², g = m g r cos q, by hand."""
    model = one("continuous", "0 -3 0")
    assert (model.nq, model.nv, model.nu) == (2, 1, 0)
    q = model.configuration([0.3])
    s = model.state(q, [2.0])
    assert s.M[0, 0] == pytest.approx(0.01)
    assert s.g == pytest.approx([0.1 * 9.81 * np.cos(0.3)])
    assert s.B.shape == (1, 0)
    assert s.J.shape == s.Jdot.shape == (3, 1)
    assert model.coordinates(model.integrate(q, np.array([np.pi]))) == pytest.approx([0.3 - np.pi])


def test_a_singular_mass_matrix_is_refused():
    with refused("<robot>", "a singular one; joint 'hinge' meets the least inertia", by=UrdfError):
        one("revolute", "1 0 0")


def test_how_singular_a_mass_matrix_may_be():
    """Two joints on one axis, M = [[x + 1, 1], [1, 1]]: scaled, its least eigenvalue is x/4."""

    def coaxial(moment: float) -> SoftModel:
        return build(robot(
            "coaxial", link("base"), link("a", 1, None, moment), link("b", 1, None, 1),
            joint("i", "base", "a", "0 0 1", "continuous"),
            joint("j", "a", "b", "0 0 1", "continuous"),
        ))  # fmt: skip

    assert coaxial(1.6e-13).nv == 2
    with refused("<robot>", "a singular one; joint 'j' meets the least inertia", by=UrdfError):
        coaxial(1e-14)


def test_a_robot_without_moving_joints_is_refused():
    with refused("<robot>", "none", by=UrdfError):
        build(robot("r", link("a")))
