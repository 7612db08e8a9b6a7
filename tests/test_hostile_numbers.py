"""Hostile numbers, which no sensor should send, lead to an error or a bounded fallback.

Every argument of controllers, references, integrators and the model takes NaN, infinities, huge and
denormal numbers, wrong shapes and wrong types, alone and in combination. docs/robustness.md lists
the cases and where else they are tested. Times are measured by `python -m tests.proof hostile`.
"""

from __future__ import annotations

import copy
import warnings
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import softdyn
from softdyn import Reference, SetPoint, SoftdynError, SoftModel, State
from softdyn.controllers import CONTROLLERS, Command, Gains, Status
from softdyn.description.rig import Actuator
from softdyn.dynamics.integrators import step_implicit, step_rk4
from softdyn.validation import simulate
from tests.support import hostile_states
from tests.support.control_cases import BUNDLED, GAINS, drawn, robot
from tests.support.refused import refused

ROBOTS = ("finger", "spirob", "sliding and turning", "two identical tendons", "a fixed input")
every_controller = pytest.mark.parametrize("name", sorted(CONTROLLERS))
CONTROLLED: dict[tuple[str, str], object] = {}


def controller_of(name: str, which: str):
    """One shared controller of each kind; earlier calls must not influence it."""
    if (name, which) not in CONTROLLED:
        gains = None if which in BUNDLED else GAINS
        CONTROLLED[name, which] = CONTROLLERS[name](robot(which), gains)
    return CONTROLLED[name, which]


def ask(controller, state: State, reference: object) -> Command:
    """Make one call; it must be silent, finite, within bounds, and counted if it is a fallback."""
    model = state.model
    before = controller.guard.fallbacks
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        command = controller(state, reference)
    assert command.u.shape == (model.nu,)
    assert ((model.u_min <= command.u) & (command.u <= model.u_max)).all()  # NaN is not
    assert controller.guard.fallbacks - before == (command.status is not Status.OK)
    return command


# -- forged states and references, in any combination --------------------------------------------

values = st.one_of(
    st.sampled_from(hostile_states.VALUES),
    st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True),
)
changes = st.dictionaries(
    st.sampled_from(hostile_states.FIELDS), st.tuples(values, st.booleans()), max_size=4
)
finite = st.one_of(
    st.sampled_from([v for v in hostile_states.VALUES if np.isfinite(v)]),
    st.floats(allow_nan=False, allow_infinity=False),
)
points = st.lists(finite, min_size=3, max_size=3)


@every_controller
@settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    which=st.sampled_from(ROBOTS),
    case=st.integers(0, 17),
    changes=changes,
    reference=st.none() | st.builds(Reference, points, points, points),
)
def test_any_combination_keeps_the_contract(name, which, case, changes, reference) -> None:
    controller = controller_of(name, which)
    state, ordinary = drawn(which)[case]
    ask(controller, hostile_states.forge(state, changes), reference or ordinary)
    assert ask(controller, state, ordinary).status is Status.OK  # and no later answer is affected


@every_controller
@pytest.mark.parametrize("which", ["finger", "spirob"])
def test_ranks_that_fail(name: str, which: str) -> None:
    controller, (state, ordinary) = controller_of(name, which), drawn(which)[4]
    for _, broken in hostile_states.degenerate(state):
        ask(controller, broken, ordinary)
        ask(controller, broken, SetPoint(broken.y))
    still = robot(which).state(state.q, 0 * state.v)
    assert ask(controller, still, SetPoint(still.y)).status is Status.OK  # at rest on the target


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_huge_numbers_are_no_warnings() -> None:
    model = robot("finger")
    huge = model.state(np.full(4, 1e200), np.full(4, 1e308))
    far = SetPoint(np.full(3, 1e308))
    for name in sorted(CONTROLLERS):
        ask(controller_of(name, "finger"), huge, far)
    log = simulate(model, CONTROLLERS["ic"](model), SetPoint(np.full(3, 1e200)), duration=0.02)
    assert "from its reference" in log.reason


# -- wrong kinds of arguments --------------------------------------------------------------------


@every_controller
def test_what_is_no_state_or_reference_is_refused(name: str) -> None:
    controller, (state, goal) = controller_of(name, "finger"), drawn("finger")[0]
    for wrong in (None, 0.0, np.zeros(8), "state", (state.q, state.v), goal, robot("finger")):
        with refused("state"):
            controller(wrong, goal)
    with refused("state", "one of 'spirob' with 3 inputs, of …"):
        controller(drawn("spirob")[0][0], goal)
    for wrong in (None, [0.1, 0, 0], np.zeros(3), "here", lambda t: goal):
        with refused("reference"):
            controller(state, wrong)
    assert ask(controller, state, goal).status is Status.OK


@every_controller
def test_another_robot_s_state_is_refused_and_a_copy_s_is_not(name: str, tmp_path: Path) -> None:
    controller, goal = controller_of(name, "spirob"), drawn("spirob")[0][1]
    other = drawn("spirob48")[0][0]  # of as many inputs
    with refused("state", "one of 'spirob48' with 3 inputs, of …"):
        controller(other, goal)
    path = robot("spirob").robot.path
    stiffer = tmp_path / "stiffer.urdf"
    stiffer.write_text(path.read_text().replace("springStiffness>0.1<", "springStiffness>0.2<", 1))
    assert stiffer.read_text() != path.read_text()
    changed = softdyn.load(stiffer)
    with refused("state"):
        controller(changed.state(changed.q0, np.zeros(changed.nv)), goal)
    with refused("state"):
        simulate(changed, controller, SetPoint(goal.y), duration=0.01)
    (tmp_path / "same.urdf").write_text(path.read_text())
    for model in (copy.deepcopy(robot("spirob")), softdyn.load(tmp_path / "same.urdf")):
        state = model.state(model.q0, np.zeros(model.nv))
        assert ask(controller, state, SetPoint(state.y)).status is Status.OK


def wrong_arrays(right: np.ndarray) -> list[object]:
    """Values that are no valid array of this shape."""
    return [
        None, "text", {}, np.zeros((*right.shape, 2)), np.zeros(()), np.zeros(0), right[..., :-1],
        right.astype(complex), right.astype(str), np.full(right.shape, None), [[1.0], [1.0, 2.0]],
    ]  # fmt: skip


ARRAYS = tuple(field.name for field in fields(State) if field.name != "model")


@pytest.mark.parametrize("name", ARRAYS)
def test_a_state_refuses_wrong_arrays_and_takes_right_ones_in_any_form(name: str) -> None:
    state, goal = drawn("sliding and turning")[4]
    right = getattr(state, name)
    for wrong in wrong_arrays(right):
        with refused(name):
            replace(state, **{name: wrong})
    forms = (right.tolist(), np.asfortranarray(right), np.repeat(right, 2, -1)[..., ::2])
    for form in (*forms, right.astype(np.longdouble)):
        other = replace(state, **{name: form})
        array = getattr(other, name)
        np.testing.assert_array_equal(array, right)
        assert (array.dtype, array.flags.c_contiguous) == (float, True)
        assert not array.flags.writeable
    for controller in CONTROLLERS:
        one = ask(controller_of(controller, "sliding and turning"), state, goal)
        two = ask(controller_of(controller, "sliding and turning"), other, goal)
        np.testing.assert_array_equal(one.u, two.u)


@pytest.mark.parametrize("name", ["y", "ydot", "yddot"])
def test_references_refuse_wrong_arrays(name: str) -> None:
    bad = [np.full(3, value) for value in (np.nan, np.inf, -np.inf)]
    for wrong in [*wrong_arrays(np.ones(3)), *bad, [1.0, 2.0, "3"]]:
        with refused(name):
            Reference(**{"y": np.zeros(3), name: wrong})


def call(model: SoftModel, name: str, q: object, v: object) -> object:
    """Call a method of the model with those of q and v that it takes."""
    method = getattr(model, name)
    if name in ("state", "coriolis", "integrate", "kinetic_energy"):
        return method(q, v)
    return method(q, v, np.zeros(model.nu)) if name == "forward_dynamics" else method(q)


METHODS = (
    "state", "coriolis", "gravity", "integrate", "forward_dynamics", "kinetic_energy",
    "gravity_energy", "elastic_energy", "potential_energy", "tendon_lengths", "tendon_moment_arms",
    "tendon_hessians", "tangent_stiffness",
)  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_the_model_refuses_wrong_arguments(method: str) -> None:
    model = robot("sliding and turning")
    q, v = model.q0, np.zeros(model.nv)
    bad = [[*wrong_arrays(x), np.full(x.shape, np.nan), np.full(x.shape, np.inf)] for x in (q, v)]
    for wrong in [*bad[0], [10**400] * model.nq]:
        with refused("q"):
            call(model, method, wrong, v)
    if method in ("state", "coriolis", "integrate", "forward_dynamics", "kinetic_energy"):
        for wrong in bad[1]:
            with refused("dv" if method == "integrate" else "v"):
                call(model, method, q, wrong)


@pytest.mark.parametrize("step", [step_implicit, step_rk4])
def test_integrators_refuse_wrong_arguments(step) -> None:
    model = robot("sliding and turning")
    right = {"q": model.q0, "v": np.zeros(model.nv), "u": np.zeros(model.nu)}
    for name, value in right.items():
        for wrong in [*wrong_arrays(value), value + np.nan, value + np.inf]:
            with refused(name):
                step(model, **{**right, name: wrong}, h=1e-3)
    for wrong in (np.nan, np.inf, None, "1", [1e-3], 1j):
        with refused("h"):
            step(model, **right, h=wrong)
    q, _ = step(model, **right, h=5e-324)  # the smallest step there is
    np.testing.assert_allclose(q, model.q0, atol=1e-300)
    with np.errstate(all="ignore"), refused("dv" if step is step_implicit else "v"):
        step(model, model.q0, np.full(model.nv, 1e200), np.zeros(model.nu), 1e-3)


# -- construction --------------------------------------------------------------------------------


@every_controller
@pytest.mark.parametrize("bounds", [(1.0, -1.0), (0.0, np.nan), (-np.inf, 0.0), (0.0, np.inf)])
def test_bounds_that_no_input_meets_are_refused(name: str, bounds: tuple[float, float]) -> None:
    parsed = robot("finger").robot
    crossed = tuple(Actuator(a.name, a.tendon, a.gear, *bounds) for a in parsed.actuators)
    model = softdyn.build(replace(parsed, actuators=crossed))
    with refused("model"):
        CONTROLLERS[name](model, GAINS)


@every_controller
def test_bounds_that_one_input_meets_are_met(name: str) -> None:
    parsed = robot("finger").robot
    held = tuple(Actuator(a.name, a.tendon, a.gear, 0.25, 0.25) for a in parsed.actuators)
    model = softdyn.build(replace(parsed, actuators=held))
    controller, (other, goal) = CONTROLLERS[name](model, GAINS), drawn("finger")[3]
    state = model.state(other.q, other.v)
    for asked in (state, hostile_states.forge(state, {"M": (np.nan, False)})):
        np.testing.assert_array_equal(controller(asked, goal).u, 0.25)


@pytest.mark.parametrize("field", [field.name for field in fields(Gains)])
def test_gains_that_are_no_numbers_are_refused(field: str) -> None:
    for wrong in (np.nan, np.inf, -np.inf, -1.0, "5", None, [1.0], 1j, True):
        with refused(f"gains.{field}"):
            Gains(**{"Kp": 100.0, field: wrong})


@every_controller
@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    gains=st.builds(
        Gains, **{name: st.floats(1e-300, 1e300) for name in ("Kp", "eps", "rho")},
        **{name: st.just(0.0) | st.floats(0, 1e300) for name in ("w1", "w2", "w3", "w4")},
        null_damping=st.floats(0, 1e300),
    )
)  # fmt: skip
def test_extreme_gains_keep_the_contract(name: str, gains: Gains) -> None:
    try:
        controller = CONTROLLERS[name](robot("finger"), gains)
    except SoftdynError:
        return
    for state, reference in drawn("finger")[:4]:
        ask(controller, state, reference)


# -- the closed loop -----------------------------------------------------------------------------


@every_controller
def test_a_diverging_loop_ends_with_its_time_and_reason(name: str, tmp_path) -> None:
    model = robot("finger")
    far = SetPoint(np.array([1e6, 0.0, 1e6]))
    log = simulate(model, controller_of(name, "finger"), far, duration=0.5)
    assert log.failed
    assert not log.complete
    assert "at t = 0 s" in log.reason
    fast = simulate(
        model, controller_of(name, "finger"), SetPoint([0.1, 0, 0]), duration=0.5,
        v0=np.full(4, 1e9),
    )  # fmt: skip
    assert fast.failed
    assert "diverged at t = " in fast.reason
    fast.save(tmp_path / "run.npz")
    again = type(fast).load(tmp_path / "run.npz")
    assert (again.reason, len(again.t)) == (fast.reason, len(fast.t))
    assert np.isfinite(again.u).all()
