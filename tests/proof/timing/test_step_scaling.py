"""Generated chains, and the step on them."""

import numpy as np
import pytest

from tests.proof.timing import step_scaling
from tests.proof.timing.step_scaling import chain
from tests.support.long_chains import chain_urdf


@pytest.mark.parametrize(("joints", "inputs"), [(1, 1), (4, 2), (7, 3), (48, 24), (200, 3)])
def test_chains(joints, inputs, tmp_path):
    model = chain(tmp_path, joints, inputs)
    assert (model.nv, model.nu) == (joints, inputs)
    state = model.state(model.q0, np.zeros(joints))
    assert np.linalg.matrix_rank(state.B) == min(inputs, joints)
    assert np.allclose(state.y, [0, 0, -0.5])
    assert model.robot.length == pytest.approx(0.5)
    assert chain_urdf(joints, inputs) == model.robot.path.read_text()


def test_scaling(monkeypatch):
    monkeypatch.setattr(step_scaling, "FIXED_JOINTS", 7)
    monkeypatch.setattr(step_scaling, "DURATION", 0.05)
    found = step_scaling.scaling(joints=(4, 6), inputs=(2,), states=6, rounds=2)
    assert [(row["n"], row["m"]) for row in found["joints"]] == [(4, 3), (6, 3)]
    assert [(row["n"], row["m"]) for row in found["inputs"]] == [(7, 2)]
    for row in (*found["joints"], *found["inputs"]):
        assert row["solver_us"] > 0
        assert row["floor_us"] > row["solver_us"]
