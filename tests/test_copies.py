"""Every public object survives copying and pickling, or raises an error that says it cannot."""

import copy
import multiprocessing
import pickle
from concurrent.futures import ThreadPoolExecutor

import joblib
import numpy as np
import pytest

import softdyn
from softdyn.controllers import BEYOND, CONTROLLERS, Command, Gains
from softdyn.validation import Log, StateMap, Twin, paper, simulate
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.studies.engine.case import Case
from softdyn.view.rest_sweep import rest_page
from softdyn.view.server import Viewer
from tests.support import PATIENCE
from tests.support.control_cases import drawn, robot

LAWS = {**CONTROLLERS, **BEYOND}
COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
}
every_copy = pytest.mark.parametrize("duplicate", COPIES.values(), ids=COPIES)
RUN = paper.set_point("finger", 0.5)


@pytest.fixture(scope="module")
def held():
    """One object of each kind, made as by a user."""
    model = robot("finger")
    twin = Twin(model)
    controller = CONTROLLERS["soft-id-clf-qp"](model)
    return [
        model, model.robot, model.state(model.q0, np.zeros(4)), softdyn.SetPoint([0.1, 0, 0.1]),
        softdyn.Ellipse(0.1, 0.1, 0.1, omega=0.1), twin, StateMap(model, twin), RUN, Gains(Kp=1.0),
        Command(np.zeros(2)), simulate(model, controller, RUN, duration=0.02),
        ClosedLoop(model, controller, RUN, duration=0.02), Case("finger", "ic", "set_point", 0.5),
        softdyn.load("spirob48"), rest_page(model),
    ]  # fmt: skip


@every_copy
def test_copies_are_alike_and_read_only(held, duplicate):
    for original in held:
        other = duplicate(original)
        assert type(other) is type(original)
        for name, value in vars(original).items() if hasattr(original, "__dict__") else ():
            if isinstance(value, np.ndarray) and not hasattr(original, "pin_model"):
                np.testing.assert_array_equal(getattr(other, name), value)
                assert getattr(other, name).flags.writeable == value.flags.writeable, name


@every_copy
@pytest.mark.parametrize("name", sorted(LAWS))
def test_a_copied_law_answers_as_the_first(name, duplicate):
    for which in ("finger", "spirob"):
        law = LAWS[name](robot(which))
        (first, goal), (second, other_goal), *_ = drawn(which)
        law(first, goal)
        twins = [duplicate(law) for _ in range(2)]
        if duplicate is copy.copy:  # shares what a run changes
            twins = twins[:1]
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
        Viewer(rest_page(robot("finger"))) as viewer,
        pytest.raises(TypeError, match=r"Viewer|live"),
    ):
        duplicate(viewer)


def test_a_saved_log_is_the_log(tmp_path, held):
    log = next(value for value in held if isinstance(value, Log))
    log.save(tmp_path / "run.npz")
    again = pickle.loads(pickle.dumps(Log.load(tmp_path / "run.npz")))
    for name, value in vars(log).items():
        np.testing.assert_array_equal(getattr(again, name), value)
