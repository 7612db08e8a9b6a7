"""Sliders for joints and inputs: the resulting equilibria, stable or not."""

from __future__ import annotations

import numpy as np

import softdyn
from softdyn import statics
from softdyn.view.live import messages as m
from softdyn.view.live.explorer import Explorer, explore
from tests.support.refused import refused


def part(explorer, name):
    return explorer.frame()[explorer.columns.places[name]].astype(float)


def test_inputs_lead_to_the_rest_and_joints_are_set_by_hand():
    model = softdyn.load("finger")
    explorer = Explorer(model)
    u = np.array([0.06, -0.1])
    explorer.apply(m.SetInputs(u))
    rest = statics.settle(model, u)
    np.testing.assert_allclose(part(explorer, "y"), rest.y, atol=1e-6)
    assert part(explorer, "stable") == 1
    assert not rest.held.any()
    # a force on the tip moves it by the ellipsoid; the oracle is the equilibrium with this force
    force, compliance = np.array([1e-5, 0, 2e-5]), part(explorer, "compliance").reshape(3, 3)
    q = rest.q.copy()
    for _ in range(8):  # Newton's method on K + g - B u - Jᵀ f
        state = model.state(q, np.zeros(4))
        left = state.K + state.g - state.B @ u - state.J.T @ force
        q = q - np.linalg.solve(rest.stiffness, left)
    np.testing.assert_allclose(
        model.state(q, np.zeros(4)).y - rest.y, compliance @ force, rtol=1e-2, atol=1e-9
    )
    x = np.array([0.1, -0.2, 0.3, 0.0])
    explorer.apply(m.SetJoints(x))
    np.testing.assert_allclose(part(explorer, "q"), x, atol=1e-7)
    assert np.isnan(part(explorer, "stable"))
    assert explorer.rest is None
    with refused("do", "reset"):
        explorer.apply(m.Reset())


def test_an_arm_that_buckles_is_shown_beside_its_unstable_rest():
    """With equal tensions the straight arm stays an equilibrium, but soon not a stable one."""
    explorer = Explorer(softdyn.load("spirob"))
    straight = explorer.rest.y
    for pull in (0.3, 1.4, 0.3):
        explorer.apply(m.SetInputs(np.full(3, pull)))
        assert explorer.notice == ""
        assert explorer.rest.stable
        if pull < 1:
            assert explorer.unstable is None
            assert np.isnan(part(explorer, "ghost")).all()
        else:
            assert not explorer.unstable.stable
            np.testing.assert_allclose(explorer.unstable.y, straight, atol=1e-9)
            assert part(explorer, "gap") > 0.02


def test_what_is_said_while_a_rest_is_found_is_done_in_order():
    """A slow machine reads many messages at once: for joints, inputs and joints again."""
    model = softdyn.load("finger")
    x = np.array([0.1, -0.2, 0.3, 0.0])

    class Told:
        def __init__(self):
            self.frames, self.errors = [], []
            by_hand = (m.SetJoints(0 * x), m.SetJoints(2 * x))
            self.said = [*by_hand, m.SetInputs(np.zeros(2)), m.Reset(), m.SetJoints(x)]

        def messages(self):
            said, self.said = self.said, []
            return iter(said)

        def state(self, shown):
            pass

        def error(self, text):
            self.errors.append(text)

        def check(self):
            pass

        def frame(self, row, patience=0.0):
            self.frames.append(row)

    channel = Told()
    explore(model, channel, lambda: len(channel.frames) > 1)
    place = Explorer(model).columns.places["q"]
    np.testing.assert_allclose(channel.frames[-1][place], x, atol=1e-7)
    assert len(channel.errors) == 1
