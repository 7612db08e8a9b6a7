"""Shipped sweeps, sweeps with one change at a time, and the table of all cases."""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import softdyn
from softdyn import InputError
from softdyn.controllers.registry import CONTROLLERS
from softdyn.validation.studies import study_targets, sweep_report
from softdyn.validation.studies.engine import distribution
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Distribution
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.studies.sweep import Sweep, parameter
from softdyn.validation.studies.sweep_file import read_sweep, shipped
from tests.support import ROOT
from tests.support.command import Done, command
from tests.support.refused import refused
from tests.support.sweeps import OWN, PENDULUM

ONE = "robots = 'finger'\ncontrollers = 'ic'\ntargets.theta = 0.5\nrun.duration = 0.2\n"


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Sweep]:
    def write(text: str, instead: dict[str, Any] | None = None) -> Sweep:
        (tmp_path / "sweep.toml").write_text(text)
        return read_sweep(tmp_path / "sweep.toml", instead)

    return write


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's folder, and the current one."""
    monkeypatch.chdir(tmp_path)
    Path("pendulum.urdf").write_text(PENDULUM)
    Path("own.py").write_text(OWN)
    Path("neighbour.py").write_text("DAMPING = 0.1\n")
    for name in ("own", "neighbour"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


# -- what they run ---------------------------------------------------------------------------------

# one robot's changes, as they were run for docs/beyond.md
PLANTS = {
    "mass x 0.8": {"mass": 0.8}, "mass x 0.9": {"mass": 0.9},
    "mass x 1.1": {"mass": 1.1}, "mass x 1.2": {"mass": 1.2},
    "stiffness x 0.8": {"stiffness": 0.8}, "stiffness x 0.9": {"stiffness": 0.9},
    "stiffness x 1.1": {"stiffness": 1.1}, "stiffness x 1.2": {"stiffness": 1.2},
    "damping x 0.8": {"damping": 0.8}, "damping x 0.9": {"damping": 0.9},
    "damping x 1.1": {"damping": 1.1}, "damping x 1.2": {"damping": 1.2},
    "dry friction": {"dry_friction": 0.001},
    "contacts": {"contacts": True},
    "soft stops": {"soft_stops": True},
    "contacts, soft stops": {"contacts": True, "soft_stops": True},
}  # fmt: skip
RIGS = {
    "5 ms delay": {"file": False, "delay": 0.005},
    "1 mm noise": {"file": False, "noise": 0.001},
    "actuators lag 10 ms": {"file": False, "lag": 0.01},
    "actuators lag 50 ms": {"file": False, "lag": 0.05},
    "lag 50 ms, assumed 25 ms": {"file": False, "lag": 0.05},
    "lag 50 ms, assumed 100 ms": {"file": False, "lag": 0.05},
    "cable friction 0.1": {"file": False, "friction": 0.1},
}
# what `best` is told of its actuators
ASSUMED = {
    "5 ms delay": {"delay": 0.005}, "actuators lag 10 ms": {"lag": 0.01},
    "actuators lag 50 ms": {"lag": 0.05}, "lag 50 ms, assumed 25 ms": {"lag": 0.025},
    "lag 50 ms, assumed 100 ms": {"lag": 0.1},
}  # fmt: skip
ORDER = [
    "none", "ellipse x 0.7", *[*PLANTS][:12], *RIGS, *[*PLANTS][12:], "one plant step a period"
]  # fmt: skip


def options(change: str) -> dict[str, Any]:
    """The arguments of a run that a change stands for."""
    found = {"plant": PLANTS.get(change), "rig": RIGS.get(change)}
    if change == "one plant step a period":
        return {"timestep": math.inf}
    return {name: table for name, table in found.items() if table is not None}


def test_robustness_is_one_change_at_a_time() -> None:
    sweep = read_sweep("robustness", {"robots": ["finger"]})
    expected = {
        f"finger/best/{change}/{title}": Case(
            "finger", "best", kind, value, ASSUMED.get(change), options(change),
            ellipse_scale=0.7 if change == "ellipse x 0.7" else 1.0,
        )
        for change in ORDER
        for title, kind, value in (
            ("θ = 0.25π", "set_point", 0.25), ("θ = 1.25π", "set_point", 1.25),
            ("ω = 0.25π", "tracking", 0.25),
        )
    }  # fmt: skip
    assert sweep.cells == expected
    assert [*sweep.cells] == [*expected]
    every = read_sweep("robustness").cells
    assert len(every) == 3 * len(expected)
    dry = {
        case.robot: case.options["plant"]["dry_friction"]
        for label, case in every.items()
        if "/dry friction/" in label
    }
    assert dry == {"finger": 0.001, "helix": 0.01, "spirob": 0.1}
    assert {label.split("/")[2] for label in distribution.read_distributions(
        ROOT / "tests/proof/documents/measured/robustness.json"
    )} == set(ORDER)  # fmt: skip


def test_horizons_are_shares_of_eps() -> None:
    eps = CONTROLLERS["soft-id-clf-qp"].published["finger"].eps
    cells = read_sweep("horizon", {"robots": ["finger"]}).cells
    shares = {"0/0": 0.0, "0.5/15": 0.5, "0.8/24": 0.8, "1/30": 1.0, "1.2/36": 1.2, "2/60": 2.0}
    titles = ("θ = 0π", "θ = 0.5π", "θ = 1π", "θ = 1.5π", "ω = 0.5π")
    assert [*cells] == [f"finger/{two} ms/{title}" for two in shares for title in titles]
    for label, case in cells.items():
        share, _, _ = label.removeprefix("finger/").partition(" ms")
        assert case.parameters["horizon"] == shares[share] * eps
        assert case.parameters["eps"] == eps
    other = read_sweep("horizon", {"robots": ["finger"], "gains": {"eps": 0.05, "w3": 1.0}}).cells
    assert other["finger/0.8/40 ms/θ = 0π"].parameters["horizon"] == 0.8 * 0.05
    assert other["finger/0.8/40 ms/θ = 0π"].parameters["w3"] == 1.0


def test_periods_are_those_up_to_the_published_one() -> None:
    cells = read_sweep("periods", {"robots": ["finger", "spirob"]}).cells
    expected = []
    for robot, periods in (("finger", (1, 2, 5)), ("spirob", (1, 2))):
        for period in periods:
            row = f"{robot}/best/{period} ms"
            expected += [f"{row}/θ = {theta}π" for theta in ("0", "0.5", "1", "1.5")]
        expected += [f"{row}/ω = {omega}π" for omega in ("0.1", "0.2", "0.3", "0.4", "0.5")]
    assert [*cells] == expected
    finger = softdyn.load("finger")
    for label, case in cells.items():
        if case.robot == "finger":
            assert f"/{1e3 * case.grid(finger).period:g} ms/" in label
    assert [*read_sweep("periods", {"robots": ["finger"], "period": 0.0015}).cells][4].startswith(
        "finger/best/1.5 ms/"
    )


def test_other_set_points_than_the_paper_s() -> None:
    cells = read_sweep("set_points").cells
    thetas = {case.value for case in cells.values()}
    assert len(cells) == 3 * len(thetas) == 42
    assert not thetas & {0.0, 0.5, 1.0, 1.5}
    assert {(c.robot, c.controller, c.options["period"]) for c in cells.values()} == {
        ("spirob", "best", period) for period in (0.001, 0.002, 0.005)
    }


def test_a_missed_set_point_gets_its_nearest_stable_equilibrium(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tip of a pendulum moves on a circle, and its motor carries it to one side only."""
    few = partial(study_targets.rests_at, rays=4, more=4)
    monkeypatch.setattr(study_targets, "rests_at", few)
    heavy = PENDULUM.replace("<mass", '<origin xyz="0 0 -0.1"/><mass')
    Path("pendulum.urdf").write_text(heavy.replace('lower="-5"', 'lower="0"'))
    Path("sweep.toml").write_text(
        "robots = 'pendulum.urdf'\ncontrollers = 'own.py:Spring'\nrows = ['robot', 'controller']\n"
        "statics_beyond_cm = 1\nrun.duration = 0.02\n"
        "targets.point = [[-0.12, 0, -0.16], [0.12, 0, -0.16], [0, 0, -0.199]]\n"
    )
    done = command("sweep", "sweep.toml", "--jobs", 1, "--out", "out", "--keep", "kept.json")
    assert done.code == 0, done.err
    row = "pendulum/stable equilibrium"
    kept = distribution.read_distributions(Path("kept.json"))
    found = {label.rpartition("/")[2]: cell.nominal for label, cell in kept.items() if row in label}
    # the first lies on the circle, for the other side the arm hangs, and the third is reached
    assert found == {
        "(-0.12, 0, -0.16) m": pytest.approx(0.0, abs=0.01),
        "(0.12, 0, -0.16) m": pytest.approx(100 * math.hypot(0.12, 0.04), abs=0.01),
    }
    assert f"| {row.replace('/', ' | ')} | 0.00 | 12.6 | - |" in done.out


def test_an_own_robot_goes_to_its_equilibria(folder: Path) -> None:
    goals = study_targets.points(softdyn.load("pendulum.urdf"), 3)
    sweep = read_sweep(
        "robustness", {"robots": ["pendulum.urdf"], "controllers": ["own.py:Spring"]}
    )
    assert len(sweep.cells) == len(goals) * (len(ORDER) - 1)  # they are on no ellipse
    cells = [case for label, case in sweep.cells.items() if "/none/" in label]
    assert [(c.kind, c.value, c.options) for c in cells] == [("point", y, {}) for y in goals]
    assert next(iter(sweep.cells)).startswith("pendulum/Spring/")


def test_a_trial_is_what_simulate_says() -> None:
    case = Case("finger", "best", "set_point", 0.25, options={"duration": 0.5}, ellipse_scale=0.7)
    (result,) = run_all([case], 1)
    assert not result["failed"]
    assert 0 <= result["final_error_cm"] < 3
    assert result["second_cycle_mse_cm2"] is None
    assert 0 < result["input_change_percent"] < 1


# -- what stands in a file's place -----------------------------------------------------------------


def test_options_stand_in_the_place_of_a_file_s(folder: Path) -> None:
    Path("elsewhere").mkdir()
    Path("elsewhere/sweep.toml").write_text(ONE + "plant.contacts = true\ngains.Kp = [3, 4]\n")
    said = {
        "robots": ["pendulum.urdf"], "controllers": ["ic", "own.py:Spring"], "period": 0.004,
        "gains": {"Kp": 9.0, "stiffness": 2.0},
    }  # fmt: skip
    with refused("elsewhere/sweep.toml: ../pendulum.urdf, ic: gains: stiffness", "'stiffness'"):
        read_sweep("elsewhere/sweep.toml", said)
    cases = read_sweep("elsewhere/sweep.toml", said | {"controllers": ["own.py:Spring"]}).cases
    assert [(c.robot, c.controller, c.options["period"], c.parameters) for c in cases] == [
        ("../pendulum.urdf", "../own.py:Spring", 0.004, said["gains"])
    ]
    assert cases[0].options["plant"] == {"contacts": True}
    helix = read_sweep("elsewhere/sweep.toml", {"robots": ["helix"]})
    assert helix.cases[0].grid(helix.models["helix"]).period == 0.0075
    with refused("robustness.toml: robots", "3 robots"):
        read_sweep("robustness", {"gains": {"Kp": 1.0}})
    with refused("robustness.toml: robots", "fingr"):
        read_sweep("robustness", {"robots": ["fingr"]})


def test_a_file_comes_before_a_name(folder: Path) -> None:
    assert len(read_sweep("periods").robots) == 3
    with refused("perods", "neither"):
        read_sweep("perods")
    Path("periods").write_text(ONE)
    assert read_sweep("periods").robots == ("finger",)
    done = command("sweep", "--list")
    assert (done.code, len(done.out.splitlines())) == (0, len(shipped()))
    assert str(shipped()["horizon"]) in done.out
    done = command("sweep")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: FILE: expected a TOML file, or one of horizon, noise")


# -- the table of all cases ------------------------------------------------------------------------


def test_the_table_of_all_cases() -> None:
    robots = {"robots": ["finger", "spirob"]}
    sweep = read_sweep("periods", robots)
    made = {label: Distribution(case.value) for label, case in sweep.cells.items()}
    first, second = sweep_report.cell_tables(sweep, made).split("\n\n")
    assert "| robot | controller | period | θ = 0π (cm) |" in first
    assert "| spirob | best | 1 ms | 0.00 | 0.50 | 1.00 | 1.50 | 0.75 ± 0.56 |" in first
    assert "| finger | best | 5 ms | 0.10 | 0.20 | 0.30 | 0.40 | 0.50 | 0.30 ± 0.14 |" in second
    sweep = read_sweep("robustness", robots)
    lost = {label: Distribution(1.0, {"1": (1.0, 3.0)}) for label in sweep.cells}
    table = sweep_report.cell_tables(sweep, lost)
    assert "| spirob | best | one plant step a period | ~1.00 [1.00, 3.00] |" in table
    assert table.endswith(distribution.NOISY)
    assert sweep.failures({case.name for case in sweep.cases}) == 2 * 3 * (1 + 3 * 2)
    late = sweep.cells["finger/best/5 ms delay/θ = 0.25π"]
    assert sweep.failures({late.name}) == 0


CHANGES = """
robots = "pendulum.urdf"
controllers = "own.py:Spring"
rows = ["robot", "change"]
must_not_fail = ["{0}"]
targets.point = [0.1, 0, -0.17]
[run]
duration = 0.3
[changes]
"stiffness {{}}" = {{ gains.stiffness = [1, -2] }}
"late" = {{ rig = {{ delay = 0.002, lag = 0.01 }}, plant.mass = 1.1 }}
"""


def test_the_command_prints_the_table_and_judges(folder: Path) -> None:
    def sweep(must_not: str, *more: object) -> Done:
        Path("sweep.toml").write_text(CHANGES.format(must_not))
        return command("sweep", "sweep.toml", "--jobs", 1, "--out", "out", *more)

    done = sweep("none")
    assert done.code == 0, done.err
    assert "| pendulum | late |" in done.out
    text = Path("out/sweep.md").read_text()
    assert done.out.splitlines()[0] in text
    assert "stiffness -2/(0.1, 0, -0.17) m: failed" in text
    assert "Best" not in text
    with Path("out/sweep.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["gains.stiffness"] for row in table] == ["", "1.0", "-2.0", ""]
    assert [(row["plant.mass"], row["rig.delay (s)"]) for row in table][-2:] == [
        ("", ""), ("1.1", "0.002"),
    ]  # fmt: skip
    assert sweep("stiffness -2").code == 1

    # an ensemble adds its starts to the existing results, and another one joins it
    done = sweep("none", "--ensemble", 2, "--keep", "kept.json", "--json", "-")
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert (report["cases"], report["ran"]) == (4, 0)
    assert [label.split("/")[1] for label in report["cells"]] == [
        "none", "stiffness 1", "stiffness -2", "late",
    ]  # fmt: skip
    assert len(list(Path("out/cases").rglob("*.json"))) == 4 * 3
    kept = distribution.read_distributions(Path("kept.json"))
    assert {label: cell.nominal for label, cell in kept.items()} == {
        label: pytest.approx(cell["median"], rel=1e-3) for label, cell in report["cells"].items()
    }
    Path("plain.toml").write_text(ONE)
    done = command("sweep", "plain.toml", "--keep", "kept.json", "--out", "plain")
    assert (done.code, Path("plain").exists()) == (2, False)
    assert done.err == "error: --ensemble, --keep: expected rows in plain.toml, got none\n"


MISUSES = [
    ("targets.equilibria = 1", "[targets]: equilibria: expected true or false, got 1"),
    ("targets.equilibria = true\ntargets.point = [0, 0, 0]", "only values of theta and omega"),
    ("plant.mass = 0", "plant.mass: expected a finite number > 0, got 0"),
    ("run.timestep = -inf", "run.timestep: expected a number > 0"),
    ("shorter_periods = 0", "shorter_periods: expected a finite number > 0, got 0"),
    ("rig.dely = 1", "rig.dely: expected one of plant, sensors, lag, delay, rate, command,"),
    ("rig.delay = -1", "rig.delay: expected a finite number >= 0, got -1"),
    ("rig.rate = 0", "rig.rate: expected a finite number > 0, got 0"),
    ("rig = 1", "[rig]: expected a table, got 1"),
    ("signals.delay = 0.1\nrig.lag = 0.1", "signals: expected one of robots,"),
    ("ellipse_scale = 0", "ellipse_scale: expected a finite number > 0, got 0"),
    ("gains.horizon_per_eps = 1", "[gains]: horizon_per_eps: expected one of Kp"),
    ("changes = 1", "[changes]: expected a table, got 1"),
    ("changes.a = 1", "[changes]: [a]: expected a table, got 1"),
    ("changes.a = { mass = 1 }", "[changes]: [a]: mass: expected one of gains, run, plant, rig"),
    ("changes.a = { plant.mas = 1 }", "changes.a.plant.mas: expected one of contacts"),
    ("changes.a = { plant.mass = 2 }", "rows: expected parameters that distinguish"),
    ("changes.a = { plant.mass = [1, 2] }", "[changes]: a: expected a unique name, with {}"),
    ("changes.'{} {}' = { plant = { mass = [1, 2], damping = [1, 2] } }",
     "changes.{} {}.plant.damping: expected one value, or one list per change, got [1, 2]"),
    ("changes.a = { plant.mass = { default = [1, 2], finger = 3 } }", "one list per change"),
    ("changes.none = { plant.mass = 2 }", "[changes]: none: expected a unique name"),
    ("changes.'a/b' = { plant.mass = 2 }", "[changes]: a/b: expected a unique name"),
    ("rows = ['robot', 'mass']", "rows: expected any of robot, controller, change"),
    ("rows = ['robot']\nplant.mass = [1, 2]",
     "rows: expected parameters that tell all cases apart, got two of finger/θ = 0.5π"),
    ("must_not_fail = ['much']", "must_not_fail: expected any of none, got 'much'"),
    ("statics_beyond_cm = 1", "statics_beyond_cm: expected a file with rows, got none"),
    ("rows = ['robot']\nstatics_beyond_cm = 0", "statics_beyond_cm: expected a finite number > 0"),
    ("means = 'no'", "means: expected true or false, got 'no'"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), MISUSES, ids=[text for text, _ in MISUSES])
def test_what_is_wrong_is_told(written: Callable[..., Sweep], text: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        written(ONE + text + "\n")
    assert message in str(error.value)


def test_one_plant_step_a_period_and_what_differs_between_robots(
    written: Callable[..., Sweep],
) -> None:
    sweep = written(
        "robots = ['finger', 'helix']\ncontrollers = 'ic'\ntargets.theta = 0.5\n"
        "rows = ['robot', 'change']\nrun.timestep = inf\nellipse_scale = 0.9\n"
        "[changes]\na = { plant.stiffness = { default = 2, helix = 3 }, ellipse_scale = 0.5 }\n"
    )
    found = [
        (c.grid(sweep.models[c.robot]).timestep, parameter(c, "plant.stiffness"), c.ellipse_scale)
        for c in sweep.cases
    ]
    assert found == [(0.005, None, 0.9), (0.005, 2, 0.5), (0.0075, None, 0.9), (0.0075, 3, 0.5)]
