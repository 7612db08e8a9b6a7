"""The contract of all controllers, on every robot, at every state, hostile states included."""

from __future__ import annotations

import inspect
import shutil
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softdyn
from softdyn import Ellipse, InputError, Reference, SetPoint, SoftdynError, SoftModel
from softdyn.controllers import (
    BEYOND,
    CONTROLLERS,
    Command,
    Gains,
    InputGuard,
    Schedule,
    Stage,
    Staged,
    Status,
)
from softdyn.controllers.controller import GuardedController
from softdyn.controllers.schedule import tuned
from softdyn.description import library as catalogue
from tests.support import robots
from tests.support.control_cases import BUNDLED, GAINS, MICRO, drawn, recorded, robot
from tests.support.refused import refused

PATIENCE = 10.0  # s of processor time per call; a hang takes at least 25 s at every call
CLASSES = sorted(CONTROLLERS)
HUGE, TINY = 1e300, 5e-324

every_controller = pytest.mark.parametrize("name", [*CLASSES, "best"])
every_published = pytest.mark.parametrize("name", CLASSES)
every_robot = pytest.mark.parametrize("which", BUNDLED + MICRO)


def build(name: str, which: str):
    if name == "best":
        both = Stage(GAINS, 0.05)
        schedule = tuned(robot(which)) or Schedule(both, both, arrive=0.01, leave=0.1, dwell=0.1)
        return Staged(robot(which), schedule)
    return CONTROLLERS[name](robot(which), None if which in BUNDLED else GAINS)


def ask(controller, model: SoftModel, state, reference) -> Command:
    """Make one call and check it: in time, silent, finite, in bounds, counted."""
    for _ in range(2):  # a first call may have to compile
        before, began = controller.guard.fallbacks, time.thread_time()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            command = controller(state, reference)
        elapsed = time.thread_time() - began
        if elapsed < PATIENCE:
            break
    assert elapsed < PATIENCE
    assert isinstance(command, Command)
    assert command.u.shape == (model.nu,)
    assert command.u.dtype == float
    assert not command.u.flags.writeable
    assert np.isfinite(command.u).all()
    assert (model.u_min <= command.u).all()
    assert (command.u <= model.u_max).all()
    assert controller.guard.fallbacks - before == (command.status is not Status.OK)
    assert controller.guard.not_solved <= controller.guard.fallbacks
    return command


def hostile_references() -> list[Reference]:
    far = [np.full(3, x) for x in (1e6, 1e30, 1e150, HUGE, -HUGE, TINY, -TINY, 1e-310)]
    references = [SetPoint(y) for y in far]
    references += [Reference(np.zeros(3), ydot=y) for y in far]
    references += [Reference(np.zeros(3), yddot=y) for y in far]
    references.append(Reference(np.array([HUGE, TINY, 0.0]), np.array([0.0, -HUGE, 1.0])))
    references.append(Ellipse(a=1e3, b=1e3, c=1e3, omega=1e6)(0.3))
    return references


@every_controller
@every_robot
def test_ordinary_states_need_no_fallback(name: str, which: str) -> None:
    model, controller = robot(which), build(name, which)
    pairs = drawn(which) + (recorded(which) if which in BUNDLED else ())
    for state, reference in pairs:
        command = ask(controller, model, state, reference)
        assert command.status is Status.OK, (state.q, state.v, reference.y)
        assert command.V >= 0
    assert controller.guard.not_solved == 0
    assert controller.guard.max_bound_violation <= 1e-9 * max(1.0, np.abs(model.u_max).max())


@every_controller
@every_robot
def test_rest_singular_and_limit_states(name: str, which: str) -> None:
    model, controller = robot(which), build(name, which)
    lower = np.where(np.isfinite(model.lower), model.lower, -1.0)
    upper = np.where(np.isfinite(model.upper), model.upper, 1.0)
    for coordinates in (np.zeros(model.nv), np.full(model.nv, TINY), 1e-8 * upper, lower, upper):
        state = model.state(model.configuration(coordinates), np.zeros(model.nv))
        goals = (state.y, state.y + 1e-9, np.zeros(3), 0.5 * state.y)
        for goal in goals:
            ask(controller, model, state, SetPoint(goal))


@every_controller
@pytest.mark.parametrize("which", ["finger", "spirob", "sliding and turning", "one joint"])
def test_hostile_references(name: str, which: str) -> None:
    model, controller = robot(which), build(name, which)
    state = drawn(which)[4][0]
    for reference in hostile_references():
        ask(controller, model, state, reference)
    after = ask(controller, model, *drawn(which)[4])  # and no later answer is affected
    fresh = ask(build(name, which), model, *drawn(which)[4])
    assert after.status is Status.OK
    np.testing.assert_allclose(after.u, fresh.u, atol=1e-6 * np.ptp([model.u_min, model.u_max]))


@every_controller
@pytest.mark.parametrize("which", ["finger", "helix", "spirob", "sliding and turning", "one joint"])
def test_hostile_states(name: str, which: str) -> None:
    model, controller = robot(which), build(name, which)
    rng = np.random.default_rng(3)
    goal = SetPoint(np.array([0.1, 0.0, -0.1]))
    for size in (1e2, 1e4, 1e8, 1e30, 1e100, 1e155, HUGE, 1e-310):
        v = size * rng.choice([-1.0, 1.0], model.nv)
        far = rng.uniform(-1, 1, model.nv)
        for coordinates in (0 * far, 50 * far, 1e8 * far, 1e160 * far, HUGE * far):
            for speed in (0.0, 1.0):
                try:
                    with np.errstate(all="ignore"):  # the model's own arithmetic
                        state = model.state(model.configuration(coordinates), speed * v)
                except SoftdynError:
                    continue
                ask(controller, model, state, goal)


@every_controller
@pytest.mark.parametrize("value", [np.nan, np.inf, HUGE, TINY])
def test_poisoned_states(name: str, value: float) -> None:
    # states that `model.state` would hardly return
    model, controller = robot("spirob"), build(name, "spirob")
    state, goal = recorded("spirob")[3]
    for field in ("M", "h", "J", "Jdot", "B", "K", "D", "bias", "y", "ydot"):
        first = ask(controller, model, state, goal)
        assert first.status is Status.OK
        array = np.array(getattr(state, field))
        array.flat[0] = value
        array.flags.writeable = False
        command = ask(controller, model, replace(state, **{field: array}), goal)
        if command.status is not Status.OK:
            np.testing.assert_array_equal(command.u, first.u)  # the last good input is held


@every_controller
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_references_that_are_not_numbers_are_refused(name: str, value: float) -> None:
    model, controller = robot("finger"), build(name, "finger")
    with pytest.raises(InputError):
        SetPoint(np.array([value, 0.0, 0.0]))
    state, goal = recorded("finger")[3]
    broken = SetPoint(goal.y)
    object.__setattr__(broken, "y", np.array([value, 0.0, 0.0]))  # bypasses the constructor
    command = ask(controller, model, state, broken)
    assert command.status is not Status.OK
    assert controller.guard.fallbacks == 1


@every_controller
def test_no_moment_arm_at_all(name: str) -> None:
    model, controller = robot("finger"), build(name, "finger")
    state, goal = recorded("finger")[3]
    command = ask(controller, model, replace(state, B=np.zeros_like(state.B)), goal)
    assert command.status is Status.OK
    np.testing.assert_allclose(command.u, 0.0, atol=1e-7)


@every_controller
def test_a_fixed_input_stays_fixed(name: str) -> None:
    model, controller = robot("a fixed input"), build(name, "a fixed input")
    for state, reference in drawn("a fixed input"):
        command = ask(controller, model, state, reference)
        assert command.status is Status.OK
        np.testing.assert_array_equal(command.u, 0.0)


@every_controller
@every_robot
def test_an_answer_depends_on_the_state_alone(name: str, which: str) -> None:
    model, warm = robot(which), build(name, which)
    scale = np.ptp([model.u_min, model.u_max]) or 1.0
    for state, reference in drawn(which)[:6:2]:
        one = ask(warm, model, state, reference)
        two = ask(build(name, which), model, state, reference)
        np.testing.assert_allclose(one.u, two.u, atol=1e-6 * scale)


@every_published
@pytest.mark.parametrize("which", BUNDLED)
def test_published_gains_are_the_default(name: str, which: str) -> None:
    assert CONTROLLERS[name](robot(which)).gains == CONTROLLERS[name].published[which]
    assert CONTROLLERS[name](robot(which), GAINS).gains is GAINS


@every_published
@pytest.mark.parametrize("which", BUNDLED)
def test_a_copy_of_a_bundled_file_has_no_published_gains(
    name: str, which: str, tmp_path: Path
) -> None:
    source = catalogue.BUNDLED
    copy = tmp_path / f"{which}.urdf"
    shutil.copy(source / copy.name, copy)
    with refused("gains", None):
        CONTROLLERS[name](softdyn.load(copy))


@every_published
@pytest.mark.parametrize("gains", [5.0, "500", {"Kp": 500}, (500,), [], object(), Gains])
def test_gains_of_another_kind_are_refused(name: str, gains: object) -> None:
    with refused("gains"):
        CONTROLLERS[name](robot("finger"), gains)


@pytest.mark.parametrize("law", [*CONTROLLERS.values(), *BEYOND.values(), Staged])
def test_what_is_no_model_is_refused(law: Any) -> None:
    with refused("model", "'finger'"):
        law("finger")


@every_published
def test_a_robot_without_inputs_is_refused(name: str, tmp_path: Path) -> None:
    text = catalogue.BUNDLED.joinpath("finger.urdf").read_text()
    lines = [line for line in text.splitlines() if "<actuator" not in line]
    path = robots.write(tmp_path, "\n".join(lines), "passive.urdf")
    with refused("model", "none"):
        CONTROLLERS[name](softdyn.load(path), GAINS)


@every_published
@pytest.mark.parametrize(
    "gains",
    [
        Gains(Kp=1e-300),
        Gains(Kp=1e300),
        Gains(Kp=1e12, eps=1e-9),
        Gains(Kp=100, eps=1e6),
        Gains(Kp=100, w1=0, w2=0, w3=0, w4=0),
        Gains(Kp=100, w1=1e-12, w2=1e12, w3=1e-12, w4=1e12),
        Gains(Kp=100, w1=1e200, rho=1e-200),
        Gains(Kp=100, rho=1e15, null_damping=1e9),
        Gains(Kp=100, null_damping=0),
    ],
)
def test_any_gains_keep_the_contract(name: str, gains: Gains) -> None:
    for which in ("finger", "spirob", "two identical tendons"):
        try:
            controller = CONTROLLERS[name](robot(which), gains)
        except SoftdynError:
            continue
        for state, reference in drawn(which)[:6]:
            ask(controller, robot(which), state, reference)


@pytest.mark.parametrize("name", [*CLASSES, "best", "mpc"])
def test_the_guard_is_the_only_way_in(name: str) -> None:
    """With a State of another robot, compiled kernels would read beyond their arrays."""
    controller = BEYOND[name](robot("spirob")) if name == "mpc" else build(name, "spirob")
    other, goal = drawn("finger")[4]
    parts = (*getattr(controller, "stages", ()), *vars(controller).values())
    for one in (controller, *(part for part in parts if isinstance(part, GuardedController))):
        public = {key: getattr(one, key) for key in dir(one) if not key.startswith("_")}
        methods = {key for key, value in public.items() if inspect.ismethod(value)}
        # those without a State
        assert methods - {"follow", "among", "applied", "prepare"} == {"reset"}
        with refused("state", "one of 'finger' with 2 inputs, of …"):
            one(other, goal)


def test_the_guard() -> None:
    u_min, u_max = np.array([-1.0, 2.0]), np.array([1.0, 3.0])
    guard = InputGuard(u_min, u_max)
    np.testing.assert_array_equal(guard.fall_back(Status.NOT_SOLVED, 1.0, 0.0).u, [0.0, 2.0])
    assert (guard.fallbacks, guard.not_solved) == (1, 1)

    good = guard.accept(np.array([0.5, 2.5]), 1.0, 0.0)
    assert good.status is Status.OK
    over = guard.accept(np.array([0.5, 3.25]), 1.0, 0.0)
    np.testing.assert_array_equal(over.u, [0.5, 3.0])
    assert guard.max_bound_violation == 0.25
    guard.accept(np.array([9.0, 9.0]), 1.0, 0.0, clamped=True)  # saturation by design
    assert guard.max_bound_violation == 0.25

    for bad in (np.nan, np.inf, -np.inf):
        held = guard.accept(np.array([bad, 2.5]), 1.0, 0.0)
        assert held.status is Status.NON_FINITE
        np.testing.assert_array_equal(held.u, [1.0, 3.0])
    assert (guard.fallbacks, guard.not_solved) == (4, 1)
    with pytest.raises(ValueError, match="read-only"):
        good.u[0] = 7.0
    for u in (np.zeros(1), np.zeros(3)):
        with refused("u"):
            guard.accept(u, 1.0, 0.0)


def test_the_guard_admits_the_answers_of_any_controller() -> None:
    guard = InputGuard(np.array([-1.0, 2.0]), np.array([1.0, 3.0]))
    command = guard.accept(np.array([5.0, 2.5]), 1.0, 0.0, clamped=True)
    assert guard.admit(command.u) is command.u  # checked and clipped once
    assert guard.max_bound_violation == 0.0
    np.testing.assert_array_equal(guard.admit([0, 2]), [0.0, 2.0])
    np.testing.assert_array_equal(guard.admit([-1.5, 2.25]), [-1.0, 2.25])
    assert guard.max_bound_violation == 0.5
    for bad in ([0.0], [0.0, np.nan], [[0.0, 2.0]], "up", None):
        with refused("u"):
            guard.admit(bad)
