"""Plants that differ from the model: masses, springs, dampers and a payload."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn.validation import StateMap, Twin
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.twin.plant_errors import PlantErrors, multiplied
from tests.support.refused import refused


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
        terms.set_state(state.q, state.v)
        found.append((terms.M(), terms.g()))
    (M, g), (M_loaded, g_loaded) = found
    assert M_loaded - M == pytest.approx(0.05 * state.J.T @ state.J, abs=1e-12)
    assert g_loaded - g == pytest.approx(0.05 * 9.81 * state.J[2], abs=1e-12)


def test_factors_by_joint_act_on_its_spring_its_damping_and_what_it_moves() -> None:
    """In SpiRob's chains of massless links only the last joint's link has a mass."""
    plain = Twin("spirob")
    names = [plain.model.joint(k).name for k in range(plain.model.njnt)]
    last, other = names[2], names[0]  # bend, bend, twist
    stiffness = {last: 2.0, "each": 0.5}
    twin = PlantErrors(mass={last: 3.0, other: 9.0}, stiffness=stiffness, damping={last: 4.0}).twin(
        "spirob"
    )
    carriers, factors = plain.model.jnt_bodyid, np.array([9.0, 1.0, 3.0, *[1.0] * 24])
    np.testing.assert_allclose(
        twin.model.body_mass[carriers], factors * plain.model.body_mass[carriers]
    )
    springs = twin.model.jnt_stiffness / plain.model.jnt_stiffness
    assert springs == pytest.approx([0.5, 0.5, 2.0, *[0.5] * 24])
    assert twin.model.dof_damping[2] == pytest.approx(4.0 * plain.model.dof_damping[2])
    np.testing.assert_array_equal(twin.model.dof_damping[3:], plain.model.dof_damping[3:])
    with refused("stiffness", "'bend'; did you mean 'bend_z_9'?"):
        PlantErrors(stiffness={"bend": 1.0}).twin("spirob")
    with refused("damping.bend", -1):
        PlantErrors(damping={"bend": -1})
    assert multiplied({last: 2.0}, 3.0) == {"each": 3.0, last: 6.0}
