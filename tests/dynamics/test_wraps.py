"""Cables around round bodies: known courses, differences, and every term of a robot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.derivatives import tangent_dynamics
from softdyn.dynamics.wraps import Contact, RoundBodies, RoundBody, courses
from softdyn.statics.equilibrium import potential
from tests.support.oracles import gradient, rate, relative, slopes
from tests.support.robots import build, slide
from tests.support.wrap_errors import measure
from tests.support.wrapped_robots import wrapped_robot

BAR = 1e-7
STEP = 1e-4  # m, of the differences of a course
DRUM = '<cylinder link="base" xyz="0 0 0" axis="0 1 0" radius="0.03" side="0 0 0.05"/>'
# a cable over a drum of 30 mm to a slide
SLIDE = slide(
    1, 0.01, name="lift", child="slide", axis="0 0 1", limit=(-0.2, 0.2), pull=(0, 9), gear=-1,
    path=("base -0.15 0 -0.12", DRUM, "slide 0.15 0 -0.12"),
)  # fmt: skip


def round_body(radius=0.03, sphere=False, side=None, inside=False) -> RoundBody:
    return RoundBody(radius, sphere, None if side is None else np.array(side, float), inside)


class Course:
    """One of `courses`."""

    def __init__(self, body: RoundBody, a: np.ndarray, b: np.ndarray) -> None:
        found = courses(RoundBodies.of([body]), np.array([[a, b]]))
        self.contact, self.length = Contact(found.contact[0]), found.length[0]
        self.gradient, self.turn, self.points = found.gradient[0], found.turn[0], found.points()[0]
        self.bends = found.bends


def test_a_cable_over_a_drum():
    model = build(SLIDE)
    for q, length, arm in (
        (0.0, 0.4293667168742827, -0.738981007),
        (0.05, 0.3960376919, -0.5801158554),
    ):
        state = model.state([q], [0.3])
        assert state.lengths[0] == pytest.approx(length, abs=1e-10)
        assert state.moment_arms[0, 0] == pytest.approx(arm, abs=1e-9)
        assert state.B[0, 0] == -state.moment_arms[0, 0]


@pytest.mark.parametrize("sphere", [False, True])
def test_a_quarter_turn(sphere):
    """Down, a quarter of the circle, and to the right."""
    a, b = np.array([-0.03, 0.1, 0.0]), np.array([0.2, -0.03, 0.0])
    found = Course(round_body(sphere=sphere, side=(-0.1, -0.1, 0)), a, b)
    assert found.length == pytest.approx(0.1 + 0.2 + 0.03 * math.pi / 2, abs=1e-15)
    assert found.turn == pytest.approx(math.pi / 2, abs=1e-14)
    np.testing.assert_allclose(found.points, [[-0.03, 0, 0], [0, -0.03, 0]], atol=1e-15)
    np.testing.assert_allclose(found.gradient, [[0, 1, 0], [1, 0, 0]], atol=1e-15)
    assert found.contact is (Contact.CLOCKWISE if sphere else Contact.COUNTER)


def test_the_side_decides_and_a_helix_rises_in_proportion():
    a, b = np.array([-0.1, -0.04, 0.0]), np.array([0.1, -0.04, 0.06])
    straight = Course(round_body(), a, b)
    assert straight.contact is Contact.FREE
    assert straight.length == pytest.approx(float(np.linalg.norm(b - a)))
    assert Course(round_body(side=(0, -0.05, 0)), a, b).contact is Contact.FREE
    around = Course(round_body(side=(0, 0.05, 0)), a, b)
    assert around.contact is Contact.CLOCKWISE
    (x, y, low), (_, _, high) = around.points
    assert math.hypot(x, y) == pytest.approx(0.03)
    flat = Course(round_body(side=(0, 0.05, 0)), a * [1, 1, 0], b * [1, 1, 0])
    arc = 0.03 * flat.turn
    assert high - low == pytest.approx(0.06 * arc / flat.length)
    assert around.length == pytest.approx(math.hypot(flat.length, 0.06))
    assert around.turn == pytest.approx(flat.turn * flat.length / around.length)


@pytest.mark.parametrize("sphere", [False, True])
def test_inside_it_bends_at_the_point_of_the_shortest_path(sphere):
    rng = np.random.default_rng(5)
    body = round_body(0.04, sphere, (0.0, 0.0, 0.0), inside=True)
    bent = 0
    for _ in range(60):
        a, b = rng.normal(scale=0.1, size=(2, 3))
        found = Course(body, a, b)
        straight = float(np.linalg.norm(b - a))
        if found.contact is not Contact.BENT:
            assert found.length == pytest.approx(straight)
            continue
        bent += 1
        p = found.points[0]
        assert np.linalg.norm(p if sphere else p[:2]) == pytest.approx(0.04)
        nearby = p + rng.normal(scale=1e-3, size=(200, 3))
        nearby *= 0.04 / np.linalg.norm(nearby if sphere else nearby[:, :2], axis=1)[:, None]
        if not sphere:
            nearby[:, 2] = p[2]
        ways = np.linalg.norm(nearby - a, axis=1) + np.linalg.norm(nearby - b, axis=1)
        assert found.length == pytest.approx(
            float(np.linalg.norm(p - a) + np.linalg.norm(p - b)), abs=1e-14
        )
        assert straight < found.length <= ways.min() + 1e-12
        cosine = (p - a) @ (b - p) / np.linalg.norm(p - a) / np.linalg.norm(b - p)
        assert found.turn == pytest.approx(math.acos(cosine), abs=1e-7)
    assert bent > 20


@pytest.mark.parametrize("sphere", [False, True])
@pytest.mark.parametrize("where", ["no side", "outside", "inside"])
def test_derivatives_of_a_course(sphere, where):
    """Gradient, Hessian and the turn's gradient, but not near lift-off and the surface."""
    rng = np.random.default_rng(1)
    compared, left_out, kinds = 0, 0, set()
    for _ in range(80):
        side, r = rng.normal(size=3), rng.uniform(0.02, 0.2)
        side *= r * (0.3 if where == "inside" else 2.0) / np.linalg.norm(side)
        side[2] *= sphere
        body = round_body(r, sphere, None if where == "no side" else side, where == "inside")
        x = rng.normal(scale=0.2, size=6)
        here = Course(body, x[:3], x[3:])

        def at(step, body=body, x=x):
            return Course(body, (x + step)[:3], (x + step)[3:])

        steps = 40 * STEP * np.vstack((np.eye(6), -np.eye(6)))
        if any(at(step).contact is not here.contact for step in steps):
            left_out += 1
            continue
        compared += 1
        kinds.add(here.contact)
        by_points = slopes(lambda x: at(x).gradient.ravel(), 6, STEP)
        assert relative(here.gradient.ravel(), slopes(lambda x: at(x).length, 6, STEP), 1.0) < BAR
        assert relative(here.bends.hessian[0], by_points, 1.0) < BAR
        assert relative(here.bends.turn[0], slopes(lambda x: at(x).turn, 6, STEP), 1.0) < BAR
    assert compared > 40, left_out
    assert Contact.FREE in kinds or Contact.BENT in kinds
    assert len(kinds) >= 3


@pytest.mark.parametrize("angle", [1e-3, 3e-4])
def test_the_hessian_of_sites_almost_on_one_line_with_a_sphere_s_centre(angle):
    """By differences over a thousandth of the way to the line, where 1/angle makes it steep."""
    a, b = np.array([-0.1, 0.0, 0.0]), 0.12 * np.array([math.cos(angle), math.sin(angle), 0.0])
    body, step = round_body(sphere=True), 1e-4 * angle

    def moved(h):
        x = np.concatenate((a, b)) + h
        return Course(body, x[:3], x[3:]).gradient.ravel()

    differences = slopes(moved, 6, step)
    found = Course(body, a, b)
    assert found.contact in (Contact.CLOCKWISE, Contact.COUNTER)
    assert np.abs(differences).max() > 0.03 / angle / 0.1 / 0.12 / 2
    assert relative(found.bends.hessian[0], differences) < 1e-6


@pytest.mark.parametrize("sphere", [False, True])
def test_a_cable_that_is_exactly_tangent_has_no_turn(sphere):
    """Rounding on either side of lift-off is neither a turn of 2π nor a length of one."""
    rng, touched = np.random.default_rng(4), 0
    for _ in range(300):
        angle, r, (before, behind) = rng.uniform(0, 2 * np.pi), 0.03, rng.uniform(0.01, 0.2, 2)
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        along = np.array([-out[1], out[0], 0.0])
        a, b = r * out - before * along, r * out + behind * along
        found = Course(round_body(r, sphere, 2 * r * out), a, b)
        touched += found.contact is not Contact.FREE
        assert abs(found.turn) < 1e-6
        assert found.length == pytest.approx(before + behind, abs=1e-12)
    assert touched > 20


def test_a_site_on_the_surface_and_one_inside():
    on, far = np.array([0.03, 0.0, 0.0]), np.array([-0.1, 0.02, 0.0])
    for near in (on, on * (1 - 1e-12)):
        found = Course(round_body(), near, far)
        assert found.contact in (Contact.COUNTER, Contact.CLOCKWISE)
        assert np.isfinite(found.bends.hessian).all()
    inside = Course(round_body(), on * 0.9, far)
    assert inside.contact is Contact.ENTERED
    assert inside.length == pytest.approx(float(np.linalg.norm(on * 0.9 - far)))


def test_lift_off_and_landing_are_continuous():
    """The moment arm of the slide has no jump where the cable lifts off its drum."""
    model = build(SLIDE.replace("-0.2", "-0.4").replace('"0.2"', '"0.4"'))
    qs = np.linspace(0.0, 0.35, 701)
    states = [model.state([q], [0.0]) for q in qs]
    contacts = [model.tendon_geometry(s.q).around.courses.contact[0] for s in states]
    assert {contacts[0], contacts[-1]} == {Contact.COUNTER, Contact.FREE}
    arms = np.array([s.moment_arms[0, 0] for s in states])
    slopes = [model.tendon_hessians(s.q)[0, 0, 0] for s in states]
    assert np.abs(np.diff(arms)).max() < 1.05 * max(slopes) * (qs[1] - qs[0])
    lengths = np.array([s.lengths[0] for s in states])
    np.testing.assert_allclose(
        np.diff(lengths) / np.diff(qs), (arms[1:] + arms[:-1]) / 2, atol=1e-4
    )


@pytest.fixture(params=[1, 2, 5, 7])
def model(request) -> SoftModel:
    return softdyn.build(wrapped_robot(request.param, bodies=2))


def test_every_term_of_a_robot(model):
    rng = np.random.default_rng(3)
    for _ in range(3):
        q = model.configuration(
            rng.uniform(np.maximum(model.lower, -1), np.minimum(model.upper, 1))
        )
        v, u = rng.normal(size=model.nv), rng.uniform(model.u_min, model.u_max)
        state = model.state(q, v)
        assert relative(state.lengths, model.tendon_lengths(q)) < 1e-14
        assert relative(state.moment_arms, model.tendon_moment_arms(q)) < 1e-13
        assert relative(state.K, gradient(model, model.elastic_energy, q, 2e-4), 1.0) < BAR
        arms = gradient(model, model.tendon_lengths, q, 2e-4)
        assert relative(state.B, (model.gear[:, None] * arms[model.actuated]).T, 1.0) < BAR
        balance = ForceBalance(model)(q, v, np.zeros(model.nv), u)
        assert relative(balance.residual, state.h - state.B @ u, 1.0) < 1e-12
        by_q = gradient(
            model, lambda at, v=v, u=u: model.state(at, v).h - model.state(at, v).B @ u, q, 2e-4
        )
        assert relative(tangent_dynamics(model, q, v, u)[0], by_q, 1.0) < BAR
        stored = rate(model, lambda at, u=u: potential(model, at, u), q, v, 2e-4)
        assert relative((state.K + state.g - state.B @ u) @ v, stored, 1.0) < BAR


def test_robots_against_mujoco_and_differences():
    found = measure(range(20), states=1, bodies=1)
    assert not found.missed, found
    assert found.left_out < 6
    assert len(found.contacts) == 5


def test_a_body_that_nothing_touches_changes_nothing(model):
    """The straight course is the segment's, up to rounding."""
    robot = model.robot
    q = model.q0
    plain = softdyn.build(
        replace(robot, tendons=tuple(replace(t, wraps=()) for t in robot.tendons))
    )
    paths = model.tendons.wraps
    contacts = model.tendon_geometry(q).around.courses.contact
    touched = set(paths.tendon[contacts != Contact.FREE].tolist())
    free = [t for t in range(len(robot.tendons)) if t not in touched]
    still = np.zeros(model.nv)
    one, other = model.state(q, still), plain.state(q, still)
    np.testing.assert_allclose(one.lengths[free], other.lengths[free], atol=1e-14)
    np.testing.assert_allclose(one.moment_arms[free], other.moment_arms[free], atol=1e-14)
