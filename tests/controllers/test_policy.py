"""Policies as controllers: networks in files, callables, bounds, and what is refused."""

import math

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint, testing
from softdyn.controllers import PolicyController, PolicyNetwork, Status
from softdyn.controllers.policy import InputScale, PolicyView
from softdyn.files import write_text

TARGET = np.array([0.1, 0.0, -0.15])


def waves(observation):
    return 2 * np.sin(observation[:2])


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


@pytest.fixture
def network():
    rng = np.random.default_rng(0)
    layers = [(rng.normal(size=(3, 11)), rng.normal(size=3)), (rng.normal(size=(2, 3)), [0.1, 0])]
    return PolicyNetwork(layers)


def test_a_network_is_its_formula(network):
    """Written out with sums of Python numbers."""
    observation = np.random.default_rng(1).normal(size=11)
    (W, b), (V, c) = network.layers
    hidden = [math.tanh(sum(w * o for w, o in zip(row, observation, strict=True)) + bias)
              for row, bias in zip(W, b, strict=True)]  # fmt: skip
    expected = [sum(v * h for v, h in zip(row, hidden, strict=True)) + bias
                for row, bias in zip(V, c, strict=True)]  # fmt: skip
    np.testing.assert_allclose(network(observation), expected, rtol=1e-13)


def test_a_view_has_its_parts_in_their_order(finger):
    q, v = np.array([0.1, -0.2, 0.3, 0.05]), np.array([1.0, 2.0, 3.0, 4.0])
    state, u = finger.state(q, v), np.array([-1.0, 0.5])
    view = PolicyView(finger, ("error", "v", "sensors", "q", "input", "y", "target"), 2)
    expected = [*(TARGET - state.y), *v, 7, 8, *q, -1, 0.5, *state.y, *TARGET]
    np.testing.assert_array_equal(view(state, TARGET, u, np.array([7.0, 8.0])), expected)
    assert view.size == len(expected)


def test_actions_at_both_ends_are_the_bounds():
    model = softdyn.load("spirob")  # its cables only pull
    scale, ones = InputScale(model), np.ones(model.nu)
    np.testing.assert_array_equal(scale.input(-ones), model.u_min)
    np.testing.assert_array_equal(scale.input(ones), model.u_max)
    action = np.random.default_rng(0).uniform(-1, 1, model.nu)
    np.testing.assert_allclose(scale.action(scale.input(action)), action, atol=1e-15)


def test_a_file_comes_back_and_needs_no_format(finger, network, tmp_path):
    network.save(tmp_path / "policy.npz")
    (W, b), (V, c) = network.layers
    np.savez(tmp_path / "plain.npz", W0=W, b0=b, W1=V, b1=c)
    state, found = finger.state(finger.q0, np.zeros(4)), []
    for name in ("policy.npz", "plain.npz"):
        controller = PolicyController(finger, tmp_path / name)
        assert controller.view.parts == ("q", "v", "error")
        assert len(controller.parameters["sha256"]) == 64
        found.append(controller(state, SetPoint(TARGET)).u)
    np.testing.assert_array_equal(found[0], found[1])
    expected = np.clip(network(np.concatenate((state.q, state.v, TARGET - state.y))), -1, 1)
    np.testing.assert_allclose(found[0], expected, atol=1e-15)  # the finger's bounds are ±1


@pytest.mark.parametrize("kind", ["network", "callable"])
def test_it_keeps_the_rules_of_a_controller(finger, network, kind):
    policy = network if kind == "network" else waves
    report = testing.check_controller(lambda model: PolicyController(model, policy), finger)
    assert report.passed, str(report)


def test_an_action_that_is_not_finite_holds_the_last_good_input(finger):
    answers = iter([[0.3, -2.0], [np.nan, 0.0], [np.inf, 0.0]])
    controller = PolicyController(finger, lambda observation: next(answers))
    state = finger.state(finger.q0, np.zeros(4))
    found = [controller(state, SetPoint(TARGET)) for _ in range(3)]
    for command in found:
        np.testing.assert_array_equal(command.u, [0.3, -1.0])
    assert [one.status for one in found] == [Status.OK, Status.NON_FINITE, Status.NON_FINITE]
    assert controller.guard.fallbacks == 2


@pytest.mark.parametrize(("make", "name"), [
    (lambda model: PolicyController(model, "nowhere.npz"), "nowhere.npz"),
    (lambda model: PolicyController(model, 3), "policy"),
    (lambda model: PolicyController(model, np.sin, ["sensors"]), "observation"),
    (lambda model: PolicyController(model, np.sin, ["speed"]), "observation"),
    (lambda model: PolicyController(model, PolicyNetwork([(np.eye(2), [0, 0])])), "policy"),
    (lambda model: PolicyNetwork([]), "layers"),
    (lambda model: PolicyNetwork([(np.eye(2), [0.0])]), "b0"),
    (lambda model: PolicyNetwork([(np.eye(2), [0, 0]), (np.eye(3), [0, 0, 0])]), "W1"),
    (lambda model: PolicyNetwork([(np.eye(2) * np.nan, [0, 0])]), "W0"),
])  # fmt: skip
def test_what_is_refused(finger, make, name):
    with pytest.raises(InputError) as error:
        make(finger)
    assert error.value.name == name


@pytest.mark.parametrize("entries", [
    {"W0": np.eye(2)}, {"W0": np.eye(2), "b0": np.zeros(2), "W2": np.eye(2)}, {},
    {"W0": np.eye(2), "b0": np.zeros(3)},
    {"W0": np.eye(2), "b0": np.zeros(2), "format": np.array("softdyn-policy-2")},
])  # fmt: skip
def test_a_file_that_is_no_policy_is_one_line_with_its_name(entries, tmp_path):
    np.savez(tmp_path / "x.npz", **entries)
    write_text(tmp_path / "y.npz", "text")
    for file in ("x.npz", "y.npz"):
        with pytest.raises(InputError) as error:
            PolicyNetwork.load(tmp_path / file)
        assert str(tmp_path / file) in error.value.name
