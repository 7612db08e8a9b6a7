"""IC and UIC against the paper's equations, as implemented by the oracle."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn import Reference, State
from softdyn.controllers import Impedance, UnderactuatedImpedance
from softdyn.controllers.impedance import add_actuated, task_force
from softdyn.controllers.qps.linear_algebra import row_space
from tests.support.control_cases import BUNDLED, drawn, gains_of, recorded, robot
from tests.support.paper_qps import impedance, inputs, tip, underactuated

LAWS = {"ic": Impedance, "uic": UnderactuatedImpedance}


def literal(state: State, reference: Reference, name: str) -> np.ndarray:
    """B⁺ τ before clamping: eq. (IC), and eq. (UIC) with I_p = B B⁺ (the text prints B⁺B)."""
    task = tip(state, reference)
    torque = impedance(state, task, gains_of(name))
    if name.endswith("uic"):
        torque = underactuated(state, task, torque)
    return inputs(state, torque)


@pytest.mark.parametrize("which", BUNDLED)
@pytest.mark.parametrize("name", LAWS)
def test_the_law_is_the_papers_equation(name, which, monkeypatch):
    model = robot(which)
    controller = LAWS[name](model)
    monkeypatch.setattr("test_impedance.gains_of", lambda _: controller.gains)
    saturated = 0
    for state, reference in (*drawn(which), *recorded(which)):
        u = literal(state, reference, name)
        expected = np.clip(u, model.u_min, model.u_max)
        scale = max(1.0, np.abs(u).max())
        error = np.abs(controller(state, reference).u - expected).max() / scale
        assert error < 1e-7, (state.q, error)
        saturated += (expected != u).any()
    assert saturated > 0  # clamping was seen
    assert controller.guard.fallbacks == 0


def test_task_inertia_of_a_planar_robot_leaves_out_what_it_cannot_reach():
    state, _ = drawn("finger")[2]  # the finger never moves in y
    row_basis = row_space(state.J)
    ahead = np.array([1.0, 5.0, -2.0])
    found = row_basis.T @ task_force(state.M, state.J, row_basis, ahead)
    np.testing.assert_array_equal(
        found, row_basis.T @ task_force(state.M, state.J, row_basis, ahead * (1, 0, 1))
    )
    reached = state.J @ np.linalg.solve(state.M, found)
    np.testing.assert_allclose(reached, ahead * (1, 0, 1), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("more", [0, 1, 3])
def test_what_counts_as_no_share_of_an_input_is_told_beside_the_largest_singular_value(more):
    """The threshold is relative to the largest singular value of (I - I_p) N.

    That value is 1 if some direction belongs neither to the task nor to an input. Take one task
    direction t and one input b with t·b = 1e-9. For n = 2, this is the largest singular value, and
    b / (t·b) meets t. For larger n it counts as zero, and t stays.
    """
    n, cosine, force = 2 + more, 1e-9, np.array([3.0])
    t, b = np.zeros((2, 1, n))
    t[0, 0] = 1.0
    b[0, :2] = cosine, np.sqrt(1 - cosine**2)
    torque = np.ones(n)
    add_actuated.py_func(t, b, force, torque)
    added = force * (b[0] / cosine if more == 0 else t[0])
    np.testing.assert_allclose(torque, 1 + added, rtol=1e-6)
