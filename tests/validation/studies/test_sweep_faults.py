"""Faults that a sweep once found late, or not at all, and what its files may name."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn.controllers import Impedance
from softdyn.safety import Surroundings
from softdyn.validation import Scene, paper, simulate
from softdyn.validation.studies import sweep_report
from tests.support import ROOT
from tests.support.refused import refused
from tests.support.sweeps import results

ONE = 'robots = "finger"\ncontrollers = "ic"\ntargets.theta = 0.5\nrun.duration = 0.02\n'


def run(folder, call, text):
    (folder / "sweep.toml").write_text(text)
    code, out, err = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert code == 0, err
    return json.loads(out)


def simulated(**options):
    model = softdyn.load("finger")
    controller = Impedance(model, Impedance.published["finger"])
    return simulate(model, controller, paper.set_point("finger", 0.5), duration=0.02, **options)


def test_a_sweep_may_vary_the_start(folder, call):
    run(folder, call, ONE + "run.v0 = [[0, 0, 0, 0], [1, 0, 0, -1]]\nrun.q0 = [[0.1, 0, 0, 0]]\n")
    found = {tuple(r["inputs"]["options"]["v0"]): r["final_error_cm"] for r in results(Path("out"))}
    assert found == {
        v0: simulated(v0=np.array(v0), q0=np.array([0.1, 0, 0, 0])).final_error_cm
        for v0 in ((0, 0, 0, 0), (1, 0, 0, -1))
    }


def test_a_scene_and_obstacles_are_files_on_which_a_case_depends(folder, call):
    shutil.copy(ROOT / "docs/examples/finger_scene.xml", folder / "scene.xml")
    (folder / "around.toml").write_text("[[half_space]]\nnormal = [0, 0, 1]\noffset = -0.3\n")
    for key, file in (("plant", "scene.xml"), ("surroundings", "around.toml")):
        text = ONE + f'run.{key} = "{file}"\n'
        assert run(folder, call, text)["ran"] == 1
        assert run(folder, call, text)["ran"] == 0
        (folder / file).write_text((folder / file).read_text() + "\n")
        assert run(folder, call, text)["ran"] == 1
    found = {tuple(r["inputs"]["options"]): r["final_error_cm"] for r in results(Path("out"))}
    scene = Scene(softdyn.load("finger"), folder / "scene.xml")
    assert found["duration", "plant"] == simulated(plant=scene).final_error_cm
    around = Surroundings.of({"half_space": [{"normal": [0, 0, 1], "offset": -0.3}]})
    assert found["duration", "surroundings"] == simulated(surroundings=around).final_error_cm


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('run.plant = "scene.xml"', "run.plant: expected a readable file, got "),
        ('run.plant = "pendulum.urdf"', "run.plant: expected"),
        ('run.plant = "pendulum.urdf"\nplant.mass = 2', "plant: expected a file here, or a table"),
        ('run.surroundings = "none.toml"', "run.surroundings: expected a readable file, got "),
        ('run.surroundings = "own.py"', "expected a TOML file"),
        ('run.observer = "none.py:X"', "run.observer: expected a readable file, got "),
        ('run.observer = "tip_force"', "run: sensors: expected at least one <sensor>"),
        ("run.q0 = [[9, 0, 0, 0]]", "run: q0: expected joint 'joint1' within its limits"),
        ("run.v0 = [[0, 0, 0]]", "run: v0: expected finite numbers of shape (4,)"),
        ('run.name = "x"', "[run]: name: expected one of duration, period"),
        ('run.rig = "file"', "[run]: rig: expected one of duration, period"),
        ('run.integrater = "rk4"', "did you mean 'integrator'"),
    ],
)
def test_what_a_run_would_refuse_is_refused_before_any_case(folder, call, more, message):
    (folder / "sweep.toml").write_text(f"{ONE}{more}\n")
    for arguments in ((), ("--dry-run",)):
        code, out, err = call(folder / "sweep.toml", "--out", "out", *arguments)
        assert (code, out) == (2, "")
        assert err.startswith(f"error: {folder / 'sweep.toml'}: ")
        assert message in err
        assert err.count("\n") == 1
        assert not Path("out").exists()


def test_gains_may_differ_between_robots(written):
    """Those of a class of one's own, of one controller and of all; each with an axis of its own."""
    sweep = written(
        'robots = ["finger", "helix"]\ncontrollers = ["own.py:Spring", "ic"]\n'
        "targets.theta = 0.5\n"
        "[gains]\nKp = { finger = 10, helix = 20 }\neps = { helix = 0.5, default = 0.1 }\n"
        '[gains."own.py:Spring"]\nstiffness = { finger = [1, 2], default = 3 }\n'
        "[gains.ic]\neps = { finger = 0.2, default = 0.3 }\n"
    )
    found = [(c.robot, c.controller, c.parameters) for c in sweep.cases]
    own = [(robot, dict(gains)) for robot, name, gains in found if name != "ic"]
    assert own == [
        ("finger", {"Kp": 10, "eps": 0.1, "stiffness": 1}),
        ("finger", {"Kp": 10, "eps": 0.1, "stiffness": 2}),
        ("helix", {"Kp": 20, "eps": 0.5, "stiffness": 3}),
    ]
    ic = [(robot, gains["Kp"], gains["eps"]) for robot, name, gains in found if name == "ic"]
    assert ic == [("finger", 10, 0.2), ("helix", 20, 0.3)]
    with refused("sweep.toml: gains.Kp", "those of finger"):
        written(
            'robots = ["finger", "helix"]\ncontrollers = "ic"\ntargets.theta = 0.5\n'
            "gains.Kp = { finger = 10 }\n"
        )


@pytest.mark.parametrize(("controller", "unit"), [("ic", " (1/s²)"), ("own.py:Spring", "")])
def test_a_gain_of_a_class_of_one_s_own_has_no_unit(written, controller, unit):
    sweep = written(
        f'robots = "finger"\ncontrollers = "{controller}"\ntargets.theta = 0.5\n'
        "gains.Kp = [1, 2]\nrun.duration = 0.02\n"
    )
    rows = [(case, {"outcome": "done", "final_error_cm": 1.0}) for case in sweep.cases]
    titles = next(csv.reader(sweep_report.to_csv(sweep, rows).splitlines()))
    assert f"gains.Kp{unit}" in titles
    assert f"- Kp{unit}: 1, 2" in sweep_report.to_markdown(sweep, rows)
    assert f"| Kp{unit} |" in sweep_report.to_markdown(sweep, rows)
