"""Observers in the closed loop: the controller gets estimates only."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint
from softdyn.commands.run import unmodelled
from softdyn.controllers import best
from softdyn.description.urdf_writer import write
from softdyn.estimation import Ekf, EkfParameters
from softdyn.estimation.recorded import BIASED
from softdyn.identification.data import read_csv
from softdyn.validation import Log, PlantErrors, Rig, paper, simulate
from tests.support import robots
from tests.support.command import command as run
from tests.support.refused import refused
from tests.support.rigs import sensed

CAMERA = {"rate": 60.0, "latency": 0.03}


def test_best_reaches_its_target_on_estimates_alone(tmp_path):
    """From a wrong start of 0.2 rad; the log has true, measured and estimated states."""
    model, seen = sensed("finger", **CAMERA), []
    controller = best(model)

    def law(state, reference):
        seen.append(state)
        return controller(state, reference)

    law.reset = controller.reset
    observer = Ekf(model, start=(np.full(4, 0.2), np.zeros(4)))
    goal = paper.set_point("finger", theta=0.5)
    log = simulate(model, law, goal, duration=2.0, rig="file", observer=observer)
    assert 1e-2 * log.final_error_cm < 1e-3
    assert seen[0].covariance.shape == (8, 8)
    assert np.array_equal(log.q_seen[7], seen[7].q)
    tips = np.array([model.state(q, np.zeros(4)).y for q in log.q_seen])
    away = np.linalg.norm(tips - log.y[:-1], axis=1)
    assert away[200:].max() < 1.5e-3
    assert np.abs(log.q_seen - log.q[:-1])[200:].max() < 0.02
    assert log.sensor_names[-3:] == ("camera.x", "camera.y", "camera.z")
    assert np.abs(log.measured[7:, -3:] - log.y[7:]).max() > 1e-3  # late and noisy
    log.save(tmp_path / "log.npz")
    assert np.array_equal(Log.load(tmp_path / "log.npz").q_seen, log.q_seen)
    assert observer.counts.restarts == 0


def test_winches_lag_and_delay_are_in_the_filter():
    """Behind winches with lag and delay the prediction alone follows the plant."""
    model = sensed("spirob", **CAMERA)
    rig = Rig(command="length", stiffness=5000.0, damping=5.0, lag=0.02, delay=0.004)
    rigged = softdyn.build(rig.robot(model.robot), model.bundled)

    def law(state, reference):
        calls.append(1)
        return np.array([1.0, 0.2, 0.0] if len(calls) % 100 < 50 else [0.1, 0.8, 0.3])

    calls, observer = [], Ekf(rigged)
    log = simulate(
        model, law, SetPoint(np.array([0.0, 0.0, -0.5])), duration=0.6, rig=rig, observer=observer
    )
    tips = np.array([model.state(q, np.zeros(27)).y for q in log.q_seen])
    away = np.linalg.norm(tips - log.y[:-1], axis=1)[50:]
    assert np.sqrt(np.mean(away**2)) < 2e-3  # 5 mm with a filter that ignores lag and delay
    assert np.ptp(log.y, axis=0).max() > 0.02


def test_a_class_of_ones_own():
    """It needs step(t, measurements, u) and gets the last commands; reset is optional."""
    model, calls = sensed("finger"), []

    class Last:
        def step(self, t, measurements, u):
            calls.append((t, len(measurements), u.copy()))
            return SimpleNamespace(q=np.full(4, 0.1), v=np.zeros(4))

    push = np.array([0.3, -0.1])
    log = simulate(
        model, lambda state, _: push * state.q[0], SetPoint(np.zeros(3)), duration=0.01,
        period=0.005, rig="file", observer=Last(),
    )  # fmt: skip
    assert np.array_equal(log.q_seen, np.full((2, 4), 0.1))
    assert [call[:2] for call in calls] == [(0.0, 5), (0.005, 5), (0.01, 5)]
    assert np.array_equal(calls[0][2], np.zeros(2))
    assert np.allclose(calls[1][2], 0.1 * push)


def test_refusals():
    model = sensed("finger")
    bare, ekf = softdyn.load("finger"), Ekf(model)
    goal, law = SetPoint(np.zeros(3)), lambda state, _: np.zeros(2)
    rest = SimpleNamespace(step=lambda *_: SimpleNamespace(q=np.zeros(4), v=np.zeros(4)))
    other = SimpleNamespace(step=lambda *_: SimpleNamespace(q=np.full(4, np.nan), v=np.zeros(4)))
    vague = SimpleNamespace(step=rest.step, disturbance_units={"wind": "N"})
    for which, rig, observer, said in (
        (model, None, ekf, ("observer", "none")),
        (bare, "file", ekf, ("observer", "none")),
        (model, Rig(noise=0.001), ekf, ("observer", "one that alters q and v")),
        (model, "file", Ekf, ("observer",)),
        (model, "file", 3, ("observer",)),
        (model, "file", Ekf(model, model.robot.sensors[:2]), ("observer", "for 2")),
        (model, "file", other, ("the observer's estimate: q", "array([nan, nan, nan, nan])")),
        (model, "file", vague, ("the observer's estimate", "others")),
    ):
        with refused(*said):
            simulate(which, law, goal, duration=0.01, rig=rig, observer=observer)


def test_the_command(tmp_path):
    """`run --rig --observer` with a disturbance, an own class, and a wrong word."""
    file = robots.write(tmp_path, write(sensed("finger").robot))
    own = tmp_path / "own.py"
    own.write_text(
        "from softdyn.estimation import Ekf\n"
        "class Mine(Ekf):\n    def __init__(self, model):\n        super().__init__(model)\n"
    )
    begin = ["run", str(file), "best", "--target", "0.15", "0", "-0.12", "--duration", "0.1"]
    table = str(tmp_path / "log.csv")
    for word, code in (("tip_force", 0), (f"{own}:Mine", 0), ("wind", 2)):
        done = run(*begin, "--rig", "--observer", word, "--no-verdict", "--log", table)
        assert done.code == code, done.err
        if word == "tip_force":
            assert "estimated      tip_force.x" in done.out
            assert "observer       process noise" in done.out
            with open(table, encoding="utf-8") as rows:
                assert "estimated.tip_force.x (N)" in rows.readline()
            assert read_csv(table, softdyn.load(file)).t[-1] == pytest.approx(0.1)
    assert "tip_force or payload" in done.err
    assert run(*begin, "--observer").code == 2


def test_the_command_tells_when_the_model_lacks_forces():
    """A filter that ends noisy and estimates no force; not a calm one, nor one that does."""
    model = sensed("finger")
    said, value = unmodelled(Ekf(model))
    assert "process noise 0.4" in said
    assert "--observer tip_force" in said
    assert value == 0.4
    assert "lacks" not in unmodelled(Ekf(model, disturbances=("payload",)))[0]
    calm = Ekf(model, parameters=EkfParameters(process=0.03))
    assert "lacks" not in unmodelled(calm)[0]
    assert unmodelled(SimpleNamespace(process=1.0)) == ("", None)


def test_a_force_that_stays_shows_in_readings_that_are_off_to_one_side():
    """20 g that the model lacks, hidden from the noise; not with the payload or a right model."""
    model, goal = sensed("finger", **CAMERA), paper.set_point("finger", theta=0.5)
    for load, names, off in ((0.02, (), True), (0.02, ("payload",), False), (0.0, (), False)):
        ekf = Ekf(model, disturbances=names)
        rig = Rig(plant=PlantErrors(payload=load))
        log = simulate(model, best(model), goal, duration=1.5, rig=rig, observer=ekf)
        assert (abs(ekf.biases).max() > BIASED) == off
        said, _ = unmodelled(ekf, log)
        assert ("off to one side" in said) == off
        if off:
            size = float(said.partition("constant force of ")[2].split()[0])
            assert size == pytest.approx(load * 9.81, rel=0.1)


def test_estimated_disturbances_are_in_the_log(tmp_path):
    model, goal = sensed("finger", **CAMERA), paper.set_point("finger", theta=0.5)
    observer, last = Ekf(model, disturbances=("tip_force", "joint_offsets")), []

    class Kept:
        disturbance_units = observer.disturbance_units
        reset = observer.reset

        def step(self, *given):
            last[:] = [observer.step(*given)]
            return last[0]

    log = simulate(model, best(model), goal, duration=0.1, rig="file", observer=Kept())
    log.save(tmp_path / "log.npz")
    again = Log.load(tmp_path / "log.npz")
    force, offsets = (last[0].disturbances[name] for name in ("tip_force", "joint_offsets"))
    np.testing.assert_array_equal(again.disturbances[-1], [*force, *offsets])
    np.testing.assert_array_equal(again.deviations[-1, :3], last[0].deviations["tip_force"])
    assert again.disturbance_names[2:4] == ("tip_force.z", "joint_offsets.joint1")
    low, high = last[0].interval("tip_force")
    value, half, unit = again.report()["disturbances"]["tip_force.z"]
    assert (value - half, value + half, unit) == pytest.approx((low[2], high[2], "N"))
    rows = again.plot().axes
    assert [axes.get_ylabel() for axes in rows[2:]] == ["estimated (N)", "estimated (rad)"]
    np.testing.assert_array_equal(rows[2].lines[2].get_ydata()[-1], force[2])
