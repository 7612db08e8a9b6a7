"""States in batches: the numbers of single States, to the bit; bad input."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SoftModel
from softdyn.dynamics.tree import TreeModel
from tests.support.arms import PROJECTIONS
from tests.support.named_models import named_model

SOURCES = ("finger", "helix", "spirob", "slack", "winched", *range(6), *PROJECTIONS, "walker",
           "wrapped")  # fmt: skip
TERMS = ("q", "v", "M", "bias", "K", "D", "B", "h", "J", "Jdot", "y", "ydot", "lengths",
         "moment_arms", "g", "C")  # fmt: skip


@pytest.fixture(params=SOURCES, ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def cases(model: SoftModel, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    low, high = np.maximum(model.lower, -1), np.minimum(model.upper, 1)
    Q = [model.configuration(at) for at in rng.uniform(low, high, (count, model.nv))]
    return np.array(Q), rng.normal(size=(count, model.nv))


def compare(model: SoftModel) -> None:
    Q, V = cases(model, 5)
    found = model.states(Q, V)
    assert len(found) == len(list(found)) == 5
    for k, one in enumerate(found):
        expected = model.state(Q[k], V[k])
        for name in TERMS:
            right = getattr(expected, name)
            assert getattr(one, name).tobytes() == right.tobytes(), name
            assert not getattr(one, name).flags.writeable
            assert getattr(one, name).flags.f_contiguous == right.flags.f_contiguous, name
            if name != "C":
                np.testing.assert_array_equal(getattr(found, name)[k], right)


def test_they_equal_single_states(model):
    compare(model)


def test_without_compiled_kernels(monkeypatch):
    monkeypatch.setattr("softdyn.dynamics.tree.COMPILES", False)
    compare(TreeModel(softdyn.load("spirob").robot))


def test_the_engine_does_not_take_the_batch_for_its_last_configuration():
    """`kinematics` computes nothing for the q of the last State."""
    model = softdyn.load("spirob")
    Q, V = cases(model, 3)
    state = model.state(Q[0], V[0])
    expected = model.tendon_hessians(state.q)
    model.states(Q, V)
    np.testing.assert_array_equal(model.tendon_hessians(state.q), expected)


def test_none_is_a_batch(model):
    found = model.states(np.zeros((0, model.nq)), np.zeros((0, model.nv)))
    assert found.M.shape == (0, model.nv, model.nv)
    assert found.B.shape == (0, model.nv, model.nu)
    assert list(found) == []


@pytest.mark.parametrize(
    ("name", "Q", "V"),
    [
        ("Q", np.zeros(4), np.zeros((1, 4))), ("Q", 0.0, 0.0),
        ("V", np.zeros((2, 4)), np.zeros((1, 4))),
        ("V", np.zeros((1, 4)), np.full((1, 4), np.nan)), ("Q", [["a"] * 4], np.zeros((1, 4))),
    ],
)  # fmt: skip
def test_bad_input(name, Q, V):
    with pytest.raises(InputError) as caught:
        softdyn.load("finger").states(Q, V)
    assert caught.value.name == name
