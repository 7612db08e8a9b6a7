"""After a fallback the problem is kept, and another solver can solve it."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
import quadprog

from softdyn import SetPoint
from softdyn.controllers import CONTROLLERS, Mpc, SafetyFilter, SoftIdClfQp, Status, clf_qp
from softdyn.controllers.qps.qp import DenseQp
from softdyn.safety import HalfSpace
from softdyn.tasks import AxisTask, PointTask
from tests.support.command import command
from tests.support.control_cases import recorded, robot
from tests.support.refused import refused

QPS = ("soft-id-clf-qp", "id-clf-qp", "ic-qp", "clf-qp")
PUSH = """
class Push:
    def __init__(self, model):
        self.u = model.u_max
    def __call__(self, state, reference):
        return self.u
"""


@pytest.fixture
def unsolved(monkeypatch):
    """Let every answer of the solvers count as not solved."""
    solve, law = DenseQp.solve, clf_qp._law

    def fails():
        monkeypatch.setattr(DenseQp, "solve", lambda *a: solve(*a)._replace(primal=1.0))
        monkeypatch.setattr(clf_qp, "_law", lambda *a: (1.0, law(*a)[1]))

    return fails


def solved_elsewhere(found):
    """The minimiser by quadprog, which takes rows ≥ bound."""
    H, g, A, lower, upper = (np.array(found[name]) for name in ("H", "g", "A", "lower", "upper"))
    above, below = np.isfinite(lower), np.isfinite(upper)
    rows = np.vstack((A[above], -A[below]))
    bounds = np.concatenate((lower[above], -upper[below]))
    return quadprog.solve_qp(H, -g, rows.T, bounds)[0]


@pytest.mark.parametrize("which", ["finger", "spirob"])
@pytest.mark.parametrize("name", QPS)
def test_another_solver_finds_the_input_from_the_file(name, which, unsolved, tmp_path):
    model = robot(which)
    law, (state, goal) = CONTROLLERS[name](model), recorded(which)[5]
    u = law(state, goal).u
    assert law.failed_problem is None
    unsolved()
    command = law(state, goal)
    assert command.status is Status.NOT_SOLVED
    law.failed_problem.save(tmp_path / "failed.npz")
    with np.load(tmp_path / "failed.npz") as found:
        found = dict(found)
    np.testing.assert_allclose(
        solved_elsewhere(found)[: model.nu], u, atol=1e-6 * np.ptp([model.u_min, model.u_max])
    )
    assert (str(found["status"]), str(found["robot"])) == ("not solved", model.name)
    for key, value in (("q", state.q), ("v", state.v), ("y", goal.y), ("u_max", model.u_max)):
        np.testing.assert_array_equal(found[key], value)
    law.reset(0.01)
    assert law.failed_problem is None


def test_predictive_control_keeps_the_changes_of_the_inputs(unsolved):
    model = robot("finger")
    law, (state, goal) = Mpc(model), recorded("finger")[5]
    first = law(state, goal).u
    law.reset(0.002)
    unsolved()
    assert law(state, goal).status is Status.NOT_SOLVED
    found = law.failed_problem
    assert found.state is state
    assert found.reference is goal
    x = solved_elsewhere(found.arrays())[: model.nu]
    share = law.period / (0.3 / 30)  # of the first knot, as the command moves along its ramp
    np.testing.assert_allclose(share * x, first, atol=1e-6)


def test_tasks_in_levels_keep_the_level_that_failed_and_their_targets(unsolved, tmp_path):
    model = robot("spirob")
    law = SoftIdClfQp(model, tasks=[PointTask("tip"), AxisTask("tip", [0, 0, 1], level=1)])
    state, goal = recorded("spirob")[5]
    unsolved()
    assert law(state, goal).status is Status.NOT_SOLVED
    found = law.failed_problem
    assert found.H.shape == (len(found.g),) * 2
    assert found.A.shape == (
        len(found.lower),
        len(found.g),
    )
    assert found.state is state


def test_numbers_that_are_not_finite_are_kept_too():
    model = robot("finger")
    state, goal = recorded("finger")[5]
    broken = replace(state, h=np.full(model.nv, np.nan))
    for name, size in (("soft-id-clf-qp", 1), ("clf-qp", 1), ("ic", 0)):
        law = CONTROLLERS[name](model)
        assert law(broken, goal).status is Status.NON_FINITE
        found = law.failed_problem
        assert found.state is broken
        assert bool(len(found.g)) == bool(len(found.lower)) == bool(size)
        assert found.status == "non-finite"


def test_a_later_call_does_not_change_what_was_kept(unsolved):
    law, pairs = SoftIdClfQp(robot("finger")), recorded("finger")
    unsolved()
    law(*pairs[5])
    kept = law.failed_problem
    H = kept.H.copy()
    law(*pairs[6])
    np.testing.assert_array_equal(kept.H, H)
    assert kept.state is pairs[5][0]
    assert law.failed_problem.state is pairs[6][0]
    for other in (copy.deepcopy(law), pickle.loads(pickle.dumps(law))):
        np.testing.assert_array_equal(other.failed_problem.H, law.failed_problem.H)


def test_a_wrapper_gives_its_controllers_problem(unsolved):
    model = robot("finger")
    law = SafetyFilter(SoftIdClfQp(model), model, [HalfSpace([0, 0, 1], -9.0)])
    unsolved()
    law(*recorded("finger")[5])
    assert law.failed_problem is law.inner.failed_problem is not None


def test_run_keeps_each_in_a_file(unsolved, tmp_path):
    unsolved()
    words = ("run", "finger", "soft-id-clf-qp", "--theta", "0.5", "--duration", "0.02")
    done = command(*words, "--keep-failed", "kept", "--json", "run.json", cwd=tmp_path)
    files = sorted((tmp_path / "kept").iterdir())
    assert len(files) == 4
    assert "4 failed problems" in done.out + done.err
    with np.load(files[-1]) as found:
        assert solved_elsewhere(found).shape == found["g"].shape
        assert float(found["t"]) == pytest.approx(0.015)


def test_run_keeps_nothing_where_all_is_solved_and_refuses_what_has_no_problem(tmp_path):
    words = ("run", "finger", "soft-id-clf-qp", "--theta", "0.5", "--duration", "0.02")
    command(*words, "--keep-failed", "kept", cwd=tmp_path)
    assert not (tmp_path / "kept").exists()
    (tmp_path / "mine.py").write_text(PUSH)
    words = ("run", "finger", "mine.py:Push", *words[3:])
    done = command(*words, "--keep-failed", "kept", cwd=tmp_path)
    assert done.code == 2
    assert "failed_problem" in done.err


def test_a_folder_that_cannot_be_written_is_named(unsolved, tmp_path):
    law = SoftIdClfQp(robot("finger"))
    unsolved()
    law(recorded("finger")[5][0], SetPoint([0.1, 0.0, -0.1]))
    with refused("x.npz", "No such file or directory"):
        law.failed_problem.save(tmp_path / "none" / "x.npz")
