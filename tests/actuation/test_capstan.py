"""Friction of cables on their guides: closed forms, derivatives, and the power that is lost."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import Robot, SoftModel
from softdyn.actuation import Capstan
from softdyn.description.robot import JointTerm, PathEnd, Site, Tendon, Wrap
from softdyn.description.urdf import parse_text
from tests.support.cable_chains import chain, pulled
from tests.support.misuses import ARM
from tests.support.oracles import gradient, relative, slopes
from tests.support.refused import refused
from tests.support.wrapped_robots import wrapped_robot


def planar(joints: int, length: float = 0.2) -> Robot:
    """A chain that turns about z."""
    return chain(np.tile([0.0, 0.0, 1.0], (joints, 1)), length / joints)


def pulled_model(robot: Robot, *tendons: Tendon) -> SoftModel:
    """A model with tendons that one input each pulls; the force along it is u."""
    return softdyn.build(pulled(robot, *tendons))


def rubbing(name: str, mu: float = 0.1, **changes: float) -> SoftModel:
    """A bundled robot whose cables rub."""
    robot = softdyn.load(name).robot
    tendons = (
        replace(t, friction=mu * (1 + k % 2), **changes) for k, t in enumerate(robot.tendons)
    )
    return softdyn.build(replace(robot, tendons=tuple(tendons)))


def random(model: SoftModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    lower, upper = np.maximum(model.lower, -0.5), np.minimum(model.upper, 0.5)
    u = rng.uniform(model.u_min, model.u_max)
    return model.configuration(rng.uniform(lower, upper)), rng.normal(size=model.nv), u


@pytest.mark.parametrize("driven", list(PathEnd))
def test_a_rope_over_two_posts_has_euler_s_tension(driven: PathEnd) -> None:
    """It turns by 2 rad about one post and by -1.3 rad about another."""
    angles = np.concatenate((np.linspace(0, 2.0, 9), 2.0 - np.linspace(0, 1.3, 9)))
    points = 0.02 * np.cumsum(np.column_stack((np.cos(angles), np.sin(angles))), axis=0)
    path = [Site("l0", (float(x), float(y), 0.3)) for x, y in ((0.0, 0.0), *points)]
    path.append(Site("l1", (0.1, 0.0, 0.3)))
    mu, pull = 0.3, 5.0
    model = pulled_model(planar(1), Tendon("rope", sites=tuple(path), friction=mu, driven=driven))
    guides = Capstan(model).at(model.state(model.q0, np.zeros(1)))
    inside = guides.angles[:-1] if driven is PathEnd.FIRST else guides.angles[1:]
    assert inside.sum() == pytest.approx(2.0 + 1.3, abs=1e-12)
    for direction in (1.0, -1.0):
        tensions = guides.tensions([-pull], np.full(len(guides.angles), direction))
        after = tensions[-1] if driven is PathEnd.LAST else tensions[-2]
        before = guides.tensions([-pull], np.full(len(guides.angles), direction))[0]
        extra = guides.angles[0] if driven is PathEnd.LAST else 0.0
        assert after == pytest.approx(pull * np.exp(-direction * mu * (3.3 + extra)), rel=1e-9)
        assert before == pytest.approx(pull * np.exp(-direction * mu * guides.angles[0]), rel=1e-9)


def test_an_arm_with_a_rubbing_cable_follows_its_differential_equation() -> None:
    """EI θ' = r T and T' = -μ θ' T give θ = ln(1 + μ r T₀ s / EI) / μ; the error is O(1/n²)."""
    length, rigid, offset, pull, mu = 0.2, 4e-3, 0.012, 3.0, 0.4

    def angle(s: np.ndarray) -> np.ndarray:
        return np.log1p(mu * offset * pull * s / rigid) / mu

    nodes, weights = np.polynomial.legendre.leggauss(40)
    turned = angle(length * (nodes + 1) / 2)
    tip = length / 2 * np.array([weights @ np.cos(turned), weights @ np.sin(turned)])
    errors = []
    for n in (4, 8, 16, 32):
        terms = tuple(JointTerm(f"j{k + 1}", -offset) for k in range(n))
        model = pulled_model(planar(n, length), Tendon("cable", terms, friction=mu))
        capstan, q = Capstan(model), np.zeros(n)
        for _ in range(60):
            state = model.state(q, np.zeros(n))
            friction = capstan.at(state).forces([-pull], np.ones(n))
            q = (state.B @ [-pull] + friction) * length / n / rigid
        errors.append(np.linalg.norm(model.state(q, np.zeros(n)).y[:2] - tip))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.05)
    assert errors[-1] < 1e-4 * length * 2


@pytest.mark.parametrize("driven", list(PathEnd))
@pytest.mark.parametrize("own", [None, 0.7, 0.0])
def test_a_rope_over_a_pin_has_euler_s_tension(own: float | None, driven: PathEnd) -> None:
    """Down on both sides of a pin, half a turn; a pulley on a bearing loses nothing."""
    mu, pull = 0.3, 5.0
    pin = Wrap("l0", (0.0, 0.0, 0.0), 0.02, 0, (0, 0, 1), (0, 0.05, 0), own)
    sites = (Site("l0", (-0.02, -0.3, 0.1)), Site("l1", (-0.08, -0.2, 0.1)))
    cable = Tendon("rope", sites=sites, friction=mu, driven=driven, wraps=(pin,))
    model = pulled_model(planar(1), cable)
    guides = Capstan(model).at(model.state([0.0], [0.0]))
    acts = mu if own is None else own
    assert guides.angles == pytest.approx([math.pi], abs=1e-12)
    assert guides.capstan.friction == pytest.approx([acts])
    for direction in (1.0, -1.0):
        (tension,) = guides.tensions([-pull], np.array([direction]))
        assert tension == pytest.approx(pull * math.exp(-direction * acts * math.pi), rel=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 5])
@pytest.mark.parametrize("driven", list(PathEnd))
def test_cables_around_round_bodies_that_rub(seed: int, driven: PathEnd) -> None:
    """The guides' pieces are the cable; derivatives by differences; the power that is lost."""
    robot = wrapped_robot(seed, 2)
    tendons = tuple(
        replace(t, friction=0.2, driven=driven) if t.wraps else t for t in robot.tendons
    )
    model = softdyn.build(replace(robot, tendons=tendons))
    capstan, rng = Capstan(model), np.random.default_rng(seed)
    q, v, u = random(model, rng)
    state, guides = model.state(q, v), capstan.at(model.state(q, v))
    direction = rng.uniform(-1, 1, len(capstan.tendon))
    found = capstan.derivatives(state, u, direction)

    def forces(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return capstan.at(model.state(q, v)).forces(u, direction)

    by_q = gradient(model, lambda q: forces(q, v), q, 2e-4)
    assert relative(found.q, by_q, 1e-3) < 1e-7
    angles = gradient(model, lambda q: capstan.at(model.state(q, v)).angles, q, 2e-4)
    assert relative(capstan._angle_gradients(state), angles, 1.0) < 1e-7
    lost = -guides.forces(u) @ v
    assert lost == pytest.approx(guides.dissipation(u).sum(), rel=1e-9, abs=1e-12)
    assert (guides.dissipation(u) >= 0).all()


@pytest.mark.parametrize("name", ["finger", "spirob"])
def test_derivatives_match_central_differences(name: str) -> None:
    model = rubbing(name, stiffness=3.0, damping=0.2)
    capstan, rng = Capstan(model), np.random.default_rng(1)
    q, v, u = random(model, rng)
    state = model.state(q, v)
    direction = rng.uniform(-1, 1, len(capstan.tendon))
    found = capstan.derivatives(state, u, direction)

    def forces(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return capstan.at(model.state(q, v)).forces(u, direction)

    np.testing.assert_allclose(found.value, forces(q, v, u), atol=1e-14)
    size = np.abs(found.q).max()
    by_q = slopes(lambda x: forces(q + x, v, u), model.nv, 1e-6)
    by_v = slopes(lambda x: forces(q, v + x, u), model.nv, 0.5)  # linear
    by_u = slopes(lambda x: forces(q, v, u + x), model.nu, 1e-6)
    np.testing.assert_allclose(found.q, by_q, atol=1e-7 * size)
    np.testing.assert_allclose(found.v, by_v, atol=1e-9 * size)
    np.testing.assert_allclose(found.u, by_u, atol=1e-6 * np.abs(found.u).max())


@pytest.mark.parametrize("name", ["finger", "helix", "spirob"])
def test_guides_lose_the_power_that_is_missing_at_the_joints(name: str) -> None:
    model = rubbing(name, 0.3)
    capstan, rng = Capstan(model), np.random.default_rng(2)
    for _ in range(50):
        q, v, u = random(model, rng)
        state = model.state(q, v)
        guides = capstan.at(state)
        lost = guides.dissipation(u)
        assert lost.min() >= 0
        put_in = guides.pull(u) @ state.moment_arms @ v
        given = (state.B @ u + guides.forces(u)) @ v
        assert lost.sum() == pytest.approx(put_in - given, rel=1e-9)


def test_friction_acts_on_the_size_of_a_two_sided_input() -> None:
    model = pulled_model(planar(1), Tendon("pair", (JointTerm("j1", 0.01),), friction=0.2))
    guides = Capstan(model).at(model.state([0.5], [0.0]))
    for u in (3.0, -3.0):
        for direction in (1.0, -1.0):
            (behind,) = guides.tensions([u], [direction])
            assert behind == pytest.approx(-u * np.exp(direction * np.sign(u) * 0.2 * 0.5))
            assert guides.forces([u], [direction]) == pytest.approx(0.005 * (-behind - u))


def test_joints_are_guides_and_slides_belong_to_the_piece_between() -> None:
    robot = parse_text(ARM, path=Path("arm.urdf"))
    terms = (JointTerm("bend", 0.3), JointTerm("slide", 4.0), JointTerm("twist", 0.1))
    model = pulled_model(robot, Tendon("t", terms, friction=0.1))
    guides = Capstan(model).at(model.state(model.q0, np.zeros(model.nv)))
    dof = {name: k for k, name in enumerate(model.joint_names)}
    expected = np.zeros((2, model.nv))
    expected[0, [dof["bend"], dof["slide"], dof["twist"]]] = 0.15, 4.0, 0.05
    expected[1, dof["twist"]] = 0.05
    np.testing.assert_allclose(guides.arms, expected)


def test_coefficients_may_be_replaced_and_must_fit() -> None:
    model = softdyn.load("finger")
    assert not len(Capstan(model).tendon)
    np.testing.assert_array_equal(Capstan(model, [0.0, 0.2]).friction, 0.2)
    for wrong in ([0.1], -1.0, [np.nan, 0.0]):
        with refused("friction"):
            Capstan(model, wrong)
    for name, wrong in (("tendon_a", [-1.0, 0.0]), ("tendon_b", [0.0, 11.0])):
        with refused(f"friction of '{name}'"):
            Capstan(model, wrong)


def test_a_state_of_another_robot_is_refused() -> None:
    model, spirob = rubbing("finger"), softdyn.load("spirob")
    plain = softdyn.load("finger")
    for other in (spirob, plain):
        with refused("state"):
            Capstan(model).at(other.state(other.q0, np.zeros(other.nv)))
