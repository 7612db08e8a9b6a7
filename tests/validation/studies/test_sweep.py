"""Sweeps: the meaning of a file, its results, and their independence of the workers."""

import csv
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint
from softdyn.controllers import Gains, Mpc
from softdyn.controllers.gains import PUBLISHED
from softdyn.validation import Log, paper, simulate
from softdyn.validation.studies import sweep, sweep_report
from softdyn.validation.studies.engine import cluster as dask
from softdyn.validation.studies.engine import executors, fingerprint, sources, worker
from softdyn.validation.studies.sweep_file import read_sweep
from softdyn.validation.studies.sweep_values import MAX_CASES, draw
from tests.support import ROOT

SCRIPTS = ROOT / "scripts"
PENDULUM = """<robot name="pendulum">
  <link name="base"/>
  <link name="body"><inertial><mass value="0.1"/>
    <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>
  <link name="tip"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="body"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/><dynamics damping="0.05"/></joint>
  <joint name="end" type="fixed"><parent link="body"/><child link="tip"/>
    <origin xyz="0 0 -0.2"/></joint>
  <softdyn version="1">
    <tendon name="cable"><joint name="turn" coef="1"/></tendon>
    <actuator name="u" tendon="cable" gear="1" lower="-5" upper="5"/>
  </softdyn>
</robot>"""
OWN = """
import os
from types import SimpleNamespace

import numpy as np
from neighbour import DAMPING


class Spring:
    def __init__(self, model, table=None):
        self.gains = dict(table or {"stiffness": 1.0})
        print("built")

    def __call__(self, state, reference):
        stiffness = self.gains["stiffness"]
        if stiffness == 13:
            raise ZeroDivisionError("thirteen")
        if stiffness == 66:
            os.kill(os.getpid(), 9)
        force = stiffness * (reference.y - state.y) - DAMPING * state.ydot
        return SimpleNamespace(u=state.J.T @ force)
"""
OWN_SWEEP = """
robots = ["pendulum.urdf"]
controllers = ["own.py:Spring"]
[targets]
point = [0.1, 0, -0.17]
[gains]
stiffness = {stiffness}
[plant]
duration = 0.3
"""
FINGER = """
robots = "finger"
controllers = ["ic"]
[targets]
theta = [0.5, 1]
[plant]
duration = 0.2
[gains]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder; the sweep is called from another one."""
    (tmp_path / "pendulum.urdf").write_text(PENDULUM)
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "neighbour.py").write_text("DAMPING = 0.1\n")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for name in ("own", "neighbour"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


@pytest.fixture
def written(folder):
    """Write a sweep file and read it."""

    def write(text, name="sweep.toml"):
        (folder / name).write_text(text)
        return read_sweep(folder / name)

    return write


@pytest.fixture
def call(folder, monkeypatch, capsys):
    """Run the command in this process: exit code, stdout, stderr."""
    from softdyn.commands import sweep as command

    def call(*arguments):
        try:
            code = command.main([str(a) for a in arguments])
        except SystemExit as error:
            code = error.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def contents(folder):
    """Everything below a folder: relative path → bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def results(folder):
    return [json.loads(path.read_text()) for path in sorted(folder.rglob("cases/**/*.json"))]


# -- what a file means -----------------------------------------------------------------------------


def test_a_grid_is_every_combination_the_last_fastest(written):
    sweep = written(
        'robots = ["finger", "pendulum.urdf"]\ncontrollers = ["ic", "uic"]\n'
        "[targets]\nomega = 0.5\ntheta = [0, 1.5]\npoint = [[0.1, 0, 0], [0, 0, -0.1]]\n"
        "[gains]\neps = [0.02, 0.1]\nKp = 70\n[plant]\ncontacts = [false, true]\nperiod = 0.01\n"
    )
    cases = sweep.cases
    expected = [
        (robot, controller, *target, eps, contacts)
        for robot in ("finger", "pendulum.urdf")
        for controller in ("ic", "uic")
        for target in (
            ("set_point", 0.0), ("set_point", 1.5), ("tracking", 0.5),
            ("point", (0.1, 0.0, 0.0)), ("point", (0.0, 0.0, -0.1)),
        )
        for eps in (0.02, 0.1)
        for contacts in (False, True)
    ]  # fmt: skip
    found = [
        (c.robot, c.controller, c.kind, c.value, c.parameters["eps"], c.plant.contacts)
        for c in cases
    ]
    assert found == expected
    assert {c.parameters["Kp"] for c in cases} == {70.0}
    assert {(c.period, c.timestep, c.sample) for c in cases} == {(0.01, 5e-4, None)}
    assert {c.duration for c in cases if c.kind == "tracking"} == {8.0}
    assert {c.duration for c in cases if c.kind != "tracking"} == {10.0}
    assert len({c.name for c in cases}) == len(cases)


def test_ranges_and_defaults(written):
    sweep = written(
        FINGER + "Kp = { from = 100, to = 400, count = 4 }\n"
        'eps = { from = 0.01, to = 1, count = 3, spacing = "log" }\n'
    )
    values = {axis.name: axis.values for axis in sweep.axes}
    assert values["gains.Kp"] == (100.0, 200.0, 300.0, 400.0)
    np.testing.assert_allclose(values["gains.eps"], [0.01, 0.1, 1.0], rtol=1e-15)
    assert (values["gains.eps"][0], values["gains.eps"][-1]) == (0.01, 1.0)
    case = sweep.cases[0]
    published = PUBLISHED["finger"]["ic"]
    assert Gains(**case.parameters) == replace(published, Kp=100.0, eps=0.01)
    assert case.period == paper.setup("finger").period
    assert (case.duration, sweep.figure, sweep.logs) == (0.2, "final_error_cm", False)


SAMPLED = (
    'robots = "finger"\ncontrollers = ["ic", "uic"]\n[targets]\ntheta = {{ uniform = [0, 2] }}\n'
    "[gains]\nKp = {{ log_uniform = [10, 1000] }}\n{more}\n[samples]\ncount = {count}\nseed = 3\n"
)


def test_vectors_horizons_and_overlays(written, folder):
    sweep = written("""
robots = "finger"
controllers = ["soft-id-clf-qp"]
targets.theta = 0.5
[gains]
horizon = [0, 0.02]
u_ref = [[0.1, -0.2], 0]
""")
    found = [(case.parameters["horizon"], case.parameters["u_ref"]) for case in sweep.cases]
    assert found == [(0, (0.1, -0.2)), (0, 0), (0.02, (0.1, -0.2)), (0.02, 0)]
    assert sweep.cases[0].parameters["eps"] == PUBLISHED["finger"]["soft-id-clf-qp"].eps
    assert "u_ref: (0.1, -0.2), 0" in "\n".join(sweep_report._varied(sweep))
    overlay = (ROOT / "docs" / "examples" / "soft_ur5.xml").read_text()
    (folder / "mine.xml").write_text(overlay)
    sweep = written("""
robots = "ur5"
annotations.ur5 = "mine.xml"
controllers = ["mpc", "own.py:Spring"]
targets.point = [0.5, 0.2, 0]
plant.duration = 0.02
gains.horizon = 0.2
""")
    job, own = sweep.jobs()
    assert own.case.parameters == {"horizon": 0.2}
    expected = worker.run(job)
    model = softdyn.load("ur5", annotations=folder / "mine.xml")
    log = simulate(
        model, Mpc(model, {"horizon": 0.2}), SetPoint([0.5, 0.2, 0]), duration=0.02, period=0.002
    )
    assert expected.figures["final_error_cm"] == log.final_error_cm
    # a worker without the file receives it
    sha = dict(job.robot.overlay.files)["mine.xml"]
    there = replace(job.robot, overlay=replace(job.robot.overlay, path="/nowhere/mine.xml"))
    sources._kept.__dict__.clear()
    assert worker.attempt(replace(job, robot=there)).figures["outcome"] == "not_run"
    sent = {sha: overlay.encode()}
    assert worker.attempt(replace(job, robot=there), sent).figures == expected.figures


def test_samples_are_seeded_paired_and_stable(written):
    def drawn(count, more=""):
        cases = written(SAMPLED.format(count=count, more=more)).cases
        return {
            name: [(c.sample, c.value, c.parameters["Kp"]) for c in cases if c.controller == name]
            for name in ("ic", "uic")
        }

    few, many = drawn(5), drawn(400, "eps = { uniform = [0.01, 0.1] }")
    assert few["ic"] == few["uic"]  # the same sample for every controller
    # neither a larger count nor a new parameter changes other samples
    assert many["ic"][:5] == few["ic"]
    sample, theta, kp = zip(*many["ic"], strict=True)
    assert sample == tuple(range(400))
    assert 0 <= min(theta) < 0.1 < 1.9 < max(theta) <= 2
    assert min(kp) >= 10
    assert max(kp) <= 1000
    assert abs(np.median(np.log10(kp)) - 2) < 0.2  # log-uniform: half of them below 100
    assert abs(np.corrcoef(theta, kp)[0, 1]) < 0.2
    other = draw("theta", 4, 5, 0.0, 2.0, False)
    assert list(other) != [t for _, t, _ in few["ic"]]


BASE = {
    "robots": 'robots = ["finger"]',
    "controllers": 'controllers = ["ic"]',
    "targets": "[targets]\ntheta = 0.5",
}
MISUSES = [
    ({"robots": ""}, "robots: expected a list of distinct names, got nothing"),
    ({"robots": "robots = []"}, "robots: expected a list of distinct names, got []"),
    ({"robots": 'robots = ["finger", "finger"]'}, "robots: expected a list of distinct names"),
    ({"robots": "robots = 3"}, "robots: expected a list of distinct names, got 3"),
    ({"robots": 'robots = ["fingr"]'}, "robots: expected a URDF file or a name such as finger"),
    ({"robots": 'robots = ["none.urdf"]'}, "robots: expected an existing file"),
    ({"robots": 'robots = ["broken.urdf"]'}, "in broken.urdf"),
    ({"robots": 'robots = ["ur5"]'}, "robots: expected robots with actuators"),
    ({"robots": 'robots = ["pendulum.urdf"]'},
     "gains.Kp: expected a value for pendulum.urdf, which has no published gains, got none"),
    ({"controllers": 'controllers = ["pid"]'}, "controllers: expected soft-id-clf-qp"),
    ({"controllers": 'controllers = ["none.py:C"]'}, "controllers: expected an existing Python"),
    ({"controllers": 'controllers = ["own.py:C"]'}, "controllers: expected a class in"),
    ({"controllers": 'controllers = ["bad.py:C"]'}, "NameError in line 1"),
    ({"targets": ""}, "targets: expected at least one of theta, omega, point, got none"),
    ({"targets": "[targets]\nphi = 1"}, "targets.phi: expected one of theta, omega, point"),
    ({"targets": "[targets]\nomega = 0"}, "targets.omega: expected a finite number > 0, got 0"),
    ({"targets": "[targets]\ntheta = nan"}, "targets.theta: expected a finite number, got nan"),
    ({"targets": "[targets]\npoint = 1"}, "targets.point: expected [x, y, z] in m"),
    ({"targets": "[targets]\npoint = [1, 2]"}, "targets.point: expected [x, y, z] in m"),
    ({"targets": "[targets]\npoint = [[1, 2, inf]]"}, "targets.point: expected a finite number"),
    ({"targets": "[targets]\npoint = []"}, "targets.point: expected [x, y, z] in m"),
    ({"targets": "targets = 1"}, "targets: expected a table [targets], got 1"),
    ({"more": "[gain]\nKp = 1"}, "gain: expected one of robots, controllers"),
    ({"more": "[gains]\nkp = 1"}, "gains.kp: expected one of Kp, eps"),
    ({"more": "[gains]\nKp = -1"}, "gains.Kp: expected a positive number, got -1"),
    ({"more": "[gains]\nKp = true"}, "gains.Kp: expected a positive number, got True"),
    ({"more": '[gains]\nKp = "big"'}, "gains.Kp: expected a positive number, got big"),
    ({"more": "[gains]\nKp = []"}, "gains.Kp: expected at least one value, got []"),
    ({"more": "[gains]\nKp = [1, 1.0]"}, "gains.Kp: expected distinct values, got [1, 1.0]"),
    ({"more": "[gains]\nKp = {from = 1, to = 2}"}, "gains.Kp: expected a range {from, to, count}"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, count = 1}"},
     "gains.Kp.count: expected a whole number from 2"),
    ({"more": "[gains]\nKp = {from = 2, to = 1, count = 3}"},
     "gains.Kp: expected a lower end below the upper, got [2, 1]"),
    ({"more": "[gains]\nw1 = {from = 0, to = 1, count = 3, spacing = 'log'}"},
     "gains.w1: expected a finite number > 0, got 0"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, count = 3, spacing = 'cubic'}"},
     "gains.Kp.spacing: expected linear or log, got cubic"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, step = 3}"}, "gains.Kp.step: expected one of"),
    ({"more": "[gains]\nKp = {uniform = [1, 2]}"},
     "samples: expected a table with the count of samples of gains.Kp, got none"),
    ({"more": "[gains]\nKp = {uniform = [1]}\n[samples]\ncount = 2"},
     "gains.Kp.uniform: expected [lower, upper], got [1]"),
    ({"more": "[gains]\nKp = {uniform = [-1, 1]}\n[samples]\ncount = 2"},
     "gains.Kp: expected a positive number, got -1"),
    ({"more": "[gains]\nKp = {uniform = [1, 2], count = 3}\n[samples]\ncount = 2"},
     "gains.Kp.count: expected one of uniform, got an unknown key"),
    ({"more": "[samples]\ncount = 2"}, "samples: expected a parameter with uniform or log_uniform"),
    ({"more": "[samples]\nseed = 2"}, "samples.count: expected a whole number from 1"),
    ({"more": "[samples]\ncount = 2\nseed = -1"}, "samples.seed: expected a whole number from 0"),
    ({"more": "[plant]\nmasses = 1"}, "plant.masses: expected one of period, duration, timestep"),
    ({"more": "[plant]\nperiod = 0"}, "plant.period: expected a finite number > 0, got 0"),
    ({"more": "[plant]\ncontacts = 1"}, "plant.contacts: expected true or false, got 1"),
    ({"more": "[plant]\ncontacts = {uniform = [0, 1]}"}, "plant.contacts: expected true or false"),
    ({"more": "[plant]\ntimestep = 0.0003"}, "finger, timestep: expected an integer part of"),
    ({"more": "[plant]\nduration = 1e9"}, "finger, duration: expected at most"),
    ({"top": "logs = 1"}, "logs: expected true or false, got 1"),
    ({"top": 'figure = "time"'}, "figure: expected one of final_error_cm"),
    ({"top": 'figure = "second_cycle_mse_cm2"'}, "figure: expected final_error_cm or mse_cm2"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, count = 1000}\n"
              "eps = {from = 1, to = 2, count = 1000}"},
     f"expected at most {MAX_CASES} cases, got 1000000 = 1 robots × 1 controllers × 1 targets × "
     "1000 gains.Kp × 1000 gains.eps"),
    ({"controllers": 'controllers = ["ic", "own.py:Spring"]',
      "more": '[gains."own.py:Sprung"]\nk = 1'},
     "gains.own.py:Sprung: expected a gain, or one of the controllers ic, own.py:Spring, got a"),
    ({"more": "[gains.ic]\nkp = 1"}, "gains.ic.kp: expected one of Kp, eps"),
    ({"more": "[gains.ic]\nKp = [1, -1]"}, "gains.ic.Kp: expected a positive number, got -1"),
    ({"controllers": 'controllers = ["mpc"]', "more": "[gains.mpc]\nhorizn = 1"},
     "mpc for finger: parameters: expected"),
    ({"more": "nonsense"}, "expected a TOML file"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), MISUSES, ids=[m for _, m in MISUSES])
def test_what_is_wrong_is_told_in_one_line(folder, call, change, message):
    (folder / "broken.urdf").write_text(PENDULUM.replace('value="0.1"', 'value="heavy"'))
    (folder / "bad.py").write_text("nothing\n")
    parts = BASE | {"top": "", "more": ""} | change
    path = folder / "bad.toml"
    order = ("top", "robots", "controllers", "targets", "more")
    path.write_text("\n".join(parts[name] for name in order))
    code, out, err = call(path, "--out", folder / "out")
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {path}: ")
    assert message in err
    assert err.count("\n") == 1
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.toml"], "none.toml: expected a readable file"),
        (["good.toml", "--jobs", "0"], "whole number > 0"),
        (["good.toml", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "not allowed with"),
        (["good.toml", "--out", "good.toml"], "good.toml: expected a folder to write to"),
        (["good.toml", "--json", "none/x.json"], "x.json: expected a writable file"),
        (["good.toml", "--scheduler", "nowhere"], "--scheduler: expected "),
    ],
)
def test_wrong_arguments(folder, call, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(dask, "CONNECT", 0.3)
    (folder / "good.toml").write_text(FINGER)
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert err.count("\n") == 1


def test_the_documents_sweeps_are_sweeps(folder):
    examples = sorted((ROOT / "docs" / "examples").glob("sweep_*.toml"))
    assert examples
    for path in examples:
        assert read_sweep(path).cases
    blocks = (ROOT / "docs" / "sweeps.md").read_text().split("```toml\n")[1:]
    assert blocks
    for block in blocks:
        (folder / "block.toml").write_text(block.split("```")[0])
        assert read_sweep(folder / "block.toml").cases


# -- what it leaves behind -------------------------------------------------------------------------


def test_runningare_those_of_simulate(folder, call):
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
    (folder / "sweep.toml").write_text(OWN_SWEEP.format(stiffness="[1, 13, 66, 2, 3, -2]"))
    code, out, _ = call(folder / "sweep.toml", "--out", "out", "--jobs", 2, "--json", "-")
    assert code == 1  # one could not be run
    report = json.loads(out)
    assert report["outcomes"]["raised"] == report["outcomes"]["not_run"] == 1
    found = {r["inputs"]["gains"]["stiffness"]: r for r in results(Path("out"))}
    assert len(found) == 6
    assert found[13.0]["outcome"] == "raised"
    line = 1 + OWN.splitlines().index('            raise ZeroDivisionError("thirteen")')
    assert (
        f"own.py:Spring: expected a command, got ZeroDivisionError in line {line}: thirteen"
        in (found[13.0]["reason"])
    )
    assert (found[66.0]["outcome"], found[66.0]["reason"]) == ("not_run", executors.DIED)
    assert {found[k]["outcome"] for k in (1.0, 2.0, 3.0)} == {"done"}
    assert found[-2.0]["outcome"] == "failed"
    assert "no convergence" in found[-2.0]["reason"]

    table = list(csv.DictReader(Path("out/sweep.csv").read_text().splitlines()))
    assert [float(row["gains.stiffness"]) for row in table] == [1, 13, 66, 2, 3, -2]
    for row in table:
        result = found[float(row["gains.stiffness"])]
        assert row["final_error_cm"] == ("" if result["final_error_cm"] is None
                                         else repr(result["final_error_cm"]))  # fmt: skip
        assert (row["outcome"], row["reason"]) == (result["outcome"], result["reason"] or "")
        assert (row["x"], row["theta"]) == ("0.1", "")
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
        ("neighbour.py", "0.1", "0.2"),
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


def test_the_number_of_workers_changes_no_byte(folder, call):
    text = "logs = true\n" + FINGER + "Kp = [100, 200, 300, 400]\neps = [0.02, 0.05]\n"
    (folder / "sweep.toml").write_text(text)
    for jobs in (1, 2):
        assert call(folder / "sweep.toml", "--out", f"out{jobs}", "--jobs", jobs)[0] == 0
    one, two = (contents(Path(f"out{jobs}")) for jobs in (1, 2))
    assert len(one) == 2 * 16 + 2
    assert one == two


def test_an_interrupted_sweep_leaves_whole_files(folder, call):
    stiffness = list(range(100, 180))
    (folder / "sweep.toml").write_text(OWN_SWEEP.format(stiffness=stiffness))
    command = [sys.executable, str(SCRIPTS / "sweep.py"), str(folder / "sweep.toml")]
    for end, jobs, expected in ((signal.SIGINT, "2", 130), (signal.SIGKILL, "1", -9)):
        arguments = ["--out", "out", "--jobs", jobs]
        process = subprocess.Popen([*command, *arguments], stderr=subprocess.PIPE, text=True)
        already = len(results(Path("out")))
        wait_for(lambda n=already: len(list(Path("out").rglob("cases/**/*.json"))) > n + 5)
        process.send_signal(end)
        _, err = process.communicate(timeout=20)
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
    assert {n: contents(Path("out"))[n] for n in names} == contents(Path("straight"))


def wait_for(condition, seconds=180.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.005)


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


# -- other machines --------------------------------------------------------------------------------


def test_a_worker_without_the_user_s_files_gets_them(folder, written):
    wanted = written(OWN_SWEEP.format(stiffness="[2]"))
    (here,) = wanted.jobs()
    files = {
        sha: (folder / name).read_bytes()
        for source in (here.robot, here.controller)
        for name, sha in source.files
    }
    assert len(files) == 3  # the module beside it, too
    there = replace(
        here,
        robot=replace(here.robot, path="/nowhere/pendulum.urdf"),
        controller=replace(here.controller, path="/nowhere/own.py"),
    )
    expected = worker.attempt(here)
    sources._kept.__dict__.clear()  # as a new worker
    lost = worker.attempt(there)
    assert lost.figures["outcome"] == "not_run"
    assert worker.attempt(there, files) == expected
    assert expected.figures["outcome"] == "done"


CLUSTER = """
robots = ["finger", "pendulum.urdf"]
controllers = ["soft-id-clf-qp"]
[targets]
theta = [0.5, 1]
[gains]
Kp = { from = 100, to = 600, count = 10 }
[plant]
duration = 0.5
"""


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and two worker processes on the loopback: (address, scheduler, workers).

    A task fails after it killed two workers, not four, so that fewer processes start.
    """
    http = ["--no-dashboard", "--dashboard-address", "127.0.0.1:0", "--host", "127.0.0.1"]
    about = tmp_path / "scheduler.json"
    environment = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    processes = []

    def start(kind, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments, *http]
        processes.append(
            subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path, env=environment)
        )

    with (tmp_path / "cluster.log").open("w") as log:
        try:
            start("scheduler", "--port", "0", "--scheduler-file", str(about))
            for i in range(2):
                start("worker", "--scheduler-file", str(about), "--nthreads", "1", "--no-nanny",
                      "--local-directory", str(tmp_path / f"w{i}"))  # fmt: skip
            wait_for(lambda: about.exists() and about.read_text().endswith("}"))
            yield json.loads(about.read_text())["address"], processes[0], processes[1:]
        finally:
            for process in processes:
                process.kill()
                process.wait()


# workers that are restarted, as by a nanny
RESPAWN = """
import signal, subprocess, sys
command = [sys.executable, "-m", "distributed.cli.dask_worker", sys.argv[1], "--nthreads", "1",
           "--no-nanny", "--no-dashboard", "--dashboard-address", "127.0.0.1:0",
           "--host", "127.0.0.1"]
worker = None
def end(*_):
    worker.kill()
    sys.exit()
signal.signal(signal.SIGTERM, end)
while True:
    worker = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    worker.wait()
"""


@contextmanager
def respawning(address, folder):
    process = subprocess.Popen(
        [sys.executable, "-c", RESPAWN, address], cwd=folder, stderr=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def listening(pid):
    """Addresses on which a process listens, from the kernel's tables."""
    sockets = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            sockets.add(os.readlink(entry))
        except OSError:
            continue
    lines = [line.split() for name in ("tcp", "tcp6")
             for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]]  # fmt: skip
    return {x[1].rsplit(":", 1)[0] for x in lines if x[3] == "0A" and f"socket:[{x[9]}]" in sockets}


@pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="needs dask.distributed: the extra softdyn[cluster]",
)
def test_a_cluster_that_loses_all_it_has_loses_no_case(folder, call, cluster, monkeypatch):
    """One cluster, because it starts slowly: it loses a worker, then all, then the scheduler."""
    from distributed import Client

    address, scheduler, workers = cluster
    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2)
    with monkeypatch.context() as patched:
        patched.setattr(fingerprint, "code", lambda: "other")
        with pytest.raises(InputError, match="workers with this softdyn"):
            dask.cluster(address)
    if sys.platform == "linux":
        assert set().union(*(listening(w.pid) for w in workers)) == {"0100007F"}

    # a worker is killed on the way
    path = folder / "sweep.toml"
    path.write_text(CLUSTER)
    at_death = []

    def kill():
        wait_for(lambda: len(list(Path("far").rglob("cases/**/*.json"))) > 3)
        workers[0].kill()
        at_death.append(len(list(Path("far").rglob("cases/**/*.json"))))

    killer = Thread(target=kill)
    killer.start()
    code, out, err = call(path, "--scheduler", address, "--out", "far", "--json", "-")
    killer.join()
    assert code == 0, err
    assert (json.loads(out)["cases"], json.loads(out)["ran"]) == (40, 40)
    assert at_death[0] < 40  # it died on the way
    assert workers[0].wait() == -signal.SIGKILL
    assert workers[1].poll() is None
    assert call(path, "--out", "near", "--jobs", 1)[0] == 0
    assert contents(Path("far")) == contents(Path("near"))
    assert {r["outcome"] for r in results(Path("far"))} <= {"done", "failed"}

    # one case kills every worker that takes it; the other cases finish
    path.write_text(OWN_SWEEP.format(stiffness="[1, 66]"))
    with respawning(address, folder):
        code, out, err = call(path, "--scheduler", address, "--out", "own", "--json", "-")
    assert code == 1, err
    assert {r["inputs"]["gains"]["stiffness"]: r["outcome"] for r in results(Path("own"))} == {
        1.0: "done", 66.0: "not_run",
    }  # fmt: skip
    assert {r["reason"] for r in results(Path("own"))} == {None, executors.DIED}
    assert workers[1].wait() == -signal.SIGKILL

    # the scheduler goes away
    path.write_text(CLUSTER)
    jobs, store = read_sweep(path).jobs(), sweep.store(folder / "cut")
    running = store.run(jobs, dask.cluster(address))
    with respawning(address, folder):
        next(running)
        scheduler.kill()
        with pytest.raises(dask.ClusterError, match="repeat the command"):
            list(running)
    assert 0 < len(store.missing(jobs)) < len(jobs)

    # without remaining cases, no cluster is contacted
    assert call(path, "--out", "far", "--scheduler", "tcp://127.0.0.1:1")[0] == 0


def test_without_distributed_the_command_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"softdyn\[cluster\]"):
        dask.cluster("tcp://127.0.0.1:1")


def test_a_sweep_of_best_and_mpc_needs_no_gains(folder, call):
    text = FINGER.replace('["ic"]', '["best", "mpc"]').replace("[0.5, 1]", "0.5")
    (folder / "sweep.toml").write_text(text)
    code, out, err = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert code == 0, err
    assert json.loads(out)["outcomes"]["done"] == 2
    assert {r["inputs"]["gains"] for r in results(Path("out"))} == {None}


def test_each_controller_has_gains_of_its_own(written, folder):
    """They go before the gains of all; each controller has its own grid."""
    sweep = written("""
robots = ["pendulum.urdf"]
controllers = ["own.py:Spring", "ic"]
[targets]
point = [0.1, 0, -0.17]
[gains]
Kp = [50, 60]
eps = 0.1
[gains."own.py:Spring"]
Kp = 1
stiffness = [1, 2, 3]
[gains.ic]
eps = 0.2
""")
    spring = [c.parameters for c in sweep.cases if c.controller != "ic"]
    assert spring == [{"Kp": 1, "eps": 0.1, "stiffness": k} for k in (1, 2, 3)]
    ic = [c.parameters for c in sweep.cases if c.controller == "ic"]
    assert [(gains["Kp"], gains["eps"]) for gains in ic] == [(50, 0.2), (60, 0.2)]
    said = {"gains": {"own.py:Spring": {"stiffness": 4}, "eps": 0.3}, "robots": ["pendulum.urdf"]}
    sweep = read_sweep(folder / "sweep.toml", said)
    assert sweep.cases[0].parameters == {"Kp": 1, "eps": 0.3, "stiffness": 4}
    assert {c.parameters["eps"] for c in sweep.cases if c.controller == "ic"} == {0.2}
