"""Plants that differ from the model: masses, springs, dampers and cable friction."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn.validation import StateMap, Twin
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.twin.plant_errors import PlantErrors


def test_a_plant_of_other_numbers() -> None:
    plain, heavy = Twin("finger"), PlantErrors(mass=1.2, stiffness=0.9, damping=1.1).twin("finger")
    weight = [twin.model.body_mass.sum() for twin in (plain, heavy)]
    assert weight[1] == pytest.approx(1.2 * weight[0])
    np.testing.assert_allclose(heavy.model.jnt_stiffness, 0.9 * plain.model.jnt_stiffness)
    np.testing.assert_allclose(heavy.model.dof_damping, 1.1 * plain.model.dof_damping)
    # and it acts: all masses fall alike at first, but the arm bends differently
    for twin in (plain, heavy):
        twin.advance(np.zeros(2), 400)
    assert np.abs(plain.qpos - heavy.qpos).max() > 1e-3


def test_cables_rub() -> None:
    twin = PlantErrors(cable_friction=0.05).twin("finger", friction=False)  # as `simulate` calls it
    twin.advance(np.array([1.0, -1.0]), 100)  # both tendons slide
    rubs = twin.data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON
    largest = 0.05 * 0.1  # N m: gear 0.1, inputs up to 1
    np.testing.assert_allclose(np.abs(twin.data.efc_force[rubs]), [largest] * 2)
    assert (twin.data.efc_force[rubs] * twin.data.ten_velocity < 0).all()


def test_a_payload_weighs_at_the_tip() -> None:
    """M and gravity gain those of a point mass: m JᵀJ and m g Jᵀ e_z."""
    model = softdyn.load("helix")
    twin, loaded = Twin(model), PlantErrors(payload=0.05).twin(model)
    rng = np.random.default_rng(0)
    state = model.state(model.configuration(rng.uniform(-0.2, 0.2, model.nv)), np.zeros(model.nv))
    found = []
    for plant in (twin, loaded):
        states = StateMap(model, plant)
        plant.set_state(*states.to_twin(state.q, state.v))
        terms = MujocoTerms(plant, states)
        terms.place(state.q, state.v)
        found.append((terms.M(), terms.g()))
    (M, g), (M_loaded, g_loaded) = found
    assert M_loaded - M == pytest.approx(0.05 * state.J.T @ state.J, abs=1e-12)
    assert g_loaded - g == pytest.approx(0.05 * 9.81 * state.J[2], abs=1e-12)
