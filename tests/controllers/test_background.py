"""Searches that no control step waits for."""

from __future__ import annotations

import copy
import math
import os
import pickle
import subprocess
import sys
import time
import types
from functools import cache, partial

import numpy as np
import psutil
import pytest

from softdyn import Ellipse, SetPoint, load, statics
from softdyn.controllers import Compensated, SafetyFilter, SoftIdClfQp, best
from softdyn.controllers.barriers import JointLimits
from softdyn.controllers.controller import waiting
from softdyn.controllers.predictive import rest_target
from softdyn.controllers.predictive.background import Job
from softdyn.controllers.predictive.rest_target import RestTargets
from softdyn.controllers.predictive.supervisor import ARRIVES, STUCK
from softdyn.validation import Rig, paper, simulate
from softdyn.validation.twin.plant_errors import PlantErrors
from tests.support.refused import refused

GOAL = SetPoint([0.17, 0.0, -0.14])  # that a robot that does not move misses
T = 0.01
PATIENCE = 300.0  # s, on a loaded machine


def test_work_is_done_in_another_process() -> None:
    there = Job(os.getpid).result(PATIENCE)
    assert there != os.getpid()
    here = Job(os.getpid, waits=True)
    assert pickle.loads(pickle.dumps(here)).result() == here.result() == os.getpid()


def test_work_that_another_process_cannot_load_is_done_here(monkeypatch) -> None:
    assert Job(lambda: os.getpid()).result(PATIENCE) == os.getpid()  # cannot be pickled
    own = types.ModuleType("only_here")
    exec("import os\ndef pid(): return os.getpid()", vars(own))
    monkeypatch.setitem(sys.modules, "only_here", own)
    assert Job(own.pid).result(PATIENCE) == os.getpid()


def test_work_that_fails_or_is_ended_is_an_error(capfd) -> None:
    with pytest.raises(RuntimeError, match="ended with 1"):
        Job(partial(int, "x")).result(PATIENCE)
    assert "ValueError" in capfd.readouterr().err
    long = Job(partial(time.sleep, PATIENCE))
    long.cancel()
    with pytest.raises(RuntimeError, match="ended with"):
        long.result(PATIENCE)


PARENT = """
import time
from functools import cache, partial
from softdyn.controllers.predictive.background import Job

job = Job(partial(time.sleep, 600))
while job._process is None:
    time.sleep(0.01)
print(job._process.pid, flush=True)
input()
"""


@pytest.mark.parametrize("end", ["exit", "kill"])
def test_the_process_ends_with_its_parent(end: str) -> None:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", PARENT], text=True, **pipes) as parent:  # type: ignore[call-overload]
        child = psutil.Process(int(parent.stdout.readline()))
        assert child.is_running()
        if end == "kill":
            parent.kill()
        else:
            parent.stdin.write("\n")
            parent.stdin.close()
    child.wait(PATIENCE)


@pytest.fixture
def jobs(monkeypatch) -> list[Job]:
    """The jobs that targets start, while no search may begin in this process."""
    started: list[Job] = []

    class Counted(Job):
        def __init__(self, work) -> None:
            super().__init__(work)
            started.append(self)

    def refuse(*_given, **_options):
        raise AssertionError("a search in the process of the control loop")

    monkeypatch.setattr(rest_target, "Job", Counted)
    bent()
    for name in ("inputs_for_tip", "inputs_for_tasks", "approach"):
        monkeypatch.setattr(statics, name, refuse)
    return started


@cache
def bent() -> np.ndarray:
    """The shape of the finger's target."""
    found = rest_target.targets_of(load("finger"), GOAL.y, (), None, math.inf)
    return found[0].q


def test_a_target_with_all_joints_at_their_stops_is_found():
    """Such an equilibrium has no pole."""
    model = load("finger")
    curled = statics.settle(model, [-0.3, -0.3])
    assert curled.held.all()
    found = rest_target.targets_of(model, curled.y, (), None, 10.0)
    assert found[0].distance < 1e-3


def calls(controller, model, reference, count: int) -> list:
    """The commands of an own loop in which the robot does not move; the finger is 0.15 rad in all
    joints from the shape that holds the goal.
    """
    q = bent() + 0.15 if model.name == "finger" else model.q0
    state = model.state(q, np.zeros(model.nv))
    return [controller(state, reference) for _ in range(count)]


@pytest.mark.parametrize("reachable", [True, False])
def test_no_call_of_an_own_loop_searches(jobs, reachable: bool) -> None:
    model = load("spirob")  # of which nothing is known yet
    controller = best(model, lag=0.01)
    controller.reset(0.002)
    y = paper.set_point("spirob", 0.25).reference(0.0).y if reachable else np.array([0.0, 0.3, 0.3])
    commands = calls(controller, model, SetPoint(y), 1500)
    assert len(jobs) == 1  # asked for once, and not waited for
    assert controller.planning
    assert not np.isfinite([one.distance for one in commands]).any()
    jobs[0].cancel()


def test_a_target_acts_once_its_search_is_over(jobs) -> None:
    model = load("finger")
    controller = best(model)
    controller.reset(T)
    steps = round(STUCK / T)
    assert not jobs
    calls(controller, model, GOAL, steps + 2)
    jobs[0].result(PATIENCE)
    commands = calls(controller, model, GOAL, round(ARRIVES / T) + 3)
    found = np.isfinite([one.distance for one in commands])
    assert found[-1]
    assert not found[: round(ARRIVES / T) - 3].any()
    assert len(jobs) == 1
    assert not controller.planning


def test_another_set_point_replaces_the_search(jobs) -> None:
    model = load("finger")
    targets = RestTargets(model)
    assert targets.find(GOAL.y, waits=False) is None
    assert targets.find(GOAL.y, waits=False) is None
    assert targets.find(GOAL.y + 0.1, waits=False) is None
    assert len(jobs) == 2
    with pytest.raises(RuntimeError):
        jobs[0].result(PATIENCE)
    jobs[1].cancel()


def test_a_loop_goes_on_where_a_search_fails(monkeypatch, jobs) -> None:
    model = load("finger")
    controller = best(model)
    controller.reset(T)
    calls(controller, model, GOAL, round(STUCK / T) + 2)
    jobs[0].cancel()
    with pytest.raises(RuntimeError):
        jobs[0].result(PATIENCE)
    with pytest.warns(UserWarning, match="a search failed: its process ended"):
        commands = calls(controller, model, GOAL, round(2 * ARRIVES / T))
    assert np.isfinite([one.u for one in commands]).all()


def test_a_prepared_loop_has_its_target_at_a_stated_step(monkeypatch) -> None:
    monkeypatch.setattr(rest_target, "Job", None)  # none may be started
    model = load("finger")
    controller = best(model)
    for reference in (Ellipse(0.08, 0.03, 0.1, omega=0.4), GOAL, GOAL):
        controller.prepare(reference)
    controller.reset(T)
    found = np.isfinite([one.distance for one in calls(controller, model, GOAL, 160)])
    assert abs(np.flatnonzero(found)[0] - (STUCK + ARRIVES) / T) <= 1
    for laws in (best(model), SoftIdClfQp(model)):
        with refused("reference", "[0.0, 0.0, 1.0]"):
            laws.prepare([0.0, 0.0, 1.0])


def test_runs_are_equal_and_the_log_has_the_step_of_the_target() -> None:
    """Two runs of a finger that friction holds, the second while another loop's search goes on."""
    model = load("finger")
    controller = best(model)
    run = partial(simulate, model, reference=GOAL, q0=bent() + 0.15, period=T, duration=1.6,
                  rig=Rig(plant=PlantErrors(dry_friction=10.0)))  # fmt: skip
    one = run(controller)
    assert controller.waits is False  # it waits in a simulation only
    (step,) = one.found_at
    assert abs(step - (STUCK + ARRIVES) / T) <= 1
    other = load("finger")
    own = best(other)
    own.reset(T)
    calls(own, other, GOAL, round(STUCK / T) + 2)
    assert own.planning
    again = simulate(other, own, **(run.keywords))
    np.testing.assert_array_equal(one.u, again.u)
    np.testing.assert_array_equal(one.distance, again.distance)
    plain = simulate(model, SoftIdClfQp(model), GOAL, period=T, duration=0.1)
    assert plain.distance is None
    assert plain.found_at == ()


def test_wrappers_pass_on_what_prepares_and_what_waits() -> None:
    model = load("finger")
    inner = best(model)
    around = SafetyFilter(Compensated(inner, model, lag=0.01), model, [JointLimits(model)])
    around.prepare(GOAL)
    assert rest_target._KNOWN[model]
    with waiting(around):
        assert inner.waits is True
    assert around.waits is inner.waits is False

    class Own:
        def __call__(self, state, reference):
            return np.zeros(2)

    plain = Compensated(Own(), model)
    plain.prepare(GOAL)
    with waiting(plain):
        assert plain.waits is False
    with waiting(Own()):
        pass


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy,
                                       lambda one: pickle.loads(pickle.dumps(one))])  # fmt: skip
def test_a_controller_is_copied_while_it_searches(jobs, duplicate) -> None:
    model = load("finger")
    controller = best(model)
    controller.reset(T)
    calls(controller, model, GOAL, round(STUCK / T) + 2)
    other = duplicate(controller)
    np.testing.assert_array_equal(
        calls(other, model, GOAL, 1)[0].u, calls(duplicate(controller), model, GOAL, 1)[0].u
    )
    for job in jobs:
        job.cancel()
