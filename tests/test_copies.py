"""Every public object survives copying and pickling, before and after use, or says that it cannot.

A copy is like its original, gives the same results, and shares nothing that a use changes.
"""

import copy
import enum
import inspect
import multiprocessing
import pickle
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, is_dataclass

import joblib
import numpy as np
import pytest

import softdyn
from softdyn import (
    actuation,
    controllers,
    design,
    estimation,
    safety,
    sensing,
    statics,
    tasks,
    validation,
)
from softdyn.copies import Frozen
from softdyn.validation import Log, paper, simulate
from softdyn.view.live.channel import Channel
from tests.support import PATIENCE
from tests.support.control_cases import drawn, robot
from tests.support.public_objects import LAWS, Uses, objects

ROOMS = (
    softdyn, actuation, controllers, design, estimation, safety, sensing, statics, tasks,
    validation,
)  # fmt: skip
COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
}
every_copy = pytest.mark.parametrize("duplicate", COPIES.values(), ids=COPIES)
RUN = paper.set_point("finger", 0.5)


def public_classes():
    """The classes of all public rooms of which a user can hold objects."""
    every = [getattr(room, name) for room in ROOMS for name in room.__all__]
    kinds = (enum.Enum, BaseException)
    return {
        one for one in every
        if inspect.isclass(one) and not issubclass(one, kinds) and not inspect.isabstract(one)
        and not vars(one).get("_is_protocol")
    }  # fmt: skip


def facts(value):
    """What a user sees of a value: its public attributes."""
    if isinstance(value, np.ndarray):
        return value.shape, str(value.dtype), value.tobytes()  # NaN is not equal to itself
    if isinstance(value, softdyn.SoftModel):
        return value.robot.digest
    if isinstance(value, dict):
        return {name: facts(one) for name, one in value.items()}
    if isinstance(value, tuple | list):
        return [facts(one) for one in value]
    if is_dataclass(value):  # without what is computed on first use
        return {field.name: facts(getattr(value, field.name)) for field in fields(value)}
    if not hasattr(value, "__dict__") or type(value).__module__ in sys.stdlib_module_names:
        shown = type(value).__repr__ is not object.__repr__ and "lock" not in repr(value)
        return repr(value) if shown else type(value).__name__
    return {name: facts(one) for name, one in vars(value).items() if name[:1] != "_"}


@pytest.fixture(scope="module")
def held():
    """Every object, each with a way to use it."""
    return objects(Uses())


def test_every_public_class_is_here(held):
    left = public_classes() - {kind for one, _ in held for kind in type(one).__mro__}
    assert not left, "give tests/support/public_objects.py an object of each"


@every_copy
def test_copies_are_alike_at_any_time(held, duplicate):
    for original, use in held:
        what = type(original).__name__
        for _ in range(2):  # before and after use
            other = duplicate(original)
            assert type(other) is type(original)
            assert facts(other) == facts(original), what
            later = duplicate(other)
            expected = facts(use(original))
            assert facts(use(other)) == expected, what
            assert facts(use(later)) == expected, what


def test_copies_in_threads(held):
    """They share nothing that a use changes; models and data may be shared anyway."""
    for original, use in held:
        expected = facts(use(copy.deepcopy(original)))
        others = [copy.deepcopy(original) for _ in range(4)]
        with ThreadPoolExecutor(4) as pool:
            assert [facts(found) for found in pool.map(use, others)] == [expected] * 4


def test_copies_in_processes(held):
    chosen = [(one, use) for one, use in held if use.__name__ != "look"]
    expected = [facts(use(copy.deepcopy(one))) for one, use in chosen]
    job = joblib.delayed(lambda one, use: facts(use(one)))
    assert joblib.Parallel(2)(job(*each) for each in chosen) == expected


@every_copy
def test_read_only_arrays_stay_so(held, duplicate):
    for original, _ in held:
        if isinstance(original, Frozen | softdyn.SoftModel | softdyn.State | Log):
            other = duplicate(original)
            for name, value in vars(original).items():
                if isinstance(value, np.ndarray):
                    assert getattr(other, name).flags.writeable == value.flags.writeable, name
    estimate = duplicate(next(one for one, _ in held if isinstance(one, estimation.Estimate)))
    assert not estimate.disturbances["tip_force"].flags.writeable


@every_copy
@pytest.mark.parametrize("name", sorted(LAWS))
def test_a_copied_law_answers_as_the_first(name, duplicate):
    for which in ("finger", "spirob"):
        law = LAWS[name](robot(which))
        (first, goal), (second, other_goal), *_ = drawn(which)
        law(first, goal)
        twins = [duplicate(law) for _ in range(2)]
        for twin in twins:
            assert np.isfinite(twin(second, other_goal).u).all()
            twin.reset(0.005)
        law.reset(0.005)
        expected = law(second, other_goal).u.copy()
        for twin in twins:
            twin.reset(0.005)
            np.testing.assert_array_equal(twin(second, other_goal).u, expected)
        del law, twins  # this frees memory that a shallow copy would still use
        model = duplicate(robot(which))
        assert np.isfinite(model.state(model.q0, np.zeros(model.nv)).M).all()


@pytest.mark.parametrize("backend", ["loky", "threading"])
@pytest.mark.parametrize("name", ["soft-id-clf-qp", "best", "uic"])
def test_one_law_for_several_runs_at_once(name, backend):
    model = robot("finger")
    law = LAWS[name](model)
    alone = simulate(model, law, RUN, duration=0.1)
    runs = joblib.Parallel(2, backend=backend)(
        joblib.delayed(simulate)(model, law, RUN, duration=0.1) for _ in range(4)
    )
    for log in runs:
        np.testing.assert_array_equal(log.u, alone.u)
        assert (log.fallbacks, log.not_solved) == (alone.fallbacks, alone.not_solved)


def _state_in_child(queue, model, law, state, goal):
    again = model.state(state.q, state.v)
    queue.put((again.h, law(state, goal).u, law(again, goal).u))


def test_fork():
    model, (state, goal) = robot("finger"), drawn("finger")[0]
    law = LAWS["soft-id-clf-qp"](model)
    expected = law(state, goal).u
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_state_in_child, args=(queue, model, law, state, goal))
    child.start()
    h, *inputs = queue.get(timeout=PATIENCE)
    child.join(timeout=PATIENCE)
    np.testing.assert_array_equal(h, state.h)
    for u in inputs:
        np.testing.assert_allclose(u, expected, rtol=1e-9, atol=1e-12)


def test_one_model_in_many_threads():
    model = robot("spirob")
    cases = [state for state, _ in drawn("spirob")[:8]]

    def ask(state):
        for _ in range(40):
            again = model.state(state.q, state.v)
            assert np.array_equal(again.M, state.M)
            assert np.array_equal(again.h, state.h)
            assert np.array_equal(again.B, state.B)
            assert np.isfinite(model.forward_dynamics(state.q, state.v, np.zeros(3))).all()
        return True

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(ask, cases))


@every_copy
def test_what_cannot_be_copied_says_so(duplicate):
    with (
        Channel("<p>a page</p>") as channel,
        pytest.raises(TypeError, match=r"Channel|live"),
    ):
        duplicate(channel)


def test_a_saved_log_is_the_log(tmp_path, held):
    log = next(value for value, _ in held if isinstance(value, Log))
    log.save(tmp_path / "run.npz")
    again = pickle.loads(pickle.dumps(Log.load(tmp_path / "run.npz")))
    assert facts(again) == facts(log)
