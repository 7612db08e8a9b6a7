"""`softdyn run --from`: a recorded run is repeated from a shell, in another folder."""

import json
import os
import shutil
import sys

import numpy as np
import pytest

from softdyn.validation import Log
from softdyn.validation.loop.settings import declarations
from tests.support import ROOT
from tests.support.command import command

OWN = """
from types import SimpleNamespace
from beside import SIGNS

class Push:
    def __init__(self, model, gains):
        self.u = [gains["force"] * sign for sign in SIGNS]

    def __call__(self, state, reference):
        return SimpleNamespace(u=self.u)
"""
RIG = "lag = 0.02\nnoise = 0.001\nseed = 3\n[plant]\npayload = {payload}\nstiffness = 1.1\n"
TIMES = ("--duration", "0.1", "--timestep", "0.000125", "--integrator", "rk4")


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A user's folder as the working directory, with a run of a controller of their own."""
    folder = tmp_path / "home"
    folder.mkdir()
    (folder / "own.py").write_text(OWN)
    (folder / "beside.py").write_text("SIGNS = (1, -1)\n")
    (folder / "gains.toml").write_text("force = 0.2\n")
    (folder / "rig.toml").write_text(RIG.format(payload=0.02))
    monkeypatch.chdir(folder)
    given = ("--gains", "gains.toml", "--theta", "0.5", "--rig", "rig.toml", "--log", "run.npz")
    code, _, err = command("run", "finger", "own.py:Push", *given, *TIMES)
    assert (code, err) == (1, "")  # a constant input reaches nothing
    return folder


def repeat(*arguments):
    code, out, err = command("run", "--from", *arguments, "--json", "-")
    return code, json.loads(out) if out else None, err


def test_every_value_of_a_run_is_in_its_log(home):
    record = Log.load("run.npz").record
    settings = record["settings"]
    assert {*settings} == {*declarations()}
    assert (settings["integrator"], settings["timestep"]) == ("rk4", 0.000125)
    rig = settings["rig"]
    assert (rig["lag"], rig["noise"], rig["seed"]) == (0.02, 0.001, 3)
    assert (rig["plant"]["payload"], rig["plant"]["stiffness"]) == (0.02, 1.1)
    assert record["controller"]["with"]["gains"] == {"force": 0.2}


def test_a_run_is_equal_to_the_bit_in_another_folder(home, tmp_path, monkeypatch):
    shutil.copytree(home, tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    code, report, err = repeat(os.path.join("moved", "run.npz"))
    assert (code, err, report["repeated"]["equal"]) == (0, "", True)
    assert report["verdict"] == "not reached"  # which decides nothing here


def test_a_file_outside_the_record_s_folder_is_asked_for(home, tmp_path):
    away = tmp_path / "away"
    away.mkdir()
    (away / "run.npz").write_bytes((home / "run.npz").read_bytes())
    code, _, err = command("run", "--from", str(away / "run.npz"))
    assert code == 2
    assert err.startswith("error: own.py: ")
    assert "--in DIR" in err
    assert err.count("\n") == 1
    code, report, _ = repeat(str(away / "run.npz"), "--in", ".")
    assert (code, report["repeated"]["equal"]) == (0, True)


def test_another_payload_is_said_and_stands_in_the_log(home):
    (home / "rig.toml").write_text(RIG.format(payload=0.04))
    code, report, _ = repeat("run.npz", "--rig", "rig.toml", "--log", "again.npz")
    found = report["repeated"]
    assert code == 1
    assert found["equal"] is False
    assert found["difference"] > 0
    assert found["causes"] == ["rig.plant.payload 0.02 → 0.04"]
    assert Log.load("again.npz").record["repeats"]["changed"] == ["rig"]


def test_another_seed_is_said_and_is_that_of_a_run_with_it(home):
    _, report, _ = repeat("run.npz", "--seed", "4", "--log", "again.npz")
    assert report["repeated"]["causes"] == ["rig.seed 3 → 4"]
    assert Log.load("again.npz").record["repeats"]["changed"] == ["seed"]
    given = ("--gains", "gains.toml", "--theta", "0.5", "--rig", "rig.toml", "--log", "own.npz")
    command("run", "finger", "own.py:Push", *given, *TIMES, "--seed", "4")
    seen = [Log.load(name).q_seen for name in ("run.npz", "again.npz", "own.npz")]
    assert not np.array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[1], seen[2])


def test_changed_files_are_named_before_the_run(home, monkeypatch):
    monkeypatch.delitem(sys.modules, "beside")  # another process would read it anew
    (home / "beside.py").write_text("SIGNS = (1, -0.5)\n")
    code, report, err = repeat("run.npz")
    assert code == 1
    assert err == "note: beside.py has changed\n"
    assert "beside.py has changed" in report["repeated"]["causes"]


def test_a_case_of_a_sweep_is_repeated(home):
    (home / "sweep.toml").write_text(
        'robots = ["finger"]\ncontrollers = ["own.py:Push"]\n[targets]\ntheta = 0.5\n'
        '[gains."own.py:Push"]\nforce = 0.2\n[run]\nduration = 0.05\n[rig]\nlag = 0.02\n'
    )
    assert command("sweep", "sweep.toml", "--out", "out", "--jobs", "1")[0] == 0
    (case,) = (home / "out" / "cases").rglob("*.json")
    assert command("run", "--from", str(case))[0] == 2  # own.py lies elsewhere
    code, report, _ = repeat(str(case), "--in", ".")
    assert (code, report["repeated"]["equal"]) == (0, True)


@pytest.mark.parametrize(("arguments", "expected"), [
    (["finger", "ic"], "not allowed with a ROBOT"),
    (["--targets", "none.csv"], "none.csv"),
])  # fmt: skip
def test_what_a_record_has_is_not_given_again(home, arguments, expected):
    code, _, err = command("run", "--from", "run.npz", *arguments)
    assert code == 2
    assert expected in err


def test_a_file_without_a_record_is_one_line(home):
    (home / "plain.json").write_text("{}")
    for file in ("plain.json", "gains.toml", "none.npz"):
        code, _, err = command("run", "--from", file)
        assert code == 2
        assert err.startswith(f"error: {file}")
        assert err.count("\n") == 1


def test_a_rollout_has_no_controller(home):
    assert command("rollout", "finger", "--seconds", "0.02", "--log", "fall.npz")[0] == 0
    code, _, err = command("run", "--from", "fall.npz")
    assert code == 2
    assert "a rollout" in err


AROUND = "[[half_space]]\nnormal = [0, 0, 1]\noffset = -0.3\n"
PATH = "t,x,y,z\n0,0.2,0,0.1\n0.05,0.21,0,0.1\n0.1,0.2,0,0.12\n"


@pytest.mark.parametrize(
    ("law", "gains"),
    [("own.py:Push", ("--gains", "gains.toml")), ("soft-id-clf-qp", ()), ("mpc", ())],
)
@pytest.mark.parametrize(
    ("file", "text", "option"),
    [("around.toml", AROUND, "--obstacles"), ("path.csv", PATH, "--trajectory")],
)
def test_a_repetition_with_another_aim_or_obstacles_is_the_run_that_had_them(
    home, law, gains, file, text, option
):
    """Without --gains, too: the controller is made again as the record says."""
    (home / file).write_text(text)
    kind = option == "--trajectory"
    begin = ("run", "finger", law, *gains, "--duration", "0.1")
    assert command(*begin, "--theta", "0.5", "--log", "first.npz")[0] in (0, 1)
    aim = (option, file) if kind else ("--theta", "0.5", option, file)
    assert command(*begin, *aim, "--log", "asked.npz")[0] in (0, 1)
    _, report, err = repeat("first.npz", option, file, "--log", "again.npz")
    assert err == ""
    asked, again, first = (Log.load(f"{n}.npz") for n in ("asked", "again", "first"))
    np.testing.assert_array_equal(asked.q, again.q)
    np.testing.assert_array_equal(asked.y_ref, again.y_ref)
    assert kind == (not np.array_equal(first.y_ref, again.y_ref))
    assert not kind or not report["repeated"]["equal"]
    assert kind or again.least_reserve == asked.least_reserve != first.least_reserve


def test_a_repetition_takes_targets_of_the_robot_s_tasks(home):
    """The record's controller had no tasks: it is made again with those of the robot's file."""
    text = (ROOT / "urdf/finger.urdf").read_text("utf-8")
    way = '<task frame="tip"/><task frame="tip" name="way" kind="axis" direction="1 0 0"/>'
    (home / "two.urdf").write_text(text.replace('<task frame="tip"/>', way), "utf-8")
    head = "t,tip.x,tip.y,tip.z,way.dx,way.dy,way.dz"
    rows = ("0,0.13,0,-0.13,0,0,-1", "0.1,0.12,0,-0.13,0,0,-1")
    (home / "paths.csv").write_text("\n".join((head, *rows)))
    begin = ("run", "two.urdf", "mpc", "--no-verdict")
    aim = ("--target", "0.13", "0", "-0.13", "--duration", "0.1", "--log", "first.npz")
    assert command(*begin, *aim)[0] == 0
    asked = (*begin, "--targets", "paths.csv", "--duration", "0.1", "--log", "asked.npz")
    assert command(*asked)[0] == 0
    code, _, err = repeat("first.npz", "--targets", "paths.csv", "--log", "again.npz")
    assert (code, err) == (1, "")
    first, again = Log.load("asked.npz"), Log.load("again.npz")
    np.testing.assert_array_equal(first.q, again.q)
    assert first.columns("tasks") == again.columns("tasks")
