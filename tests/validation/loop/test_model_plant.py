"""The analytic model as the plant: beside the twin, at stops, behind a rig, reduced, repeated."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint, design
from softdyn.controllers import best
from softdyn.safety import HalfSpace, Surroundings
from softdyn.testing import check_plant
from softdyn.validation import Log, PlantErrors, Rig, paper, rollout, simulate
from softdyn.validation.loop.model_plant import ModelPlant
from softdyn.validation.loop.recorded import RecordedRun
from softdyn.validation.loop.repeat import compare_runs, experiment_of
from softdyn.validation.studies.engine.worker import files_of
from softdyn.validation.studies.sweep_file import read_sweep
from softdyn.validation.twin.integrators import Integrator
from tests.support import robots
from tests.support.arms import RUBBER, loaded

PULL = {"finger": [0.1, -0.1], "spirob": [2.0, 0.5, 0.0]}
ARM = design.Arm(
    (design.Section(0.1, 0.01, RUBBER, 8, name="rod"),), design.Damping(ratio=0.3),
    tuple(design.Cable(2 * k * np.pi / 3, 0.008, False, 10.0, name=f"c{k}") for k in range(3)),
    name="rod",
)  # fmt: skip


def apart(model, u, duration=0.4, plant=None, **both):
    """The largest difference of the tip (m) from the twin's."""
    ours = rollout(model, u, duration, plant="model", **(both | (plant or {})))
    twins = rollout(model, u, duration, **both)
    assert not ours.failed
    assert not twins.failed
    return np.abs(ours.y - twins.y).max()


@pytest.fixture(scope="module")
def pcc(tmp_path_factory):
    full = loaded(ARM, tmp_path_factory.mktemp("arm"))
    return softdyn.reduce(full, design.strain_basis(ARM))


@pytest.mark.parametrize("name", PULL)
def test_away_from_stops_its_steps_are_the_twins(name):
    assert apart(softdyn.load(name), PULL[name]) < 1e-12


def test_followers_continuous_joints_and_bases_move_as_in_the_twin(tmp_path):
    """Mimic joints of the twin are tied stiffly, and its base has velocities in other axes."""
    gripper = robots.load(tmp_path, robots.GRIPPER)
    assert apart(gripper, [0.5, 0.5, 0.0], 0.2) < 1e-3
    walker = robots.load(tmp_path, robots.WALKER, floating=True)
    found = [apart(walker, [1.0], 0.2, timestep=h) for h in (5e-4, 2.5e-4)]
    assert found[0] < 1e-5
    assert found[0] / found[1] == pytest.approx(2, rel=0.1)


def test_of_two_schemes_the_difference_halves_with_the_step():
    model = softdyn.load("spirob")
    found = [
        apart(model, PULL["spirob"], 0.2, {"integrator": "rk4"}, timestep=h)
        for h in (5e-4, 2.5e-4, 1.25e-4)
    ]
    assert np.divide(found[:-1], found[1:]) == pytest.approx([2, 2], rel=0.1)


def test_a_joint_stops_at_its_limit_and_leaves_it(tmp_path):
    model = robots.load(tmp_path, robots.WINCHED)
    rows = np.array([[60.0, 0.0], [0.0, 60.0]])
    log = rollout(model, rows, 1.0, plant="model")
    assert ((model.lower <= log.q) & (log.q <= model.upper)).all()
    stopped = (log.q == model.upper).any(axis=0)
    assert (log.q[-1] < model.upper)[stopped].any()
    ours, twins = (rollout(model, rows[1], 2.0, **plant) for plant in ({"plant": "model"}, {}))
    assert np.abs(ours.y[-1] - twins.y[-1]).max() < 1e-4  # in the twin a stop is soft


def test_an_unstable_explicit_step_is_named():
    log = rollout(softdyn.load("finger"), [0.3, -0.2], 1.0, plant="model", integrator="rk4")
    assert log.failed
    assert "step" in log.reason


def test_motors_and_sensors_are_those_of_the_twin(tmp_path):
    """Wider limits keep the arm off its stops, where only the twin bounces."""
    model = robots.load(tmp_path, robots.WINCHED.replace("1.2", "3.1"))
    sensors = {"camera": {"rate": 50.0, "latency": 0.01}, "wire": {"latency": 0.004}}
    for changes in ({}, {"command": "velocity", "stiffness": 600.0, "rate": 0.5}):
        rig = Rig(sensors=sensors, latency=0.004, **changes)
        u = lambda t: np.array([4 + 2 * np.sin(6 * t), 5.0])  # noqa: E731
        found = []
        for h in (2e-4, 1e-4):
            ours, twins = (
                rollout(model, u, 0.15, rig=rig, timestep=h, **plant)
                for plant in ({"plant": "model"}, {})
            )
            assert ours.sensor_names == twins.sensor_names
            found.append([
                np.abs(ours.q - twins.q).max(), np.abs(ours.acting - twins.acting).max(),
                np.abs(ours.measured - twins.measured).max(),
            ])  # fmt: skip
        assert (np.array(found[1]) < [5e-4, 5e-3, 0.03]).all(), found
        assert (np.divide(*found) > 1.8).all(), found


def test_errors_of_the_plant_are_those_of_the_twin(tmp_path):
    arm = robots.load(tmp_path, robots.WINCHED)
    for model, errors in (
        (softdyn.load("finger"), PlantErrors(mass=1.2, stiffness=0.9, damping=1.1, payload=0.02)),
        (arm, PlantErrors(mass={"elbow": 1.5}, stiffness={"shoulder": 1.3, "each": 1.1})),
    ):
        rig = Rig(plant=errors, file=False)
        assert apart(model, 0.2 * model.u_max, 0.2, rig=rig) < 1e-12
        assert apart(model, 0.2 * model.u_max, 0.2, {"rig": None}, rig=rig) > 1e-4


def test_a_reduced_model_is_held_and_its_run_repeats_to_the_bit(pcc, tmp_path):
    tip = pcc.state(np.array([4.0, 3.0]), np.zeros(2)).y
    for rig in (None, Rig(lag=0.01, delay=0.004, noise=1e-4, plant=PlantErrors(stiffness=1.1))):
        given = {"plant": "model", "duration": 0.6, "rig": rig}
        log = simulate(pcc, best(pcc), SetPoint(tip), **given)
        assert (log.failed, log.plant, log.q.shape[1]) == (False, "model", 2)
        assert np.linalg.norm(log.error[-1]) < (1e-3 if rig is None else 5e-3)
        log.save(tmp_path / "run.npz")
        kept = RecordedRun.read(tmp_path / "run.npz")
        parts, _ = experiment_of(kept.record, Log.load(tmp_path / "run.npz").source)
        assert parts["model"].robot.digest == pcc.robot.digest
        assert compare_runs(log, simulate(**parts)).equal


def test_a_sweep_takes_the_word(tmp_path):
    text = """robots = ["finger"]\ncontrollers = ["ic"]\n[targets]\ntheta = [0.5]
[run]\nduration = 0.02\nplant = "model"\n"""
    (tmp_path / "sweep.toml").write_text(text)
    (job,) = read_sweep(tmp_path / "sweep.toml").jobs()
    assert job.case.options["plant"] == "model"
    assert not files_of(job.case)


def test_it_is_a_plant(pcc):
    made = lambda model: ModelPlant(model, 5e-4, Integrator.IMPLICITFAST)  # noqa: E731
    assert check_plant(made, pcc).passed


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("contacts", {"contacts": True}), ("friction", {"friction": True}),
        ("integrator", {"integrator": "euler"}),
        ("obstacles", {"surroundings": Surroundings([HalfSpace(normal=[0, 0, 1], offset=-0.5)])}),
        ("rig: plant.soft_stops", {"rig": Rig(plant=PlantErrors(soft_stops=True))}),
        ("rig: plant.hysteresis", {"rig": Rig(plant=PlantErrors(hysteresis=0.1))}),
        ("rig", {"rig": Rig(friction=0.2)}), ("plant", {"plant": 3}),
    ],
)  # fmt: skip
def test_settings_of_things_that_no_model_has_are_refused_by_name(name, given):
    with pytest.raises(InputError) as caught:
        rollout(softdyn.load("spirob"), [1.0, 0, 0], 0.1, **({"plant": "model"} | given))
    assert caught.value.name == name


def test_regions_without_contact_are_recorded():
    around = Surroundings([HalfSpace(normal=[0, 0, 1], offset=-0.5, contact=False)])
    model = softdyn.load("finger")
    aim = paper.set_point("finger", 0.5)
    log = simulate(model, best(model), aim, plant="model", surroundings=around, duration=0.05)
    assert log.reserve.shape == (len(log.t), 1)
