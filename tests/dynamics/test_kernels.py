"""The kernel that fills a State against Pinocchio's own accessors and NumPy."""

from __future__ import annotations

import inspect
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn.dynamics import engine, kernels, tendons, wrapped_paths
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.tendons import Segments
from tests.support.control_cases import BUNDLED, MICRO, robot
from tests.support.oracles import relative
from tests.support.random_robots import write_robot
from tests.support.wrapped_robots import wrapped_robot

FIELDS = (
    "M", "bias", "g", "K", "D", "B", "h", "J", "Jdot", "y", "ydot", "lengths", "moment_arms",
)  # fmt: skip


def both(model, q, v):
    """The States of both paths, from the same Data."""
    state = model.state(q, v)
    scratch, found = model._scratch, []
    for path in (model._by_kernel, model._in_numpy):
        q = state.q.copy()
        found.append(path(q, model.about_base(q), state.v.copy(), scratch))
    return found


def gravity(model, q):
    return pin.computeGeneralizedGravity(model.pin_model, model.pin_model.createData(), q)


def check(model, seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0)
    for speed in (0.0, 1.0, 1e3):
        q = model.configuration(rng.uniform(low, high))
        one, two = both(model, q, speed * rng.normal(size=model.nv))
        assert "g" in vars(one)
        assert "g" not in vars(two)  # but on demand
        assert relative(one.g, gravity(model, one.q)) < 1e-13
        reach = max(np.abs(one.J).max(), np.abs(one.y).max())
        for field in FIELDS:
            fast, plain = getattr(one, field), getattr(two, field)
            assert fast.shape == plain.shape
            assert not fast.flags.writeable
            assert not plain.flags.writeable
            scale = {
                "J": reach,  # zero if the tip lies on the axis
                "Jdot": reach * np.abs(one.v).max(),
                "ydot": reach * np.abs(one.v).max(),
                "h": max(np.abs(x).max() for x in (one.bias, one.K, one.D @ one.v)),
            }.get(field, 1e-300)
            assert relative(fast, plain, scale) < 1e-13, field


@pytest.mark.parametrize("which", BUNDLED + MICRO)
def test_bundled_and_micro_robots(which):
    check(robot(which), 0)


@pytest.mark.parametrize("seed", range(30))
def test_random_robots(seed, tmp_path):
    # branches, mimic-free trees, fixed and spatial tendons, elastic and damped ones
    check(softdyn.load(write_robot(seed, tmp_path)), seed)


@pytest.mark.parametrize("seed", range(5))
def test_floating_bases(seed, tmp_path):
    # a joint of six degrees of freedom, whose columns share a body and a twist
    model = softdyn.load(write_robot(seed, tmp_path), floating=True)
    check(model, seed)
    M = model.state(model.q0, np.ones(model.nv)).M
    assert np.array_equal(M, M.T)


def test_kernels_take_named_tuples_in_their_order():
    """Kernels take the fields one by one, which is cheaper than tuples; their names must agree."""
    named = (*engine.Memory._fields, *kernels.Constants._fields)
    for kernel, last in (
        (kernels.state_terms, ()),
        (kernels.segments_and_state, ("offset", "coefficients", *Segments._fields)),
    ):
        found = list(inspect.signature(kernel.py_func).parameters)
        assert found[:4] == ["joint_rows", "tip_and_lengths", "v", "coordinates"]
        assert tuple(found[4:]) == (*named, *last)


def test_an_unknown_layout_is_copied(recwarn):
    data = robot("finger").pin_model.createData()
    assert engine.memory(data)[1]
    other = SimpleNamespace(
        nle=data.nle, J=np.asfortranarray(data.J), Ag=data.Ag, com=data.com, oMi=list(data.oMi)
    )
    assert engine.memory(other)[1]
    assert not recwarn.list
    other.J = np.ascontiguousarray(data.J)  # rows where columns should be
    with pytest.warns(RuntimeWarning, match="unknown layout"):
        memory, in_view = engine.memory(other)
    assert not in_view
    other.J[:] = np.arange(24.0).reshape(6, 4)
    memory.copy_from(other)
    np.testing.assert_array_equal(memory.S, other.J.T)


@pytest.mark.parametrize("which", BUNDLED + MICRO)
def test_a_model_on_copies_says_the_same(which, monkeypatch):
    model = robot(which)
    monkeypatch.setattr(engine, "_stacked", np.array)
    with pytest.warns(RuntimeWarning, match="unknown layout"):
        copying = softdyn.build(model.robot)
    v = np.random.default_rng(0).normal(size=model.nv)
    q = model.integrate(model.q0, 0.1 * v)
    one, two = model.state(q, v), copying.state(q, v)
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(one, field), getattr(two, field))
    for name in ("tendon_lengths", "tendon_moment_arms", "tendon_hessians", "gravity"):
        assert relative(getattr(model, name)(q), getattr(copying, name)(q), 1e-300) < 1e-13


@pytest.mark.parametrize("which", ["spirob", 5, 7])
def test_the_loops_over_segments_against_numpy(which):
    model = robot(which) if isinstance(which, str) else softdyn.build(wrapped_robot(which))
    segments = model.tendons.segments
    assert len(segments.bodies) > 0
    q = model.integrate(model.q0, np.random.default_rng(0).normal(size=model.nv))
    found = []
    for fill in (tendons.moment_arms, tendons.arms_in_numpy):
        arms, lengths = np.ones(model.tendons.coefficients.shape), np.ones(len(model.tendons.names))
        fill(arms, lengths, *model.kinematics(q), *segments)
        found.append((arms, lengths))
    for one, other in zip(*found, strict=True):
        assert relative(one, other) < 1e-13


def test_courses_around_bodies_are_found_once_a_configuration(monkeypatch):
    """The same geometry serves lengths, moment arms, their gradients and rates."""
    model, calls = softdyn.build(wrapped_robot(7)), []
    found = wrapped_paths.courses
    monkeypatch.setattr(wrapped_paths, "courses", lambda *of: calls.append(of) or found(*of))
    v, u = np.ones(model.nv), np.zeros(model.nu)
    ways = (
        lambda: model.state(model.q0, v),
        lambda: model.forward_dynamics(model.q0, v, u),
        lambda: model.tendon_hessians(model.q0),
        lambda: ForceBalance(model)(model.q0, v, v, u),
    )
    for way in ways:
        calls.clear()
        way()
        assert len(calls) == 1
