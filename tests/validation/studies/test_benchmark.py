"""The command benchmark.py: its result does not depend on processes, interruptions or changes."""

import json
import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from softdyn.validation import paper
from softdyn.validation.processes import WorkerKilled, in_processes
from softdyn.validation.studies import benchmark
from softdyn.validation.studies.engine import sources, store
from softdyn.validation.studies.engine.case import Case, number_text
from tests.support import PATIENCE, ROOT, SCRIPTS
from tests.support.command import command, of_itself
from tests.support.refused import refused
from tests.support.robots import finger
from tests.support.sweeps import wait_for

SCRIPT = SCRIPTS / "benchmark.py"
OWN = """
import math, os, signal, sys, time
from types import SimpleNamespace
from neighbour import FORCE

class Push:
    force = FORCE
    def __init__(self, model):
        print("a user's own words")
        self.nu, self.gains = model.nu, {"other": object()}
    def __call__(self, state, reference):
        while os.path.exists("wait"):
            time.sleep(0.01)
        return SimpleNamespace(u=[self.force] * self.nu)

class Nan(Push):
    force = math.nan

class Broken(Push):
    def __call__(self, state, reference):
        return 1 / 0

class Unbuildable:
    def __init__(self, model):
        raise KeyError("nothing")

class Kills(Push):
    def __call__(self, state, reference):
        os.kill(os.getpid(), signal.SIGKILL)

class Interrupts(Push):
    def __call__(self, state, reference):
        try:
            open("sent", "x").close()
            for _ in range(3):  # an impatient user; a terminal sends it to the whole group
                os.killpg(os.getpgrp(), signal.SIGINT)
        except FileExistsError:
            pass
        return super().__call__(state, reference)
"""
# runs of 0.2 s and less, no set points
GRID = ["--robots", "finger", "--thetas", "--omegas", "20", "25", "40"]
CONTROLLERS = ["--controllers", "soft-id-clf-qp", "own.py:Push"]
CASES = 6


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder as the working directory."""
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "neighbour.py").write_text("FORCE = 0.25\n")
    (tmp_path / "arm.urdf").write_text(finger())
    monkeypatch.chdir(tmp_path)
    for name in ("own", "neighbour"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


@pytest.fixture
def call(folder):
    """Exit code, stdout, stderr."""

    def call(*arguments, jobs=1, plots=False):
        options = ["--jobs", jobs] + ([] if plots else ["--no-plots"])
        return command("benchmark", *arguments, *options)

    return call


def start(*arguments, jobs=2, **options):
    """Start the command in a separate process, without figures."""
    command = [sys.executable, str(SCRIPT), *arguments, "--jobs", str(jobs), "--no-plots"]
    pipe = subprocess.PIPE
    # a shell's background jobs, and so the tests, may ignore SIGINT
    hear = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    return subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, preexec_fn=hear, **options
    )


def contents(out, *without):
    """Bytes of the files below a folder, by relative path."""
    files = (p for p in Path(out).rglob("*") if p.is_file() and not p.name.startswith("."))
    found = {str(p.relative_to(out)): p.read_bytes() for p in files}
    return {name: data for name, data in found.items() if not name.startswith(without)}


def differences(one, other):
    """Names of files that differ between both folders, except step times."""
    a, b = (contents(out, "times") for out in (one, other))
    return sorted(name for name in a.keys() | b.keys() if a.get(name) != b.get(name))


def stamps(out):
    """When each result was written."""
    return {str(p): p.stat().st_mtime_ns for p in sorted(Path(out).rglob("runs/**/*.json"))}


def edit(path, name, value):
    """Change one entry of a JSON file by hand."""
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}, indent=2))


@pytest.fixture(scope="session")
def reference(tmp_path_factory):
    """The short grid run once, without interruption."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "own.py").write_text(OWN)
    (folder / "neighbour.py").write_text("FORCE = 0.25\n")
    for name in ("own", "neighbour"):  # of another test's folder
        sys.modules.pop(name, None)
    single = ("--jobs", "1", "--no-plots")
    code, _, errors = command("benchmark", *GRID, *CONTROLLERS, "--out", "out", *single, cwd=folder)
    assert code == 0, errors
    assert set(errors.splitlines()) == {"a user's own words"}  # no bar without a terminal
    for name in ("own", "neighbour"):
        sys.modules.pop(name, None)
    return folder / "out"


# --- the same result, whatever runs it ---------------------------------------------------------


def test_two_runs_in_one_folder_at_once(folder, reference):
    """Neither the number of processes nor another run makes a difference."""
    both = [start(*GRID, *CONTROLLERS, "--out", "out", jobs=jobs) for jobs in (1, 2)]
    for process in both:
        text, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors
        assert "Table, figures and logs: out/" in text
    assert differences("out", reference) == []
    names = contents("out").keys()
    assert len([name for name in names if name.endswith(".npz")]) == CASES
    assert {"table.md", "table.tex", "results.json"} < names


def test_a_second_run_does_nothing(call, folder, reference):
    shutil.copytree(reference, "out")
    before = stamps("out")
    assert call(*GRID, *CONTROLLERS, "--out", "out")[0] == 0
    assert stamps("out") == before
    assert differences("out", reference) == []


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("runs/finger/soft-id-clf-qp/tracking_20.json", Path.unlink),
        ("runs/finger/soft-id-clf-qp/tracking_20.json", lambda p: p.write_text('{"fing')),
        ("runs/finger/soft-id-clf-qp/tracking_20.json", lambda p: p.write_text("[]")),
        ("runs/finger/soft-id-clf-qp/tracking_20.json", lambda p: p.write_bytes(b"\xff\0")),
        ("runs/finger/soft-id-clf-qp/tracking_20.npz", Path.unlink),
        ("runs/finger/soft-id-clf-qp/tracking_20.npz", lambda p: os.truncate(p, 1000)),
        ("times/finger/soft-id-clf-qp/tracking_20.json", lambda p: p.write_text("")),
        ("runs/finger/soft-id-clf-qp/tracking_20.json", lambda p: edit(p, "mse_cm2", 123.456)),
        ("runs/finger/soft-id-clf-qp/tracking_20.json", lambda p: edit(p, "failed", None)),
        ("runs/finger/soft-id-clf-qp/tracking_20.json", lambda p: edit(p, "extra", 10**60)),
        ("runs/finger/soft-id-clf-qp/tracking_20.json", lambda p: p.write_text("[" * 10_000)),
        ("times/finger/soft-id-clf-qp/tracking_20.json", lambda p: edit(p, "median", "fast")),
        ("times/finger/soft-id-clf-qp/tracking_20.json", lambda p: edit(p, "median", 123.456)),
    ],
)
def test_a_lost_or_damaged_file_redoes_its_case_alone(call, reference, name, damage):
    shutil.copytree(reference, "out")
    before = stamps("out")
    damage(Path("out", name))
    assert call(*GRID, *CONTROLLERS, "--out", "out")[0] == 0
    after = stamps("out")
    assert after.keys() == before.keys()
    (redone,) = (path for path in after if after[path] != before[path])
    assert redone.endswith("soft-id-clf-qp/tracking_20.json")
    assert differences("out", reference) == []
    assert contents("out").keys() == contents(reference).keys()


def test_figures_come_from_the_logs(call, reference):
    """A log overrides a result, even if the result's hash is correct."""
    shutil.copytree(reference, "out")
    path = Path("out/runs/finger/soft-id-clf-qp/tracking_20.json")
    content = json.loads(path.read_text()) | {"mse_cm2": 123.456, "not_solved": 77}
    store._write(path, {name: value for name, value in content.items() if name != "sha256"})
    assert call(*GRID, *CONTROLLERS, "--out", "out")[0] == 0
    assert "123.456" in path.read_text()
    for name in ("table.md", "table.tex", "results.json"):
        assert Path("out", name).read_bytes() == (reference / name).read_bytes()


def test_a_log_of_another_run_is_no_log(call, reference):
    shutil.copytree(reference, "out")
    name = Case("finger", "soft-id-clf-qp", "tracking", 20.0)
    path = benchmark.store(Path("out")).log_path(name.name)
    shutil.copy(path.with_name("tracking_25.npz"), path)
    with refused("out/runs/finger/soft-id-clf-qp/tracking_20.npz", "another, or none"):
        benchmark.benchmark_rows([name], Path("out"))


# --- interrupted --------------------------------------------------------------------------------


def said(errors):
    """The lines on stderr without a user's own words and the notice of a cold cache."""
    return [line for line in of_itself(errors).splitlines() if line != "a user's own words"]


def test_killed_half_way(call, reference):
    Path("wait").touch()  # the own controller's runs do not end before the kill
    process = start(*GRID, *CONTROLLERS, "--out", "out")
    wait_for(lambda: stamps("out"))
    process.kill()
    process.communicate(timeout=PATIENCE)  # the pipes close when the last worker is gone
    Path("wait").unlink()
    before = stamps("out")
    assert process.returncode == -signal.SIGKILL
    assert before
    assert call(*GRID, *CONTROLLERS, "--out", "out")[0] == 0
    after = stamps("out")
    assert {name: after[name] for name in before} == before
    assert differences("out", reference) == []


def test_a_killed_worker(folder):
    process = start(*GRID, "--controllers", "own.py:Kills", "--out", "out")
    text, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert text == ""
    (line,) = said(errors)
    assert line.startswith("error: a process was killed")
    assert stamps("out") == {}


def test_interrupted(folder):
    given = ("--controllers", "own.py:Interrupts", "--out", "out")
    process = start(*GRID, *given, start_new_session=True)
    text, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, errors
    assert text == ""
    assert said(errors) == ["error: interrupted"]
    assert errors.endswith("error: interrupted\n")


def test_workers_do_not_hear_ctrl_c(tmp_path):
    """One that is just starting would print an error of its own."""
    (tmp_path / "own.py").write_text(
        "import signal\n"
        "def blocked():\n"
        "    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
    )
    code = (
        "from own import blocked; from softdyn.validation.processes import in_processes\n"
        "print(*in_processes(blocked, [()] * 2, 2), blocked())"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert found.stdout.split() == ["True", "True", "False"], found.stderr


def test_workers_end_with_their_parent():
    code = (
        "import os; from softdyn.validation.processes import in_processes\n"
        "for _ in in_processes(os.getpid, [()], 2): os.kill(os.getpid(), 9)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    process.communicate(timeout=PATIENCE)  # returns when the last of them, busy or not, is gone


# --- changed ------------------------------------------------------------------------------------


def prints(*controllers, robot="finger"):
    jobs = benchmark.sweep([Case(robot, name, "tracking", 20.0) for name in controllers]).jobs()
    return [job.fingerprint for job in jobs]


def test_fingerprints_are_stable_and_distinct(folder):
    names = ("own.py:Push", "own.py:Nan", "ic", "uic", "clf-qp")
    first = prints(*names)
    assert len(set(first)) == len(names)
    assert prints(*names) == first
    code = f"from tests.validation.studies.test_benchmark import prints; print(prints(*{names}))"
    root = ROOT
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.splitlines()[-1] == str(first)


@pytest.mark.parametrize("file", ["own.py", "neighbour.py"])
def test_a_changed_controller_redoes_its_cases_alone(call, reference, file):
    shutil.copytree(reference, "out")
    before = {p: p.stat().st_mtime_ns for p in Path("out/runs").rglob("*.json")}
    with open(file, "a") as stream:
        stream.write("# changed\n")
    assert call(*GRID, *CONTROLLERS, "--out", "out")[0] == 0
    redone = {p.parent.name for p in before if p.stat().st_mtime_ns != before[p]}
    kept = {p.parent.name for p in before if p.stat().st_mtime_ns == before[p]}
    assert kept == {"soft-id-clf-qp"}
    assert len(redone) == 1
    assert redone.pop() == "Push"


def test_a_changed_robot_redoes_its_cases_alone(call, folder):
    grid = ["--robots", "finger", "arm.urdf", "--controllers", "own.py:Push", *GRID[2:]]
    assert call(*grid, "--out", "out")[0] == 0
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in Path("out/runs").rglob("*.json")}
    Path("arm.urdf").write_text(finger(damping=0.02))
    assert call(*grid, "--out", "out")[0] == 0
    changed = [p for p in before if p.stat().st_mtime_ns != before[p][0]]
    assert {p.parent.parent.name for p in changed} == {"arm"}
    assert len(changed) == 3
    for path in changed:  # the numbers of the new robot, not of the old one
        new, old = json.loads(path.read_bytes()), json.loads(before[path][1])
        assert new["final_error_cm"] != old["final_error_cm"]


def test_what_belongs_to_a_controller(tmp_path):
    (tmp_path / "pack").mkdir()
    (tmp_path / "softdyn").mkdir()
    for name, text in {
        "mine.py": "import numpy, a\nfrom softdyn import load\n"
        "from pack import part\nfrom b import x",
        "a.py": "import a, c.d",
        "b.py": "",
        "other.py": "",
        "softdyn/__init__.py": "",
        "pack/__init__.py": "",
        "pack/part.py": "",
    }.items():
        (tmp_path / name).write_text(text)
    found = sources.imported(tmp_path / "mine.py")
    assert [str(p.relative_to(tmp_path.resolve())) for p in found] == [
        "a.py", "b.py", "mine.py", "pack/__init__.py", "pack/part.py",
    ]  # fmt: skip


# --- what it says -------------------------------------------------------------------------------


def strict(text):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_the_json_contract(call, reference):
    shutil.copytree(reference, "out")
    names = ["soft-id-clf-qp", "id-clf-qp", "own.py:Nan"]
    code, text, _ = call(*GRID, "--controllers", *names, "--out", "out", "--json", "-")
    report = strict(text)
    assert code == 0
    assert {"rows", "wall_s", "simulated_s"} < report.keys()
    assert report["wall_s"] > 0
    soft, hard, own = report["rows"]
    keys = {"robot", "controller", "sp_mean_cm", "sp_std_cm", "tt_mean_cm2", "tt_std_cm2",
            "failed", "paper"}  # fmt: skip
    assert all(keys < row.keys() for row in report["rows"])
    assert [row["controller"] for row in report["rows"]] == names
    assert soft["paper"] == {
        "sp_mean_cm": 0.08, "sp_std_cm": 0.09, "tt_mean_cm2": 0.53, "tt_std_cm2": 0.26,
    }  # fmt: skip
    assert hard["paper"] is None
    assert own["paper"] is None
    figures = list(soft["trajectories_cm2"].values())
    assert soft["tt_mean_cm2"] == pytest.approx(np.mean(figures))
    assert soft["tt_std_cm2"] == pytest.approx(np.std(figures))
    # failed runs are marked, and a mean over them is None
    assert own["tt_mean_cm2"] is None
    assert own["tt_std_cm2"] is None
    assert [run["value"] for run in own["failed"]] == [20, 25, 40]
    assert all("expected finite numbers" in run["reason"] for run in own["failed"])
    assert strict(Path("out/results.json").read_text()) == {"rows": report["rows"]}
    table = Path("out/table.md").read_text()
    assert "| finger | own.py:Nan | - | - | - | none | - | - | - | 3 of 3 |" in table
    assert "- finger, own.py:Nan, ω = 20π: the controller failed at t = 0 s" in table


def test_json_to_a_file(call, reference):
    shutil.copytree(reference, "out")
    code, text, _ = call(*GRID, *CONTROLLERS, "--out", "out", "--json", "report.json")
    assert code == 0
    assert "Soft ID-CLF-QP" in text
    assert len(strict(Path("report.json").read_text())["rows"]) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--robots", "nobody"], "nobody"),
        (["--controllers", "nobody"], "controllers: expected soft-id-clf-qp"),
        (["--controllers", "own.py:Nobody"], "a class in own.py"),
        (["--controllers", "no.py:Nobody"], "an existing Python file"),
        (["--controllers", "own.py:Unbuildable"], "expected a controller, got KeyError in line"),
        (["--robots", "arm.urdf", "--controllers", "ic"], "error: "),  # it has no gains
        (["--thetas", "--omegas"], "--thetas, --omegas: expected at least one"),
        (["--out", "own.py"], "own.py: expected a folder"),
        (["--json", "no/where.json"], "no/where.json: expected a writable file"),
    ],
)
def test_bad_input(call, folder, arguments, message):
    base = {"--robots": ["finger"], "--controllers": ["own.py:Push"], "--thetas": [],
            "--omegas": ["20"], "--out": ["out"]}  # fmt: skip
    given = [word for word in arguments if word in base]
    rest = [word for name in base if name not in given for word in (name, *base[name])]
    code, text, errors = call(*rest, *arguments)
    assert code == 2
    assert text == ""
    lines = [line for line in errors.splitlines() if line and "own words" not in line]
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert message in lines[0]
    assert not stamps("out")


def test_an_error_in_a_users_code_is_told_by_its_traceback(call):
    code, text, errors = call(
        "--robots", "finger", "--controllers", "own.py:Broken", "--thetas", "--omegas", "20",
        "--out", "out",
    )  # fmt: skip
    assert (code, text) == (1, "")
    assert "own.py" in errors
    assert "ZeroDivisionError" in errors


def test_plots_and_no_plots_exclude_each_other(call):
    assert call("--plots")[0] == 2  # the fixture adds --no-plots


# --- the parts ----------------------------------------------------------------------------------


def test_the_papers_grid():
    cases = benchmark.grid(("finger", "helix", "spirob"), ("ic", "uic"))
    assert len(cases) == 3 * 2 * 9
    assert len({case.name for case in cases}) == len(cases)
    assert [c.value for c in cases[:9]] == [*paper.THETAS, *paper.OMEGAS]


def test_a_grid_has_every_case_once():
    cases = benchmark.grid(("finger", "finger"), ("ic", "ic"), (0, -0.0, 0.5, 0.50), (1, 1.0))
    assert cases == [
        Case("finger", "ic", "set_point", 0.0),
        Case("finger", "ic", "set_point", 0.5),
        Case("finger", "ic", "tracking", 1.0),
    ]


def test_names_of_cases_never_collide():
    robots = ("finger", "a/arm.urdf", "b/arm.urdf", "a/arm_urdf", "../arm.urdf")
    cases = benchmark.grid(
        robots, ("ic", "x.py:C", "x.py:c"), (), (1 / 3, 0.333333, 0.3333333, 1e9)
    )
    names = [case.name for case in cases]
    assert len({name.lower() for name in names}) == len(cases) or len(set(names)) == len(cases)
    assert all(".." not in name and name.count("/") == 2 for name in names)


@pytest.mark.parametrize("value", [0.0, 0.5, 20.0, 1 / 3, 1e-7, 123456789.0])
def test_numbers_as_text(value):
    assert float(number_text(value)) == value


def test_rows_need_results(tmp_path):
    with refused("set_point_0.json", "none"):
        benchmark.benchmark_rows(benchmark.grid(("finger",), ("ic",)), tmp_path)


def test_processes():
    assert sorted(in_processes(divmod, [(7, 2), (9, 4)], 1)) == [(2, 1), (3, 1)]
    assert sorted(in_processes(os.path.abspath, [(".",)], 2)) == [os.getcwd()]
    with pytest.raises(WorkerKilled, match="to continue where it stopped"):
        list(in_processes(os._exit, [(9,)], 2))
