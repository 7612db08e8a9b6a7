"""Floating bases: the convention map, Newton and Euler, and the twin."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import softdyn
from softdyn import SoftModel, UrdfError
from softdyn.dynamics import derivatives
from softdyn.validation import StateMap, Twin, crosscheck, simulate
from softdyn.validation.crosschecks.crosscheck import random_state
from softdyn.validation.twin import free_base
from softdyn.validation.twin.free_base import FreeBase, rk4_on_rotations
from tests.support.refused import refused
from tests.support.robots import GRIPPER, WALKER, link, load, oblique, robot, solids, write

ALONE = robot("brick", solids("brick"))


@pytest.fixture(params=[WALKER, GRIPPER], ids=["walker", "gripper"])
def pair(request, tmp_path: Path) -> tuple[SoftModel, Twin, StateMap]:
    model = load(tmp_path, request.param, floating=True)
    twin = Twin(model, limits=False)
    return model, twin, StateMap(model, twin)


def skew(x: np.ndarray) -> np.ndarray:
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def test_layout(pair):
    model, twin, _ = pair
    assert model.robot.floating
    assert twin.floating
    assert model.joint_names[:6] == (
        "base_vx", "base_vy", "base_vz", "base_wx", "base_wy", "base_wz"
    )  # fmt: skip
    np.testing.assert_array_equal(model.q0[:7], [0, 0, 0, 0, 0, 0, 1])  # x, y, z, w
    np.testing.assert_array_equal(twin.qpos[:7], [0, 0, 0, 1, 0, 0, 0])  # w, x, y, z
    assert not model.stiffness[:6].any()
    assert not model.damping[:6].any()
    assert np.isinf(model.lower[:6]).all()
    assert np.isinf(model.upper[:6]).all()
    assert model.bundled is None


def test_a_joint_with_a_name_of_the_base_gives_it_nothing(tmp_path):
    """Its springs, dampers, limits and armature act on the joint, in both engines."""
    import xml.etree.ElementTree as ElementTree

    plain = load(tmp_path, WALKER, floating=True)
    tree = ElementTree.fromstring(WALKER)
    names = [j.get("name") for j in tree.iter("joint") if j.get("type") not in (None, "fixed")]
    renamed = WALKER
    for old, new in zip(names, ("base_wz", "base_vx", "base_wx"), strict=False):
        renamed = renamed.replace(f'"{old}"', f'"{new}"')
    assert renamed != WALKER
    model = load(tmp_path, renamed, floating=True)
    for field in ("stiffness", "rest", "damping", "armature", "lower", "upper"):
        np.testing.assert_array_equal(getattr(model, field), getattr(plain, field))
    assert np.isinf(model.lower[:6]).all()
    q, v = random_state(plain, np.random.default_rng(3))
    for term in ("M", "h", "B", "K", "D"):
        np.testing.assert_array_equal(
            getattr(model.state(q, v), term), getattr(plain.state(q, v), term)
        )
    result = crosscheck(model, samples=2)
    assert result.passed, [(c.quantity, c.max_error, c.reason) for c in result.checks]


@pytest.mark.parametrize("names", [("base_vx", "base_wz"), ("base_wy", "base_vx")])
def test_a_follower_with_a_name_of_the_base_is_no_base(names, tmp_path):
    """Neither is its leader; the same robot with other names, and the twin, behave alike."""
    text = GRIPPER
    for old, new in zip(("b_slide", "a_lead"), names, strict=True):
        text = text.replace(f'"{old}"', f'"{new}"')
    plain = load(tmp_path, GRIPPER, floating=True)
    model = load(tmp_path, text, floating=True)
    assert model.nv == plain.nv
    assert model.joint_names[:6] == plain.joint_names[:6]
    # Pinocchio orders joints by their names, behind the base
    where = dict(zip(names[::-1], ("a_lead", "b_slide"), strict=True))
    own = [where.get(name, name) for name in model.joint_names[6:]]
    order = [*range(6), *(6 + plain.joint_names[6:].index(name) for name in own)]
    rng = np.random.default_rng(5)
    values, v = rng.uniform(-0.5, 0.5, (2, plain.nv))
    ours = model.state(model.configuration(values[order]), v[order])
    theirs = plain.state(plain.configuration(values), v)
    np.testing.assert_allclose(ours.M, theirs.M[np.ix_(order, order)], atol=1e-12)
    np.testing.assert_allclose(ours.h, theirs.h[order], atol=1e-12)
    StateMap(model, Twin(model))


def test_the_base_s_own_joint_has_a_name_that_no_other_may_have(tmp_path):
    text = WALKER.replace('"ja"', '"floating base"')
    with refused('<joint name="floating base">', "floating base", by=UrdfError):
        load(tmp_path, text, floating=True)
    model = softdyn.load(write(tmp_path, text))
    StateMap(model, Twin(model))


def test_there_and_back(pair):
    model, _, states = pair
    for seed in range(5):
        q, v = random_state(model, np.random.default_rng(seed))
        back = states.from_twin(*states.to_twin(q, v))
        np.testing.assert_allclose(back[0], q, atol=1e-14)
        np.testing.assert_allclose(back[1], v, atol=1e-14)
        np.testing.assert_allclose(model.configuration(model.coordinates(q)), q, atol=1e-13)


def test_velocities_are_those_of_the_same_motion(pair):
    """The difference of two poses moved by Pinocchio is P v in MuJoCo; the rate of P is Ṗ."""
    model, twin, states = pair
    q, v = random_state(model, np.random.default_rng(1))
    qpos, qvel = states.to_twin(q, v)
    h = 1e-5
    ahead, behind = (states.to_twin(model.integrate(q, s * h * v), v)[0] for s in (1, -1))
    moved = np.empty(twin.model.nv)
    mujoco.mj_differentiatePos(twin.model, moved, 2 * h, behind, ahead)
    np.testing.assert_allclose(moved, qvel, atol=1e-8)
    rate = (states.velocity_map(ahead) - states.velocity_map(behind)) / (2 * h)
    np.testing.assert_allclose(rate, states.velocity_map_rate(qpos, qvel), atol=1e-8)


def test_one_body_obeys_newton_and_euler(tmp_path):
    """In the base's axes: m (a + ω×v + ω̇×c + ω×(ω×c)) = m g, and its moment about the origin."""
    model = load(tmp_path, ALONE, floating=True)
    body = model.robot.links[0].inertia
    m, c = body.mass, body.com
    I = body.tensor + m * (c @ c * np.eye(3) - np.outer(c, c))  # noqa: E741
    q, v = random_state(model, np.random.default_rng(2))
    q[:3] = 0.3, -0.2, 0.7
    w, x = v[3:], v[:3]
    state = model.state(q, v)
    M = np.block([[m * np.eye(3), -m * skew(c)], [m * skew(c), I]])
    np.testing.assert_allclose(state.M, M, atol=1e-14)
    rotation = FreeBase(model).from_velocity(q, np.eye(6)[0])
    assert np.linalg.norm(rotation) == pytest.approx(1.0)
    R = np.column_stack([FreeBase(model).from_velocity(q, axis)[:3] for axis in np.eye(6)[:3]])
    down = R.T @ [0, 0, -9.81]
    turning = np.cross(w, x)
    force = m * (turning + np.cross(w, np.cross(w, c)) - down)
    moment = m * np.cross(c, turning - down) + np.cross(w, I @ w)
    np.testing.assert_allclose(state.bias, np.concatenate((force, moment)), atol=1e-13)
    np.testing.assert_allclose(state.y, q[:3], atol=1e-15)
    np.testing.assert_allclose(state.ydot, R @ x, atol=1e-14)


@pytest.mark.parametrize("text", [WALKER, GRIPPER], ids=["walker", "mimic"])
@pytest.mark.parametrize("compiled", [True, False])
def test_nothing_but_positions_depends_on_where_the_base_is(text, compiled, tmp_path):
    """The robot is at 0, 1 km and 1000 km; gravity is uniform, and rounding must not matter."""
    model = load(tmp_path, text, floating=True)
    tree = getattr(model, "tree", model)
    tree._assemble = tree._by_kernel if compiled else tree._in_numpy
    q, v = random_state(model, np.random.default_rng(4))
    u = np.linspace(0.1, 0.2, model.nu)
    weight = sum(link.inertia.mass for link in model.robot.links) * 9.81

    def terms(place):
        at = np.concatenate((place, q[3:]))
        state = model.state(at, v)
        names = ("M", "bias", "g", "K", "D", "B", "h", "J", "Jdot", "ydot", "lengths")
        found = {name: getattr(state, name) for name in names}
        found["C q̇"] = model.coriolis(at, v) @ v
        found["gravity"] = model.gravity(at)
        found["q̈"] = model.forward_dynamics(at, v, u)
        found["energies"] = [
            model.kinetic_energy(at, v),
            model.elastic_energy(at),
            model.gravity_energy(at) - weight * place[2],
        ]
        found["y"] = state.y - place
        found["arms"] = model.tendon_moment_arms(at)
        found["tendon lengths"] = model.tendon_lengths(at)
        if tree is model:
            found["curvature"] = model.tendon_hessians(at)
            by = derivatives.acceleration_derivatives(model, at, v, u)
            found |= {"∂q̈/∂q": by.q, "∂q̈/∂v": by.v}
            tangent = derivatives.tangent_dynamics(model, at, v, u)
            found["K_t"], found["D_t"] = tangent
            found["stiffness"] = derivatives.stiffness(model, at, u)
        found["links"] = [pose[:3, 3] - place for pose in model.link_poses(at).values()]
        return found

    near = terms(np.zeros(3))
    for distance in (1e3, 1e6):
        place = distance * np.array([0.6, -0.5, 0.7])
        for name, value in terms(place).items():
            # a number at this place has an absolute rounding of its own
            slack = distance * 1e-15 if name in ("y", "links") else 0.0
            slack = weight * distance * 1e-15 if name == "energies" else slack
            size = max(1.0, np.abs(near[name]).max())
            np.testing.assert_allclose(
                value, near[name], rtol=0, atol=4 * slack + 1e-14 * size, err_msg=name
            )


def test_the_twin_agrees(tmp_path):
    model = load(tmp_path, WALKER, floating=True)
    result = crosscheck(model, samples=4)
    assert result.passed, [(c.quantity, c.max_error, c.reason) for c in result.checks]
    assert {ladder.scheme for ladder in result.ladders} == {"implicit", "rk4"}


def test_a_body_alone_is_followed_by_rk4_only(tmp_path):
    """MuJoCo's implicitfast treats its gyroscopic force implicitly, and nothing else's."""
    model = load(tmp_path, ALONE, floating=True)
    result = crosscheck(model, samples=2)
    assert result.passed, [(c.quantity, c.max_error, c.reason) for c in result.checks]
    assert {run.scheme for run in result.runs} == {"rk4"}


def test_runge_kutta_on_rotations_has_order_four():
    """Compared with small steps, for a rotation about a turning axis."""

    def slope(q, w):
        return np.array([np.sin(w[1]), -w[0] * w[2], w[0] * w[1]])

    def move(q, turned):
        angle = np.linalg.norm(turned)
        axis = skew(turned / angle if angle else turned)
        return q @ (np.eye(3) + np.sin(angle) * axis + (1 - np.cos(angle)) * axis @ axis)

    def run(steps):
        q, w = np.eye(3), np.array([1.0, 2.0, -1.5])
        for _ in range(steps):
            q, w = rk4_on_rotations(q, w, 1.0 / steps, slope, move, slice(0, 3))
        return q

    errors = [np.abs(run(steps) - run(400)).max() for steps in (10, 20, 40)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4, atol=0.3)


@pytest.mark.parametrize("angle", [1e-12, 3e-3, 9.9e-3, 1.01e-2, 0.4, 2.8])
def test_the_rate_of_a_rotation_vector(angle):
    """Central differences of log(exp(θ) exp(ω t)), with SciPy's rotations."""
    random = np.random.default_rng(7)
    turned, angular = random.normal(size=(2, 3))
    turned *= angle / np.linalg.norm(turned)

    def vector(t):
        start, more = (Rotation.from_rotvec(x) for x in (turned, t * angular))
        return (start * more).as_rotvec()

    h = 1e-3
    slopes = [(vector(s * h) - vector(-s * h)) / (2 * s * h) for s in (1, 2)]
    expected = (4 * slopes[0] - slopes[1]) / 3
    np.testing.assert_allclose(free_base._rotation_vector_rate(turned, angular), expected,
                               atol=1e-9)  # fmt: skip


def test_closed_loops_run(tmp_path):
    """The plant falls in model and twin: ½ g t² for the centre of mass, for half a second."""
    model = load(tmp_path, WALKER, floating=True)

    class Rest:
        def __call__(self, state, reference):
            return type("Answer", (), {"u": np.zeros(model.nu)})

    log = simulate(model, Rest(), softdyn.SetPoint([0.0, 0.0, -0.5]), duration=0.3)
    assert len(log.q) == 151
    assert log.joint_names == model.joint_names
    energies = [
        model.kinetic_energy(log.q[k], log.v[k]) + model.potential_energy(log.q[k]) for k in (0, -1)
    ]
    assert energies[1] < energies[0]  # dampers, and nothing gained
    assert log.q[-1][2] == pytest.approx(-0.5 * 9.81 * 0.3**2, abs=0.1)


@pytest.mark.parametrize("floating", [False, True])
def test_a_twin_of_another_base_is_refused(floating, tmp_path):
    path = write(tmp_path, WALKER)
    model = softdyn.load(path, floating=floating)
    with refused("twin"):
        StateMap(model, Twin(softdyn.load(path, floating=not floating)))


def test_a_floating_base_without_mass_is_singular(tmp_path):
    """Its first joint and the base then turn the same bodies."""
    text = robot("x", link("b"), solids("a"), oblique("j", "continuous", "b", "a"))
    assert softdyn.load(write(tmp_path, text)).nv == 1
    with refused(
        "<robot>", "a singular one; joint 'base_vy' meets the least inertia", by=UrdfError
    ):
        load(tmp_path, text, floating=True)
    with refused("<robot>", "none", by=UrdfError):
        softdyn.load(write(tmp_path, robot("x", link("a"))), floating=True)
