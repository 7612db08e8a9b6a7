"""Targets of one's own in a sweep: files, classes, and equilibria that are found by themselves."""

import json
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import statics
from softdyn.controllers import Impedance
from softdyn.validation import paper, simulate
from softdyn.validation.studies import study_targets
from softdyn.validation.studies.engine import sources
from tests.support.command import command
from tests.support.sweeps import results
from tests.validation.loop.test_trajectories import CLASS, circle

OWN_TARGETS = """
robots = "finger"
controllers = "ic"
depends = ["own_path.toml"]
rows = ["controller"]
[targets]
file = "path.csv"
class = "own_path.py:Line"
{more}
[run]
duration = 0.1
"""


@pytest.fixture
def paths(folder):
    """A user's folder with a path in a file, and one of a class that reads a file."""
    rows = [",".join(map(repr, map(float, row))) for row in np.column_stack(circle())]
    (folder / "path.csv").write_text("\n".join(["t,x,y,z", *rows]) + "\n")
    (folder / "own_path.toml").write_text("slope = 0.02\n")
    read = "slope = float(open(__file__[:-2] + 'toml').read().split('=')[1])\n"
    (folder / "own_path.py").write_text(read + CLASS)
    return folder


def test_a_sweep_follows_files_and_classes(paths, call):
    (paths / "sweep.toml").write_text(OWN_TARGETS.format(more=""))
    code, out, err = call(paths / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert code == 0, err
    assert [*json.loads(out)["cells"]] == ["ic/path.csv", "ic/own_path.py:Line"]
    model = softdyn.load("finger")
    for result in results(Path("out")):
        kind, text = result["inputs"]["kind"], result["inputs"]["target"]
        assert (kind, text) in {("once", "path.csv"), ("class", "own_path.py:Line")}
        controller = Impedance(model, Impedance.published["finger"])
        log = simulate(model, controller, paper.trajectory(model, paths / text), duration=0.1)
        assert result["mse_cm2"] == log.mse_cm2
    # a path that repeats is another case, and runs for two cycles
    (paths / "sweep.toml").write_text(
        OWN_TARGETS.format(more="periodic = true").partition("[run]")[0]
    )
    _, out, _ = call(paths / "sweep.toml", "--out", "out", "--dry-run", "--json", "-")
    report = json.loads(out)
    assert (report["missing"], report["simulated_s"]) == (2, 4.0 + 0.5)


def test_a_case_runs_again_when_a_file_that_it_reads_has_changed(paths, call):
    (paths / "sweep.toml").write_text(OWN_TARGETS.format(more=""))

    def ran(*more):
        code, out, err = call(
            paths / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-", *more
        )
        assert code == 0, err
        report = json.loads(out)
        return report["missing" if more else "ran"]

    assert ran() == 2
    assert ran() == 0
    (paths / "path.csv").write_text((paths / "path.csv").read_text().replace("0.21", "0.2100001"))
    assert ran("--dry-run") == 1
    (paths / "own_path.toml").write_text("slope = 0.03\n")
    assert ran("--dry-run") == 2
    assert ran() == 2


def test_the_files_of_a_trajectory_are_sent_along(paths):
    """Also one outside of the class's folder; a worker copies them where the class finds them."""
    (paths / "code").mkdir()
    (paths / "code" / "there.py").write_text(
        "import os\nfrom softdyn import SetPoint\n"
        "with open(os.path.join(os.path.dirname(__file__), '..', 'own_path.toml')) as file:\n"
        "    SLOPE = float(file.read().split('=')[1])\n"
        "class There:\n    duration = 1 + SLOPE\n"
        "    def __init__(self, model): pass\n"
        "    def __call__(self, t): return SetPoint([0.2, 0, 0])\n"
    )
    source = sources.of_trajectory("code/there.py:There", paths, ["own_path.toml"])
    model, contents = softdyn.load("finger"), source.contents()
    for name in ("code/there.py", "own_path.toml"):
        (paths / name).unlink()
    found = sources.trajectory_of(source, "class", model, contents)
    assert found.duration == 1.02


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("path.csv", "none.csv", "targets.file: "),
        (
            "path.csv",
            "own_path.py:Line",
            "targets.file: expected a CSV file, got 'own_path.py:Line'",
        ),
        ('"own_path.py:Line"', "3", "targets.class: expected FILE.py:CLASS, got 3"),
        ("Line", "Raising", "own_path.py:Raising: expected a trajectory, got ZeroDivisionError"),
        ("own_path.toml", "none.toml", "depends: expected files that exist, got 'none.toml'"),
        ('file = "path.csv"', "periodic = true", "periodic: expected a file of a trajectory"),
        ("[run]", "periodic = 1\n[run]", "periodic: expected true or false, got 1"),
        ("[run]", "equilibria = true\n[run]", "expected only values of theta and omega"),
    ],
)
def test_what_is_wrong_with_one_s_own_targets_is_told_in_one_line(
    paths, refused, old, new, message
):
    refused(OWN_TARGETS.format(more=""), old, new, message)


def test_run_follows_a_path_of_a_file(paths):
    done = command(
        "run", "finger", "ic", "--trajectory", "path.csv", "--periodic", "--duration", "0.1",
        "--json", "-", "--no-verdict", cwd=paths,
    )  # fmt: skip
    assert done.code == 0, done.err
    model = softdyn.load("finger")
    goal = paper.trajectory(model, paths / "path.csv", periodic=True)
    log = simulate(model, Impedance(model, Impedance.published["finger"]), goal, duration=0.1)
    assert json.loads(done.out)["mse_cm2"] == log.mse_cm2


def test_automatic_equilibria_begin_with_moderate_ones():
    """One alone lies in the nearer half of all that are found; several go on to the outermost."""
    model = softdyn.load("finger")
    start = statics.rest(model).y
    spread = [np.linalg.norm(one.y - start) for one in statics.spread_rests(model, 8)]

    def away(count):
        found = study_targets.points(model, count)
        assert len(found) == count
        return [np.linalg.norm(np.array(point) - start) for point in found]

    assert away(1)[0] < np.median(spread)
    four = away(4)
    assert four == sorted(four)
    assert four[0] == away(1)[0]
    assert abs(four[-1] - max(spread)) < 1e-4
