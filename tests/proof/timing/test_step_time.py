"""Step times: the report, its states, and robots of any size. No time is judged."""

from __future__ import annotations

import json

import numpy as np
import pytest

import softdyn
from softdyn.controllers import BEYOND, CONTROLLERS, SoftIdClfQp
from tests.proof import hostile
from tests.proof.throughput import throughput
from tests.proof.timing.recording import record
from tests.proof.timing.step_time import Subject, measure
from tests.support.command import proof
from tests.support.paper_qps import PAPER_QPS, PrintedLaw
from tests.support.qp_solvers import Scs

CONTRACT = {
    "robot", "controller", "median_us", "p99_us", "p999_us", "floor_us", "stack_us", "ratio",
}  # fmt: skip


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


@pytest.fixture(scope="module")
def states(finger):
    return record(finger, SoftIdClfQp, 25, duration=0.6)


def test_the_command_times_the_states_it_finds(states, tmp_path):
    file = tmp_path / "states" / "finger.npz"
    file.parent.mkdir()
    states.save(file)
    before = file.stat().st_mtime_ns
    controllers = ("--controllers", "soft-id-clf-qp", "uic")
    done = proof("step-time", "--robots", "finger", *controllers, "--states", 25, "--rounds", 2,
                   "--no-stack", "--out", tmp_path, "--json", "-")  # fmt: skip
    assert done.code == 0, done.err
    assert file.stat().st_mtime_ns == before
    rows = json.loads(done.out)["rows"]
    assert [row["controller"] for row in rows] == ["soft-id-clf-qp", "uic"]
    for row in rows:
        assert set(row) >= CONTRACT
        assert row["stack_us"] is None
        assert row["ratio"] is None
        assert row["floor_us"] > 0
        assert 0 < row["median_us"] <= row["p99_us"] <= row["p999_us"]
        assert (row["solver_us"] > 0) == (row["controller"] == "soft-id-clf-qp")
        assert (row["states"], row["samples"]) == (25, 50)
    for name in ("step_time.pdf", "step_time.png", "step_time.md", "step_time.json"):
        assert (tmp_path / name).stat().st_size > 0


def test_bad_input_is_one_line(tmp_path):
    for arguments in (("--robots", "nobody"), ("--controllers", "nobody"), ("--states", "0")):
        code, _, err = proof("step-time", *arguments, "--out", tmp_path)
        assert code == 2
        assert err.startswith("error: ")
        assert err.count("\n") == 1


def test_parts_and_floor(finger, states):
    laws = {**CONTROLLERS, **BEYOND}
    subjects = {
        name: Subject(finger, laws[name], states.steps())
        for name in ("soft-id-clf-qp", "ic", "best", "mpc")
    }
    rounds = []
    times = measure(subjects, 3, lambda: rounds.append(None))
    assert len(rounds) == 3
    for name, found in times.items():
        assert found.step.shape == found.engine.shape == (3, 25)
        assert (found.dynamics > 0).all()
        assert (found.law > 0).all()
        assert (found.engine > 0).all()
        solves = name != "ic"
        assert ((found.solve > 0) == solves).all()
        assert ((found.native > 0) == solves).all()
        row = found.row()
        parts = row["dynamics_us"] + row["assembly_us"] + row["solve_us"]
        assert parts == pytest.approx(row["median_us"], rel=0.5)


def test_the_papers_stack_finds_the_same_inputs(finger, states):
    pytest.importorskip("cvxpy")
    scale = finger.u_max - finger.u_min
    for name, write in PAPER_QPS.items():
        ours = CONTROLLERS[name](finger)
        # cvxpy's default accuracy with the reference's formulation, and the best accuracy of SCS
        for quadratic, accuracy, tolerance in ((False, None, 1e-2), (True, 1e-9, 1e-5)):
            solver = Scs(quadratic=quadratic, accuracy=accuracy)
            stack = PrintedLaw(write, ours.gains, solver)
            errors = []
            for q, v, reference in states.steps()[1::8]:
                state = finger.state(q, v)
                difference = ours(state, reference).u - stack(state, reference)["u"]
                errors.append(np.abs(difference / scale).max())
            # the CLF-QP of a straight finger has more than one minimiser
            unique = name != "clf-qp" and accuracy is not None
            assert (np.max if unique else np.median)(errors) < tolerance


def test_throughput(finger):
    row = throughput(finger, "ic-qp", duration=0.2, repeats=1)
    assert (row["control_steps"], row["plant_steps"]) == (40, 400)
    parts = ("setup", "state", "controller", "mujoco", "bookkeeping")
    assert sum(row[f"{part}_s"] for part in parts) == pytest.approx(row["wall_s"])
    assert row["times_real_time"] == pytest.approx(0.2 / row["wall_s"])


def test_the_benchmark_of_the_worst_step(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--robots", "finger", "--controllers", "ic", "--rounds", "1"]
    assert hostile.main(arguments) in (0, 1)  # the time is a measurement, not a test
    out = capsys.readouterr().out
    assert out.startswith("robot ")
    assert "0 answers not finite or out of bounds" in out
