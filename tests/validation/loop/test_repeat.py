"""The record of a run, and the run made again of it."""

import json

import numpy as np
import pytest

import softdyn
from softdyn import Ellipse, InputError, SetPoint
from softdyn.controllers import Compensated, Impedance, SoftIdClfQp, best
from softdyn.estimation import Ekf, EkfParameters
from softdyn.safety import HalfSpace, Surroundings
from softdyn.sensing import Sensor, SensorKind
from softdyn.tasks import AxisTask, PointTask, References, Target
from softdyn.validation import Log, PlantErrors, Rig, paper, rollout, simulate
from softdyn.validation.loop.repeat import changed_files, compare_runs, lost_parts
from softdyn.validation.loop.settings import declarations
from tests.support.logs import assert_same
from tests.support.refused import refused

AROUND = Surroundings([HalfSpace(normal=[0, 0, 1], offset=-0.5)])
OTHER = {
    "duration": 0.02, "period": 0.0025, "timestep": 0.00025, "integrator": "implicit",
    "q0": [0.01, 0, 0, 0], "v0": [0, 0.1, 0, 0], "contacts": True, "friction": True,
    "plant": PlantErrors(stiffness=1.1), "rig": Rig(lag=0.01, seed=3), "surroundings": AROUND,
    "name": "mine",
}  # fmt: skip
LAW = """
import numpy as np
from softdyn.controllers import Command
from half import HALF

class Law:
    def __init__(self, model, table):
        self.model, self.table = model, table

    def __call__(self, state, reference):
        return Command(self.table["a"] * HALF * np.array([1.0, -1.0]))
"""


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


@pytest.fixture(scope="module")
def encoders(finger):
    return tuple(
        Sensor(f"encoder_{k}", SensorKind.JOINT, joint=name, noise=(1e-4,))
        for k, name in enumerate(finger.joint_names)
    )


@pytest.fixture
def own(tmp_path):
    """A folder with a controller of one's own."""
    (tmp_path / "law.py").write_text(LAW)
    (tmp_path / "half.py").write_text("HALF = 0.5\n")
    return tmp_path


def run(model, controller=None, reference=None, **settings):
    given = {"duration": 0.03, **settings}
    aim = paper.set_point("finger", 0.5) if reference is None else reference
    return simulate(model, controller or Impedance(model), aim, **given)


def flat(value, place=()):
    """The plain value at each place of nested data."""
    if isinstance(value, dict):
        return {k: v for key, one in value.items() for k, v in flat(one, (*place, key)).items()}
    return {place: value}


@pytest.mark.parametrize("name", OTHER)
def test_two_runs_that_differ_in_one_setting_have_records_that_differ_in_it_alone(finger, name):
    """Beside it only `used` may differ, which follows from the rig."""
    one, other = (flat(run(finger, **more).record) for more in ({}, {name: OTHER[name]}))
    places = {place for place in {*one, *other} if place[0] != "used"}
    differ = {place for place in places if one.get(place, "none") != other.get(place, "none")}
    assert {place[:2] for place in differ} == {("settings", name)}


def test_every_setting_is_in_that_test():
    assert {*OTHER} == {*declarations()} - {"observer"}  # which needs a rig, see below


def test_an_observer_and_its_parameters_are_in_the_record(finger, encoders):
    plain, record = (
        run(finger, rig=Rig(sensors=encoders), observer=one).record for one in (None, "tip_force")
    )
    assert record["settings"] == plain["settings"] | {"observer": "tip_force"}
    assert record["used"]["observer"]["class"] == "Ekf"
    assert record["used"]["observer"]["parameters"]["tip_force"] == EkfParameters().tip_force
    assert [one["noise"] for one in record["used"]["sensors"]] == [[1e-4]] * len(encoders)


RUNS = {
    "by default": lambda model, encoders: run(model),
    "every setting": lambda model, encoders: run(model, **OTHER | {"plant": None}),
    "own errors": lambda model, encoders: run(model, plant=PlantErrors(mass={"each": 1.2})),
    "ellipse": lambda model, encoders: run(
        model, SoftIdClfQp(model, horizon=0.02), Ellipse(0.08, 0.03, 0.2, omega=0.3)
    ),
    "wrapped": lambda model, encoders: run(
        model, Compensated(Impedance(model), model, lag=0.02), rig=Rig(lag=0.02)
    ),
    "best": lambda model, encoders: run(model, best(model)),
    "tasks": lambda model, encoders: run(
        model, SoftIdClfQp(model, tasks=[PointTask("tip"), AxisTask("tip", [1, 0, 0], level=1)]),
        References({"tip": SetPoint([0.15, 0, -0.15]), "tip.axis": Target([0, 0, -1.0])}),
    ),
    "observer": lambda model, encoders: run(
        model, rig=Rig(sensors=encoders, seed=2), observer="stiffness"
    ),
    "made observer": lambda model, encoders: run(
        model, rig=Rig(sensors=encoders, noise=0.0, seed=5),
        observer=Ekf(model, encoders, parameters=EkfParameters(process=0.2)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_a_saved_run_is_repeated_to_the_bit(finger, encoders, name, tmp_path):
    log = RUNS[name](finger, encoders)
    assert lost_parts(log.record) == []
    log.save(tmp_path / "run.npz")
    read = Log.load(tmp_path / "run.npz")
    again = simulate(**read.experiment)
    found = compare_runs(read, again)
    assert found.equal, found
    assert again.record["settings"] == log.record["settings"]
    assert again.record["controller"] == log.record["controller"]
    assert again.record["reference"] == log.record["reference"]


def test_a_change_is_said(finger):
    log = run(finger)
    again = simulate(**log.experiment | {"plant": PlantErrors(payload=0.02)})
    found = compare_runs(log, again)
    assert not found.equal
    assert found.channel == "q"
    away = np.abs(log.q - again.q)
    assert found.difference == away.max() > 0
    assert any("payload" in cause for cause in found.causes)


def test_an_own_class_is_found_in_another_folder_or_named_as_missing(finger, own, tmp_path_factory):
    cls = softdyn.controllers.find_controller(f"{own / 'law.py'}:Law")
    log = run(finger, cls(finger, {"a": 0.1}))
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    for folder in (own, elsewhere):
        log.save(folder / "run.npz")
    record = Log.load(own / "run.npz").record
    assert record["controller"]["with"]["table"] == {"a": 0.1}  # as given, without units
    assert [one["path"] for one in record["controller"]["modules"]] == [str(own / "half.py")]
    assert compare_runs(log, simulate(**Log.load(own / "run.npz").experiment)).equal
    far = Log.load(elsewhere / "run.npz")
    assert far.record["controller"]["file"]["name"] == "law.py"
    assert str(own) not in json.dumps(far.record)
    with refused("law.py"):
        _ = far.experiment
    assert changed_files(log.record) == []
    (own / "half.py").write_text("HALF = 0.25\n")
    assert changed_files(log.record) == ["half.py has changed"]


def test_parts_that_no_record_can_make_are_named(finger):
    log = run(finger, reference=lambda t: SetPoint([0.1, 0, -0.1]))
    (lost,) = lost_parts(log.record)
    assert lost.startswith("reference")
    with pytest.raises(InputError) as caught:
        simulate(**log.experiment)
    assert caught.value.name == "reference"
    again = simulate(**log.experiment | {"reference": SetPoint([0.1, 0, -0.1])})
    assert again.q.tobytes() == log.q.tobytes()


def test_the_csv_has_its_record_beside_it(finger, tmp_path):
    log = run(finger)
    log.to_csv(tmp_path / "run.csv")
    whole = json.loads((tmp_path / "run.csv.json").read_text())
    assert whole["robot"]["text"] == finger.robot.text
    assert whole["versions"] == log.versions
    assert whole["gains"] == log.gains
    assert_same(log, Log.from_csv(tmp_path / "run.csv"))
    assert len((tmp_path / "run.csv").read_text().splitlines()) == log.steps + 2
    (tmp_path / "run.csv.json").unlink()
    with refused("log", "a log of an older version, without one"):
        _ = Log.from_csv(tmp_path / "run.csv").experiment


def test_a_rollout_says_that_its_inputs_are_no_controller(finger):
    log = rollout(finger, [0.1, 0.0], 0.02)
    assert log.record["reference"] is None
    assert lost_parts(log.record)[0].startswith("controller")


def test_a_record_has_versions_processor_and_commit(finger):
    log = run(finger)
    assert {"python", "softdyn", "pin", "mujoco", "numpy", "numba", "proxsuite"} <= {*log.versions}
    assert log.record["processor"]
    assert set(log.record["git"] or {"commit": "", "changed": False}) == {"commit", "changed"}
