"""The kernel that fills a State against Pinocchio's own accessors and NumPy."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn.dynamics.kernels import Live
from tests.support.control_cases import BUNDLED, MICRO, robot
from tests.support.oracles import relative
from tests.support.random_robots import write_robot

FIELDS = (
    "M", "bias", "g", "K", "D", "B", "h", "J", "Jdot", "y", "ydot", "lengths", "moment_arms",
)  # fmt: skip


def both(model, q, v):
    """The State of either path, from the same Data."""
    state = model.state(q, v)
    return model._by_kernel(state.q.copy(), state.v.copy()), model._in_numpy(
        state.q.copy(), state.v.copy()
    )


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
                "J": reach,  # nothing is left where the tip lies on an axis
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


def test_an_unknown_layout_is_noticed():
    data = robot("finger").pin_model.createData()
    Live(data)
    copied = SimpleNamespace(
        nle=data.nle, J=np.asfortranarray(data.J), Ag=data.Ag, com=data.com, oMi=list(data.oMi)
    )
    Live(copied)
    copied.J = np.ascontiguousarray(data.J)  # rows where columns should be
    with pytest.raises(RuntimeError, match="layout"):
        Live(copied)
