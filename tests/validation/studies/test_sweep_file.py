"""Sweep files: what they mean, and what is wrong in them."""

import csv
import io
import shutil
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint
from softdyn.controllers import Gains, Mpc
from softdyn.controllers.registry import CONTROLLERS
from softdyn.validation import paper, simulate
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.observation import make_observer
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.studies import study_targets, sweep_report
from softdyn.validation.studies.axes import MAX_CASES, draw
from softdyn.validation.studies.engine import cluster as dask
from softdyn.validation.studies.engine import sources, worker
from softdyn.validation.studies.sweep import parameter
from softdyn.validation.studies.sweep_file import read_sweep
from tests.support import ROOT
from tests.support.command import command
from tests.support.refused import refused
from tests.support.sweeps import FINGER, PENDULUM


def test_a_grid_is_every_combination_the_last_fastest(written):
    sweep = written(
        'robots = ["finger", "pendulum.urdf"]\ncontrollers = ["ic", "uic"]\n'
        "[targets]\nomega = 0.5\ntheta = [0, 1.5]\npoint = [[0.1, 0, 0], [0, 0, -0.1]]\n"
        "[gains]\neps = [0.02, 0.1]\nKp = 70\n"
        "[plant]\ncontacts = [false, true]\n[run]\nperiod = 0.01\n"
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
        (
            c.robot,
            c.controller,
            c.kind,
            c.value,
            c.parameters["eps"],
            c.options["plant"]["contacts"],
        )
        for c in cases
    ]  # fmt: skip
    assert found == expected
    assert {c.parameters["Kp"] for c in cases} == {70.0}
    grids = [(c.kind, c.grid(sweep.models[c.robot]), c.sample) for c in cases]
    assert {(g.period, g.timestep, sample) for _, g, sample in grids} == {(0.01, 5e-4, None)}
    assert {grid.duration for kind, grid, _ in grids if kind == "tracking"} == {8.0}
    assert {grid.duration for kind, grid, _ in grids if kind != "tracking"} == {10.0}
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
    published = CONTROLLERS["ic"].published["finger"]
    assert Gains(**case.parameters) == replace(published, Kp=100.0, eps=0.01)
    grid = case.grid(sweep.models["finger"])
    assert (grid.period, grid.duration) == (paper.setup("finger").period, 0.2)
    assert (sweep.figure, sweep.logs) == ("final_error_cm", False)


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
    assert sweep.cases[0].parameters["eps"] == CONTROLLERS["soft-id-clf-qp"].published["finger"].eps
    assert "u_ref: (0.1, -0.2), 0" in "\n".join(sweep_report._varied(sweep))
    overlay = (ROOT / "docs" / "examples" / "soft_ur5.xml").read_text()
    (folder / "mine.xml").write_text(overlay)
    sweep = written("""
robots = "ur5"
annotations.ur5 = "mine.xml"
controllers = ["mpc", "own.py:Spring"]
targets.point = [0.5, 0.2, 0]
run.duration = 0.02
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
    ({"robots": ""}, "expected robots, got none"),
    ({"robots": "robots = []"}, "robots: expected a text, or a list of distinct texts, got []"),
    ({"robots": 'robots = ["finger", "finger"]'}, "robots: expected a text, or a list of distinct"),
    ({"robots": "robots = 3"}, "robots: expected a text, or a list of distinct texts, got 3"),
    ({"robots": 'robots = ["fingr"]'}, "robots: expected a URDF file or a name such as finger"),
    ({"robots": 'robots = ["none.urdf"]'}, "robots: expected an existing file"),
    ({"robots": 'robots = ["broken.urdf"]'}, "in broken.urdf"),
    ({"robots": 'robots = ["ur5"]'}, "robots: expected robots with actuators"),
    ({"robots": 'robots = ["pendulum.urdf"]'},
     "ic for pendulum.urdf: gains: expected Gains(Kp="),
    ({"controllers": 'controllers = ["pid"]'}, "controllers: expected soft-id-clf-qp"),
    ({"controllers": 'controllers = ["none.py:C"]'}, "controllers: expected an existing Python"),
    ({"controllers": 'controllers = ["own.py:C"]'}, "controllers: expected a class in"),
    ({"controllers": 'controllers = ["bad.py:C"]'}, "NameError in line 1"),
    ({"targets": ""}, "expected [targets], got none"),
    ({"targets": "[targets]\nphi = 1"}, "[targets]: phi: expected one of equilibria, periodic"),
    ({"targets": "[targets]\nomega = 0"}, "targets.omega: expected a finite number > 0, got 0"),
    ({"targets": "[targets]\ntheta = nan"}, "targets.theta: expected a finite number, got nan"),
    ({"targets": "[targets]\npoint = 1"}, "[targets]: point: expected [x, y, z] in m"),
    ({"targets": "[targets]\npoint = [1, 2]"}, "targets.point: expected [x, y, z] in m"),
    ({"targets": "[targets]\npoint = [[1, 2, inf]]"}, "targets.point: expected a finite number"),
    ({"targets": "[targets]\npoint = []"}, "[targets]: point: expected [x, y, z] in m"),
    ({"targets": "targets = 1"}, "[targets]: expected a table, got 1"),
    ({"more": "[gain]\nKp = 1"}, "gain: expected one of robots, controllers"),
    ({"more": "[gains]\nkp = 1"}, "[gains]: kp: expected one of Kp, eps"),
    ({"more": "[gains]\nKp = -1"}, "gains.Kp: expected a positive number, got -1"),
    ({"more": "[gains]\nKp = true"}, "gains.Kp: expected a positive number, got True"),
    ({"more": '[gains]\nKp = "big"'}, "gains.Kp: expected a positive number, got 'big'"),
    ({"more": "[gains]\nKp = []"}, "gains.Kp: expected at least one value, got []"),
    ({"more": "[gains]\nKp = [1, 1.0]"}, "gains.Kp: expected distinct values, got [1, 1.0]"),
    ({"more": "[gains]\nKp = {from = 1, to = 2}"}, "gains.Kp: expected a range {from, to, count}"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, count = 1}"},
     "gains.Kp: count: expected a whole number from 2"),
    ({"more": "[gains]\nKp = {from = 2, to = 1, count = 3}"},
     "gains.Kp: expected a lower end below the upper, got [2.0, 1.0]"),
    ({"more": "[gains]\nw1 = {from = 0, to = 1, count = 3, spacing = 'log'}"},
     "gains.w1: expected a finite number > 0, got 0"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, count = 3, spacing = 'cubic'}"},
     "gains.Kp: spacing: expected linear or log, got 'cubic'"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, count = 3, step = 3}"},
     "gains.Kp: step: expected one of"),
    ({"more": "[gains]\nKp = {uniform = [1, 2]}"},
     "samples: expected a table with the count of samples of gains.Kp, got none"),
    ({"more": "[gains]\nKp = {uniform = [1]}\n[samples]\ncount = 2"},
     "gains.Kp: uniform: expected [lower, upper], got [1]"),
    ({"more": "[gains]\nKp = {uniform = [-1, 1]}\n[samples]\ncount = 2"},
     "gains.Kp: expected a positive number, got -1"),
    ({"more": "[gains]\nKp = {uniform = [1, 2], count = 3}\n[samples]\ncount = 2"},
     "gains.Kp: count: expected one of uniform, got 'count'"),
    ({"more": "[samples]\ncount = 2"}, "samples: expected a parameter with uniform or log_uniform"),
    ({"more": "[samples]\nseed = 2"}, "[samples]: expected count, got none"),
    ({"more": "[samples]\ncount = 2\nseed = -1"}, "[samples]: seed: expected a whole number"),
    ({"more": "[plant]\nmasses = 1"}, "plant.masses: expected one of contacts, friction"),
    ({"more": "[run]\nperiod = 0"}, "run.period: expected a finite number > 0, got 0"),
    ({"more": "[plant]\ncontacts = 1"}, "plant.contacts: expected true or false, got 1"),
    ({"more": "[plant]\ncontacts = {uniform = [0, 1]}\n[samples]\ncount = 2"},
     "plant.contacts: expected true or false"),
    ({"more": "[run]\ntimestep = 0.0003"}, "finger, ic: timestep: expected an integer part of"),
    ({"more": "[run]\nduration = 1e9"}, "finger, ic: duration: expected at most"),
    ({"top": "logs = 1"}, "logs: expected true or false, got 1"),
    ({"top": 'figure = "time"'}, "figure: expected final_error_cm or"),
    ({"top": 'figure = "second_cycle_mse_cm2"'}, "figure: expected final_error_cm or mse_cm2"),
    ({"more": "[gains]\nKp = {from = 1, to = 2, count = 1000}\n"
              "eps = {from = 1, to = 2, count = 1000}"},
     f"expected at most {MAX_CASES} cases, got 1000000 = 1 robots × 1 controllers × 1 targets × "
     "1000 gains.Kp × 1000 gains.eps"),
    ({"controllers": 'controllers = ["ic", "own.py:Spring"]',
      "more": '[gains."own.py:Sprung"]\nk = 1'},
     "[gains]: own.py:Sprung: expected one of ic, own.py:Spring, got"),
    ({"more": "[gains.ic]\nkp = 1"}, "[gains]: [ic]: kp: expected one of Kp, eps"),
    ({"more": "[gains.ic]\nKp = [1, -1]"}, "gains.ic.Kp: expected a positive number, got -1"),
    ({"controllers": 'controllers = ["mpc"]', "more": "[gains.mpc]\nhorizn = 1"},
     "[gains]: [mpc]: horizn: expected one of horizon, speed, rate, memory, lag, delay, friction"),
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


def test_the_documents_sweeps_are_sweeps(folder, monkeypatch):
    examples = sorted((ROOT / "docs" / "examples").glob("sweep_*.toml"))
    assert examples
    for path in examples:
        assert read_sweep(path).cases
    for name in ("unseen.toml", "soft_ur5.xml", "three_sections.toml"):
        shutil.copy(ROOT / "docs" / "examples" / name, folder)
    done = command("new", "three_sections.toml", "--out", "three_sections.urdf", cwd=folder)
    assert done.code == 0, done.err
    # their equilibria take seconds and are tested elsewhere
    points = lambda model, count: [(0.1 * (k + 1), 0.0, 0.0) for k in range(count)]  # noqa: E731
    monkeypatch.setattr(study_targets, "points", points)
    cases = read_sweep(folder / "unseen.toml").cases
    assert len(cases) == 2 * 2 * 4 * 2  # robots, controllers, equilibria, changes
    lags = {(parameter(c, "rig.lag"), parameter(c, "gains.lag")) for c in cases}
    assert lags == {(None, None), (0.02, 0.02)}
    drag = (ROOT / "docs" / "forces.md").read_text().split("```python\n")[1].split("```")[0]
    (folder / "drag.py").write_text(drag)
    texts = [(ROOT / "docs" / name).read_text() for name in ("sweeps.md", "sweeps_reference.md")]
    blocks = [block for text in texts for block in text.split("```toml\n")[1:]]
    assert len(blocks) > 5
    for block in blocks:
        (folder / "block.toml").write_text(block.split("```")[0])
        assert read_sweep(folder / "block.toml").cases


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


def test_factors_by_joint_and_random_rigs(written, folder):
    """Every joint without its own value has its own draw, which is in the table with its seed."""
    sweep = written(BY_JOINT)
    first, second = sweep.cases[:2]
    assert len(sweep.cases) == 2 * 2 * 2
    springs = first.options["plant"]["stiffness"]
    assert [*springs] == ["each", "joint1", "joint2", "joint3", "joint4"]
    assert springs["joint1"] == 0.9
    assert len({springs[f"joint{k}"] for k in (2, 3, 4)}) == 3
    assert all(0.8 <= springs[f"joint{k}"] <= 1.2 for k in (2, 3, 4))
    second_spring = {parameter(case, "plant.stiffness.joint2") for case in sweep.cases}
    assert second_spring == {springs["joint2"], second.options["plant"]["stiffness"]["joint2"]}
    assert first.options["plant"]["damping"] == {"each": 1.1}
    rig = first.options["rig"]
    assert (rig["file"], rig["noise"], rig["lag"]) == (False, 0.001, 0.02)
    assert 0 < rig["latency"] < 0.01
    assert {parameter(c, "plant.mass.joint3") for c in sweep.cases} == {None, 1.2}
    table = list(csv.DictReader(io.StringIO(sweep_report.to_csv(sweep, [(first, {})]))))
    assert float(table[0]["plant.stiffness.joint2"]) == springs["joint2"]
    assert float(table[0]["rig.latency (s)"]) == rig["latency"]
    assert (table[0]["sample"], table[0]["seed"]) == ("0", "5")
    varied = sweep_report.to_markdown(sweep, [])
    assert "- stiffness of each joint: 2 uniform samples, seed 5" in varied
    assert "- stiffness.joint1: 0.9, 1.1" in varied
    other = written(BY_JOINT.replace("joint1 = [0.9, 1.1]", "joint1 = 1.0"))
    assert parameter(other.cases[0], "plant.stiffness.joint2") == springs["joint2"]


BY_JOINT = """
robots = "finger"
controllers = "ic"
rows = ["sample", "change", "plant.stiffness.joint1"]
targets.theta = 0.5
[plant.stiffness]
joint1 = [0.9, 1.1]
each = { uniform = [0.8, 1.2] }
[plant]
damping.each = 1.1
[rig]
lag = 0.02
noise = 0.001
latency = { uniform = [0, 0.01] }
[changes.heavy.plant.mass]
joint3 = 1.2
[samples]
count = 2
seed = 5
"""


SENSED = """
robots = "sensed.urdf"
controllers = "own.py:Spring"
rows = ["change", "sample", "rig.sensors.left.eye.rate"]
targets.point = { uniform = [[0.05, 0, -0.18], [0.1, 0, -0.15]] }
run.duration = 0.02
run.observer = "tip_force"
[rig.sensors."left.eye"]
noise = { log_uniform = [1e-4, 1e-2] }
rate = [50, 100]
[changes]
late = { rig.sensors."left.eye".latency = { uniform = [0.01, 0.03] } }
heavy = { plant.payload = { uniform = [0, 0.1] } }
[samples]
count = 3
"""


@pytest.fixture
def sensed(folder):
    """The pendulum with a camera at its tip."""
    camera = '<sensor name="left.eye" type="position" link="tip" noise="0.001"/></softdyn>'
    (folder / "sensed.urdf").write_text(PENDULUM.replace("</softdyn>", camera))


def test_a_sensor_s_own_errors_and_every_other_value_may_be_random(written, sensed):
    """Noise, latency, a target's point and a change: drawn per sample, the same in each change."""
    sweep = written(SENSED)
    cases = {change: [c for c, of in sweep.expanded if of == change] for change in sweep.changes}
    assert {len(found) for found in cases.values()} == {2 * 3}  # rates, samples
    (none, late, heavy) = (cases[name] for name in ("none", "late", "heavy"))
    eyes = [case.options["rig"]["sensors"]["left.eye"] for case in none]
    assert len({eye["noise"] for eye in eyes}) == len({case.value for case in none}) == 3
    assert all(1e-4 <= eye["noise"] <= 1e-2 for eye in eyes)
    assert all(0.05 <= x <= 0.1 and y == 0 and -0.18 <= z <= -0.15 for x, y, z in (
        case.value for case in none))  # fmt: skip
    name = "rig.sensors.left.eye"
    assert [parameter(c, f"{name}.noise") for c in late] == [eye["noise"] for eye in eyes]
    assert {parameter(c, f"{name}.rate") for c in none} == {50.0, 100.0}
    assert {parameter(c, f"{name}.latency") for c in (*none, *heavy)} == {None}
    assert len({parameter(c, f"{name}.latency") for c in late}) == 3
    assert len({parameter(c, "plant.payload") for c in heavy}) == 3
    # the plant's camera has them, and so has the observer's
    case, model = late[0], sweep.models["sensed.urdf"]
    options = RunOptions.of(case.options)
    plant = ClosedLoop(model, lambda *_: None, case.experiment(model), options).plant
    expected = (parameter(case, f"{name}.noise"),), parameter(case, f"{name}.latency")
    for robot in (plant.twin.robot, make_observer(model, options.rig, "tip_force").model.robot):
        (eye,) = robot.sensors
        assert (eye.noise, eye.latency) == expected


def test_an_observer_without_disturbances_is_printed_as_it_is_written(written, sensed):
    rows = 'rows = ["change", "sample", "run.observer"]'
    text = SENSED.replace("rate = [50, 100]", "rate = 50").replace(
        'rows = ["change", "sample", "rig.sensors.left.eye.rate"]', rows
    )
    sweep = written(text.replace('run.observer = "tip_force"', 'run.observer = ["", "tip_force"]'))
    named = {sweep.text(case, "run.observer") for case in sweep.cases}
    assert named == {'""', "tip_force"}
    assert '- observer: "", tip_force' in sweep_report._varied(sweep)


CHANGED_GAINS = """
robots = "finger"
controllers = ["best", "ic"]
rows = ["controller", "change"]
targets.theta = 0.5
gains.ic.eps = 0.05
[changes]
late = { gains."best".lag = 0.02 }
"eps {}" = { gains.ic.eps = [0.03, 0.04] }
both = { gains.ic.eps = 0.01, gains.best.delay = 0.01 }
all = { gains.eps = 0.02 }
heavy = { plant.mass = 1.1, gains.best.lag = 0.03 }
"""


def test_a_change_may_set_the_gains_of_one_controller(written):
    sweep = written(CHANGED_GAINS)
    found = {(c.controller, change): c.parameters for c, change in sweep.expanded}
    names = {name: [n for of, n in found if of == name] for name in sweep.controllers}
    assert names == {
        "best": ["none", "late", "both", "heavy"],  # not those for ic only
        "ic": ["none", "eps 0.03", "eps 0.04", "both", "all", "heavy"],
    }
    eps = [found["ic", name]["eps"] for name in names["ic"]]
    assert eps == [0.05, 0.03, 0.04, 0.01, 0.02, 0.05]
    best = [found["best", name] for name in names["best"]]
    assert best == [None, {"lag": 0.02}, {"delay": 0.01}, {"lag": 0.03}]


@pytest.mark.parametrize(
    ("new", "message"),
    [
        ('"best".lagg = 1', "[changes]: [late]: [gains]: [best]: lagg: expected one of approach"),
        ("mpc.lag = 1", "[changes]: [late]: [gains]: mpc: expected one of best, ic, got 'mpc'"),
        ('"own.py:Spring".k = 1', "own.py:Spring: expected one of best, ic, got"),
        ("best.lag = -1", "best for finger: lag: expected a finite number >= 0, got -1"),
        ("ic.Kp = -1", "changes.late.gains.ic.Kp: expected a positive number, got -1"),
    ],
)
def test_a_dry_run_refuses_what_the_run_would_refuse(folder, call, new, message):
    head = CHANGED_GAINS.partition("[changes]")[0]
    (folder / "bad.toml").write_text(f"{head}[changes.late.gains]\n{new}\n")
    for more in ((), ("--dry-run",)):
        code, out, err = call(folder / "bad.toml", "--out", folder / "out", *more)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert message in err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "noise = {",
            "nois = 1 # {",
            ("rig.sensors.left.eye.nois", "'nois'; did you mean 'noise'?"),
        ),
        ("rate = 50", "rate = -1", ("rig.sensors.left.eye.rate", -1)),
        (
            "rate = 50",
            "bias = [[1, 2]]",
            ("sensed.urdf, own.py:Spring: sensors: left.eye.bias", "(1.0, 2.0)"),
        ),
        ("rate = 50", "latency = 11", ("rig.sensors.left.eye.latency", 11)),
        (
            '[rig.sensors."left.eye"]',
            "[rig.sensors.right]",
            ("sensed.urdf, own.py:Spring: sensors: right", "'right'"),
        ),
        (
            '[rig.sensors."left.eye"]',
            "[rig]\nfile = false\n[rig.sensors.right]",
            ("sensed.urdf, own.py:Spring: sensors: right", "'right'"),
        ),
        ('[rig.sensors."left.eye"]', "[rig]\nsensors = 3\n[gains]", ("rig.sensors", 3)),
        ("[0.1, 0, -0.15]]", "[0.1, 0]]", ("targets.point", "[0.1, 0]")),
        ("[0.1, 0, -0.15]]", "[0.1, 0, -0.2]]", ("targets.point.2", "[-0.18, -0.2]")),
        (
            "payload =",
            "stiffness.each =",
            ("changes.heavy.plant.stiffness.each", "uniform"),
        ),
    ],
)
def test_misuses_of_random_values_and_of_sensors(written, sensed, old, new, message):
    text = SENSED.replace(', "rig.sensors.left.eye.rate"', "").replace("[50, 100]", "50")
    assert old in text
    with refused(*message):
        written(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "joint1 =",
            "joint9 =",
            ("plant.stiffness.joint9", "'joint9'; did you mean 'joint4'?"),
        ),
        (
            "joint3 =",
            "joint9 =",
            ("changes.heavy.plant.mass.joint9", "'joint9'; did you mean 'joint4'?"),
        ),
        (
            "damping.each = 1.1",
            "damping.each = [1, 2]",
            ("plant.damping.each", "(1.0, 2.0)"),
        ),
        (
            "damping.each = 1.1",
            "damping = {}",
            ("[plant]: damping", "an empty table"),
        ),
        ("damping.each = 1.1", "damping.each = -1", ("plant.damping.each", -1)),
        (
            "each = { uniform = [0.8, 1.2] }",
            "each = { uniform = [2, 1] }",
            ("plant.stiffness.each", "[2, 1]"),
        ),
        ("lag = 0.02", "lag = true", ("rig.lag", "True")),
        ("noise = 0.001", "file = 1", ("rig.file", 1)),
        ("latency = {", "latency = 11 # {", ("rig.latency", "11: in ms?")),
    ],
)
def test_misuses_of_factors_by_joint_and_of_the_rig(written, old, new, message):
    with refused(*message):
        written(BY_JOINT.replace(old, new))


LINKED = """
robots = "finger"
controllers = "best"
rows = ["change", "rig.lag", "gains.lag", "plant.mass"]
linked = [["rig.lag", "gains.lag"], ["rig.delay", "gains.delay"]]
targets.theta = 0.5
rig.lag = [0.01, 0.02, 0.02]
gains.lag = [0.01, 0.02, 0.04]
plant.mass = [1, 2]
[changes]
"stiff {}" = { plant.stiffness = 1.5 }
"late {}" = { rig.delay = [0.001, 0.002], gains.best.delay = [0.003, 0.002] }
"""


def test_linked_lists_go_together_and_others_are_combined(written):
    sweep = written(LINKED)
    names = ("rig.lag", "gains.lag", "plant.mass", "rig.delay", "gains.delay")
    found = {
        change: [tuple(parameter(c, n) for n in names) for c, of in sweep.expanded if of == change]
        for change in sweep.changes
    }
    pairs = [(0.01, 0.01), (0.02, 0.02), (0.02, 0.04)]
    delays = {
        "none": (None, None), "stiff 1.5": (None, None),
        "late 0.001": (0.001, 0.003), "late 0.002": (0.002, 0.002),
    }  # fmt: skip
    assert found == {
        change: [(*pair, mass, *delay) for pair in pairs for mass in (1, 2)]
        for change, delay in delays.items()
    }


@pytest.mark.parametrize(
    ("old", "new", "got"),
    [
        ("rig.lag = [0.01, 0.02, 0.02]", "rig.lag = [0.01, 0.02]", "3 of gains.lag, 2 of rig.lag"),
        ("rig.lag = [0.01, 0.02, 0.02]", "rig.lag = 0.01", "3 of gains.lag, 1 of rig.lag"),
        ("rig.lag = [0.01, 0.02, 0.02]", "", "none of rig.lag"),
        ("delay = [0.003", "delay = [0.004, 0.003", "3 of changes.late {}.gains.delay"),
        (', "gains.lag"], [', ', "gains.lagg"], [', "gains.lagg"),
        (', "gains.lag"], [', "], [", "['rig.lag']"),
        (', "gains.lag"], [', ', "rig.delay"], [', "'rig.delay'], ['rig.delay'"),
        ("stiffness = 1.5", "stiffness = 1.5, plant.damping = 2", "others"),
    ],
)  # fmt: skip
def test_misuses_of_linked_lists(written, old, new, got):
    assert old in LINKED
    with pytest.raises(InputError) as raised:
        written(LINKED.replace(old, new))
    assert got in str(raised.value.got)
