"""Rules for the course of every cable: bounds, symmetry, and no dependence on the place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import softdyn
from softdyn import Robot, SoftModel
from softdyn.description.robot import Tendon
from softdyn.dynamics.wraps import Contact, RoundBodies, RoundBody, courses
from tests.support.robots import WALKER, write
from tests.support.wrapped_robots import wrapped_robot

SEEDS = st.integers(0, 1 << 30)
EXAMPLES = settings(max_examples=60, deadline=None, derandomize=True)
FEW = settings(max_examples=20, deadline=None, derandomize=True)


def course(body: RoundBody, a: np.ndarray, b: np.ndarray) -> tuple:
    """Contact, length, gradient by (a, b) and turn of one course."""
    found = courses(RoundBodies.of([body]), np.array([[a, b]]))
    return Contact(found.contact[0]), found.length[0], found.gradient[0], found.turn[0]


def drawn(seed: int, sphere: bool) -> tuple[RoundBody, np.ndarray, np.ndarray]:
    """A round body, with a side or without, and two points outside."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.02, 0.1)
    side = [None, rng.normal(size=3) * [1, 1, sphere]][int(rng.integers(2))]
    if side is not None:
        side *= 2 * radius / np.linalg.norm(side)
    ends = rng.normal(size=(2, 3))
    size = np.linalg.norm(ends if sphere else ends[:, :2], axis=1)
    ends *= (radius * rng.uniform(1.2, 4.0, 2) / size)[:, None]
    return RoundBody(radius, sphere, side, False), *ends


@pytest.mark.parametrize("sphere", [False, True])
@given(seed=SEEDS)
@EXAMPLES
def test_a_course_is_no_shorter_than_the_line_and_has_no_direction(sphere, seed):
    body, a, b = drawn(seed, sphere)
    contact, length, gradient, turn = course(body, a, b)
    assert length >= np.linalg.norm(b - a) - 1e-12
    assert (contact is Contact.FREE) == (turn == 0)
    _, back, slope, as_much = course(body, b, a)
    assert back == pytest.approx(length, rel=1e-12)
    assert as_much == pytest.approx(turn, abs=1e-9)
    np.testing.assert_allclose(slope, gradient[::-1], atol=1e-9)


@pytest.mark.parametrize("sphere", [False, True])
@given(seed=SEEDS, angles=st.tuples(*[st.floats(-3, 3)] * 3), shift=st.floats(-1, 1))
@EXAMPLES
def test_a_course_turns_with_all_that_it_touches(sphere, seed, angles, shift):
    """A sphere by any turn about its centre; a cylinder about its axis and along it."""
    body, a, b = drawn(seed, sphere)
    turn = Rotation.from_euler("zyx", angles if sphere else (angles[0], 0, 0)).as_matrix()
    along = np.array([0, 0, 0 if sphere else shift])
    side = None if body.side is None else turn @ body.side
    _, length, gradient, angle = course(body, a, b)
    _, same, turned, as_much = course(body._replace(side=side), turn @ a + along, turn @ b + along)
    assert same == pytest.approx(length, rel=1e-9)
    assert as_much == pytest.approx(angle, abs=1e-7)
    np.testing.assert_allclose(turned, gradient @ turn.T, atol=1e-7)


def backwards(tendon: Tendon) -> Tendon:
    """The same cable, its path stated from the other end."""
    last = len(tendon.sites) - 2
    wraps = tuple(replace(one, after=last - one.after) for one in reversed(tendon.wraps))
    return replace(tendon, sites=tendon.sites[::-1], wraps=wraps)


@pytest.fixture(scope="module", params=range(3))
def pair(request) -> tuple[SoftModel, SoftModel]:
    """A robot with cables around round bodies, and one whose cables are stated backwards."""
    robot: Robot = wrapped_robot(request.param)
    other = replace(robot, tendons=tuple(backwards(one) for one in robot.tendons))
    return softdyn.build(robot), softdyn.build(other)


@given(seed=SEEDS)
@FEW
def test_a_cable_has_no_first_end_and_is_no_shorter_than_the_way_between_its_ends(pair, seed):
    model, other = pair
    rng = np.random.default_rng(seed)
    q, v = (
        model.integrate(model.q0, rng.normal(scale=0.7, size=model.nv)),
        rng.normal(size=model.nv),
    )
    state, same = model.state(q, v), other.state(q, v)
    np.testing.assert_allclose(same.lengths, state.lengths, rtol=1e-12)
    np.testing.assert_allclose(same.moment_arms, state.moment_arms, atol=1e-9)
    places = model.link_poses(q)
    for tendon, length in zip(model.robot.tendons, state.lengths, strict=True):
        if tendon.sites:
            ends = [places[s.link] @ [*s.xyz, 1] for s in (tendon.sites[0], tendon.sites[-1])]
            assert length >= np.linalg.norm(ends[1] - ends[0]) - 1e-12


@pytest.fixture(scope="module")
def walker(tmp_path_factory) -> SoftModel:
    path = write(tmp_path_factory.mktemp("walker"), WALKER)
    return softdyn.load(path, floating=True)


@given(seed=SEEDS)
@FEW
def test_no_cable_feels_where_the_robot_is(walker, seed):
    """A motion of the whole robot changes no length, so no cable pulls at its base."""
    rng = np.random.default_rng(seed)
    v = rng.normal(size=walker.nv)
    q = walker.integrate(walker.q0, v)
    v[6:] = 0
    state, there = walker.state(q, v), walker.state(walker.integrate(q, v), v)
    assert np.abs(there.y - state.y).max() > 1e-3
    np.testing.assert_allclose(there.lengths, state.lengths, rtol=1e-12)
    np.testing.assert_allclose(there.moment_arms, state.moment_arms, atol=1e-12)
    np.testing.assert_allclose(state.moment_arms[:, :6], 0, atol=1e-12)
