"""A sweep's results, independent of the number of workers and of interruptions, and its tables."""

import csv
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn.controllers import Gains, Mpc, best
from softdyn.validation import Log, paper, simulate
from softdyn.validation.studies import sweep, sweep_report
from softdyn.validation.studies.engine import executors, fingerprint, worker
from softdyn.validation.studies.sweep_file import read_sweep
from tests.support import PATIENCE, SCRIPTS
from tests.support.sweeps import FINGER, OWN, OWN_SWEEP, contents, results, wait_for

# -- what it leaves behind -------------------------------------------------------------------------


def test_results_are_those_of_simulate(folder, call):
    (folder / "sweep.toml").write_text("logs = true\n" + FINGER + "Kp = [100, 300]\n")
    code, out, _ = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert code == 0
    report = json.loads(out)
    assert (report["cases"], report["ran"], report["kept"]) == (4, 4, 0)
    table = list(csv.DictReader(Path("out/sweep.csv").read_text().splitlines()))
    model = softdyn.load("finger")
    for result in results(Path("out")):
        inputs = result["inputs"]
        from softdyn.controllers import Impedance

        log = simulate(
            model,
            Impedance(model, Gains(**inputs["gains"])),
            paper.set_point("finger", inputs["target"]),
            duration=0.2,
        )
        assert result["final_error_cm"] == 100 * float(np.linalg.norm(log.error[-1]))
        assert result["outcome"] == ("failed" if log.failed else "done")
        found = log.verdict()
        row = next(row for row in table if float(row["final_error_cm"]) == log.final_error_cm)
        assert row["settling_time_s"] == (
            "" if found.settling_time is None else str(found.settling_time)
        )
        assert float(row["overshoot"]) == found.overshoot
        share = log.u / np.maximum(-model.u_min, model.u_max)
        assert float(row["input_effort"]) == pytest.approx(np.sqrt(np.mean(share**2)))
    (path, *_) = sorted(Path("out").rglob("*.npz"))
    assert Log.load(path).duration == 0.2
    best = min(results(Path("out")), key=lambda r: (r["outcome"] != "done", r["final_error_cm"]))
    assert report["best"][0]["inputs"] == best["inputs"]


def test_a_failing_case_is_recorded_and_stops_nothing(folder, call):
    (folder / "sweep.toml").write_text(OWN_SWEEP.format(stiffness="[1, 13, 2, 3, 66, -2]"))
    code, out, err = call(folder / "sweep.toml", "--out", "out", "--jobs", 2, "--json", "-")
    assert code == 1  # one raised, and one could not be run
    report = json.loads(out)
    assert report["outcomes"]["raised"] == report["outcomes"]["not_run"] == 1
    found = {r["inputs"]["gains"]["stiffness"]: r for r in results(Path("out"))}
    assert len(found) == 6
    assert found[13.0]["outcome"] == "raised"
    line = 1 + OWN.splitlines().index('            raise ZeroDivisionError("thirteen")')
    assert found[13.0]["reason"] == f"own.py:{line}: ZeroDivisionError: thirteen"
    assert f'Traceback (most recent call last):\n  File "{folder}/own.py", line {line}, in' in err
    assert err.endswith("\nZeroDivisionError: thirteen\n")
    assert (found[66.0]["outcome"], found[66.0]["reason"]) == ("not_run", executors.DIED)
    assert {found[k]["outcome"] for k in (1.0, 2.0, 3.0)} == {"done"}
    assert found[-2.0]["outcome"] == "failed"
    assert "no convergence" in found[-2.0]["reason"]

    table = list(csv.DictReader(Path("out/sweep.csv").read_text().splitlines()))
    assert [float(row["gains.stiffness"]) for row in table] == [1, 13, 2, 3, 66, -2]
    for row in table:
        result = found[float(row["gains.stiffness"])]
        assert row["final_error_cm"] == ("" if result["final_error_cm"] is None
                                         else repr(result["final_error_cm"]))  # fmt: skip
        assert (row["outcome"], row["reason"]) == (result["outcome"], result["reason"] or "")
        assert (row["x (m)"], row["theta (π rad)"]) == ("0.1", "")
        assert json.loads((Path("out") / row["file"]).read_text()) == result
    text = Path("out/sweep.md").read_text()
    assert "6 cases: 3 done, 1 failed, 1 not run, 1 raised" in text
    best = min((1.0, 2.0, 3.0), key=lambda k: found[k]["final_error_cm"])
    (first,) = [line for line in text.splitlines() if line.startswith("| 1 |")]
    assert first.startswith(f"| 1 | {best:g} | (0.1, 0, -0.17) m |")
    assert "stiffness = 13, (0.1, 0, -0.17) m: raised, own.py" in text

    # only cases that no worker could run are tried again
    _, out, _ = call(folder / "sweep.toml", "--out", "out", "--dry-run", "--json", "-")
    assert json.loads(out)["missing"] == 1


def test_a_sweep_goes_on_where_it_stopped(folder, call):
    def run(stiffness, *more):
        (folder / "sweep.toml").write_text(OWN_SWEEP.format(stiffness=stiffness))
        code, out, err = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-",
                              *more)  # fmt: skip
        assert code == 0, err
        return json.loads(out)

    assert run("[1, 2]", "--dry-run")["missing"] == 2
    assert not Path("out").exists()
    assert run("[1, 2]")["ran"] == 2
    before = contents(Path("out"))
    assert run("[1, 2]")["ran"] == 0
    assert contents(Path("out")) == before
    assert run("[3, 1, 2]")["ran"] == 1

    damaged = next(Path("out").rglob("cases/**/*.json"))
    whole = damaged.read_bytes()
    edited = json.dumps(json.loads(whole) | {"final_error_cm": 123.456}).encode()
    deep = b"[" * 10_000
    for content in (b"", whole[:40], b"[]", b'{"outcome": "done"}', edited, deep):
        damaged.write_bytes(content)
        assert run("[3, 1, 2]")["ran"] == 1
        assert damaged.read_bytes() == whole

    for name, old, new in (
        ("neighbour.py", "0.1", "0.25"),  # of another length: Python sees no other edit in a second
        ("own.py", "reference.y", "0.9 * reference.y"),
        ("pendulum.urdf", 'damping="0.05"', 'damping="0.06"'),
    ):
        reasons = {r["final_error_cm"] for r in results(Path("out"))}
        path = folder / name
        path.write_text(path.read_text().replace(old, new))
        assert run("[3, 1, 2]")["ran"] == 3
        assert not reasons & {r["final_error_cm"] for r in results(Path("out"))}


def test_another_softdyn_makes_a_case_run_again(folder, written, monkeypatch):
    wanted = written(OWN_SWEEP.format(stiffness="[1, 2]"))
    before = [job.fingerprint for job in wanted.jobs()]
    monkeypatch.setattr(fingerprint, "code", lambda: "other")
    after = wanted.jobs()
    assert not set(before) & {job.fingerprint for job in after}
    monkeypatch.undo()
    result = worker.attempt(after[0])  # this process has its own softdyn, not the other version
    assert result.figures["outcome"] == "not_run"
    assert "another softdyn" in result.figures["reason"]
    store = sweep.store(folder / "out")
    store.save(after[0], result)
    assert store.result(after[0].name)["fingerprint"] is None


def test_neither_an_interruption_nor_the_number_of_workers_changes_a_byte(folder, call):
    stiffness = list(range(100, 130))
    (folder / "sweep.toml").write_text("logs = true\n" + OWN_SWEEP.format(stiffness=stiffness))
    command = [sys.executable, str(SCRIPTS / "sweep.py"), str(folder / "sweep.toml")]
    for end, jobs, expected in ((signal.SIGINT, "2", 130), (signal.SIGKILL, "1", -9)):
        arguments = ["--out", "out", "--jobs", jobs]
        process = subprocess.Popen([*command, *arguments], stderr=subprocess.PIPE, text=True)
        already = len(results(Path("out")))
        wait_for(lambda n=already: len(list(Path("out").rglob("cases/**/*.json"))) > n + 5)
        process.send_signal(end)
        _, err = process.communicate(timeout=PATIENCE)
        if process.returncode == 0:  # finished before the kill
            break
        assert process.returncode == expected
        assert "Traceback" not in err
        done = results(Path("out"))  # each file is complete
        assert len(done) > 5
        assert all(r["outcome"] == "done" for r in done)
    ran = len(stiffness) - len(results(Path("out")))
    code, out, _ = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert (code, json.loads(out)["ran"]) == (0, ran)
    assert call(folder / "sweep.toml", "--out", "straight", "--jobs", 1)[0] == 0
    names = [name for name in contents(Path("out")) if not name.endswith(".part")]
    straight = contents(Path("straight"))
    assert len(straight) == 2 * len(stiffness) + 4  # two tables, a figure twice
    assert {n: contents(Path("out"))[n] for n in names} == straight


# -- tables ----------------------------------------------------------------------------------------


def made_up(sweep, figure):
    """Make up a result for every case, without running it."""
    return [
        (case, {"outcome": "done" if (v := figure(case)) is not None else "raised",
                "reason": None if v is not None else "a | b\nc", sweep.figure: v})
        for case in sweep.cases
    ]  # fmt: skip


def test_settings_are_ranked_over_their_targets(written):
    sweep = written(FINGER + "Kp = [1, 2, 3]\n")
    values = {(1, 0.5): 1.0, (1, 1): 9.0, (2, 0.5): 4.0, (2, 1): 4.0, (3, 0.5): 0.5, (3, 1): None}
    rows = made_up(sweep, lambda case: values[case.parameters["Kp"], case.value])
    found = sweep_report.settings(rows, sweep.figure)
    assert [(s.case.parameters["Kp"], s.mean, s.worst, s.failed) for s in found] == [
        (2, 4.0, 4.0, 0), (1, 5.0, 9.0, 0), (3, None, None, 1)
    ]  # fmt: skip
    text = sweep_report.to_markdown(sweep, rows)
    assert "| 1 | 2 | 4 | 4 | 0 of 2 |" in text
    assert "raised, a | b c" in text
    best, second = sweep_report.ranked(rows, sweep.figure)[:2]
    assert (best[1][sweep.figure], second[1][sweep.figure]) == (0.5, 1.0)


def test_a_sweep_of_best_and_mpc_needs_no_gains(folder, call):
    text = FINGER.replace('["ic"]', '["best", "mpc"]').replace("[0.5, 1]", "0.5")
    (folder / "sweep.toml").write_text(text)
    code, out, err = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert code == 0, err
    assert json.loads(out)["outcomes"]["done"] == 2
    assert {r["inputs"]["gains"] for r in results(Path("out"))} == {None}


def test_best_and_mpc_run_once_where_they_are_the_same(folder, call):
    """On a path of the finger; not at a set point, with a schedule, or with other gains."""
    text = (
        'robots = ["finger", "spirob"]\ncontrollers = ["mpc", "best"]\n'
        "targets = { theta = 0.5, omega = 0.5 }\nrun.duration = 0.02\n"
    )
    (folder / "sweep.toml").write_text(text)
    wanted = read_sweep(folder / "sweep.toml")
    marks: dict[str, list[str]] = {}
    for job in wanted.jobs():
        marks.setdefault(job.fingerprint, []).append(f"{job.case.robot} {job.case.kind}")
    assert [of for of in marks.values() if len(of) > 1] == [["finger tracking"] * 2]
    (folder / "sweep.toml").write_text(text.replace(', "spirob"', "").replace("theta = 0.5, ", ""))
    planned = call(folder / "sweep.toml", "--out", "out", "--dry-run", "--json", "-")[1]
    assert (json.loads(planned)["cases"], json.loads(planned)["missing"]) == (2, 1)
    found = [call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")[1]
             for _ in range(2)]  # fmt: skip
    assert [json.loads(out)["ran"] for out in found] == [1, 0]
    model = softdyn.load("finger")
    errors = {
        simulate(model, make(model), paper.tracking("finger", 0.5), duration=0.02).mse_cm2
        for make in (Mpc, best)
    }
    assert len(errors) == 1
    assert {result["mse_cm2"] for result in results(Path("out"))} == errors
    named = {result["inputs"]["controller"] for result in results(Path("out"))}
    assert named == {"best", "mpc"}
    (folder / "sweep.toml").write_text(text + "gains.mpc.horizon = 0.2\n")
    assert len({job.fingerprint for job in read_sweep(folder / "sweep.toml").jobs()}) == 8
