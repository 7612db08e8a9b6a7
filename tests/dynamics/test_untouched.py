"""Configurations that are none, and a user's changes of the engine's model."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import InputError
from tests.support.robots import WALKER, build, hinge, load

SPIN = hinge(1, "0.2 0 0", 1, kind="continuous")


@pytest.mark.parametrize("q", [[2.0, 0.0], [0.0, 0.0], [1.0, 1e-2], [1 + 2e-6, 0.0]], ids=str)
@pytest.mark.parametrize("call", ["state", "forward_dynamics", "link_poses", "gravity"])
def test_a_continuous_joint_takes_points_of_the_circle_alone(q, call) -> None:
    """Else the mass matrix, gravity and the tip are those of a rod that is stretched."""
    model = build(SPIN)
    more = {"state": ([0.0],), "forward_dynamics": ([0.0], [])}.get(call, ())
    with pytest.raises(InputError) as caught:
        getattr(model, call)(q, *more)
    assert "cos, sin of joint 'hinge'" in caught.value.expected
    assert caught.value.got == ", ".join(f"{x:g}" for x in q)


def test_rounded_points_of_the_circle_are_taken() -> None:
    """Gravity's torque about the hinge is by hand: -m g r cos of the angle, r along x."""
    model = build(SPIN)
    for angle in np.linspace(-4, 4, 9):
        q = [round(math.cos(angle), 7), round(math.sin(angle), 7)]
        assert model.state(q, [0.0]).g[0] == pytest.approx(-9.81 * 0.2 * math.cos(angle), abs=1e-6)


def test_a_quaternion_has_length_one(tmp_path) -> None:
    model = load(tmp_path, WALKER, floating=True)
    q = model.q0.copy()
    q[3:7] = 0.0, 0.0, 0.0, 2.0
    with pytest.raises(InputError) as caught:
        model.state(q, np.zeros(model.nv))
    assert "quaternion" in caught.value.expected


def test_changes_of_the_engine_s_model_are_the_user_s_own() -> None:
    """Gravity and a mass are changed; every term stays, and the user's own algorithm sees both."""
    model = softdyn.load("finger")
    q, v = np.array([0.3, -0.2, 0.5, 0.1]), np.array([1.0, 0.5, -0.4, 0.2])
    before, u = model.state(q, v), np.array([0.5, -0.5])
    energy, qdd = model.gravity_energy(q), model.forward_dynamics(q, v, u)
    engine = model.pin_model
    engine.gravity.linear = np.zeros(3)
    engine.inertias[1] = pin.Inertia(9.0, np.zeros(3), np.eye(3))
    after = model.state(q, v)
    for name in ("M", "bias", "h", "g", "J"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    np.testing.assert_array_equal(model.gravity(q), before.g)
    np.testing.assert_array_equal(model.forward_dynamics(q, v, u), qdd)
    assert model.gravity_energy(q) == energy
    assert model.pin_model is engine
    assert not pin.computeGeneralizedGravity(engine, engine.createData(), q).any()
