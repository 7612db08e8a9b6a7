"""IC and UIC against the paper's equations as the oracle has them, with the same thresholds."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn import Reference, State
from softdyn.controllers import Impedance, UnderactuatedImpedance
from softdyn.controllers.impedance import task_inertia
from softdyn.validation.oracles.programmes import impedance, inputs, tip, underactuated
from softdyn.validation.oracles.reference_laws import pseudo_inverse, reference_inertia
from tests.support.control_cases import BUNDLED, drawn, gains_of, recorded, robot

LAWS = {"ic": Impedance, "uic": UnderactuatedImpedance}


def literal(state: State, reference: Reference, name: str) -> np.ndarray:
    """B⁺ τ before clamping: eq. (IC), and eq. (UIC) with I_p = B B⁺ (the text prints B⁺B)."""
    task = tip(state, reference)
    torque = impedance(state, task, gains_of(name), reference_inertia)
    if name.endswith("uic"):
        torque = underactuated(state, task, torque, pseudo_inverse)
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
    state, _ = recorded("finger")[3]
    inertia = task_inertia(state.M, state.J)
    assert np.abs(inertia[1]).max() == 0  # the finger never moves in y
    mobility = state.J @ np.linalg.inv(state.M) @ state.J.T
    assert np.allclose(mobility @ inertia @ mobility, mobility, rtol=1e-9, atol=1e-9)
