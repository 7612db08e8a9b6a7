from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import chdtri

import softdyn
from softdyn import SetPoint
from softdyn.controllers import best
from softdyn.description.rig import CommandKind
from softdyn.estimation import Ekf
from softdyn.statics import settle
from softdyn.validation import Log, drive, simulate
from softdyn.validation.bench.drive import Drive
from softdyn.validation.bench.fail_safe import SURE, FailSafe, RigLimits, StopCause
from softdyn.validation.bench.plant import RealRig
from tests.support.bench import NearDriver, bench_arm, tower
from tests.support.refused import refused

PERIOD = 0.005


@pytest.fixture(scope="module")
def model():
    return bench_arm()


@pytest.fixture
def rig(model):
    return tower(model)


def held(model, u=(2.0, 1.0)):
    return lambda state, reference: np.array(u)


def run(model, rig, controller=None, duration=0.3, **more):
    """A run on the near rig; `more` may have `on_step`."""
    on_step = more.pop("on_step", None)
    given = Drive(
        model, held(model) if controller is None else controller, SetPoint(np.zeros(3)),
        NearDriver(model), period=PERIOD, duration=duration, watchdog=False,
        source=rig.hands.source, **more,
    )  # fmt: skip
    return given.run(on_step=on_step)


def test_driven_and_simulated_end_at_the_same_tip(model, rig):
    target = SetPoint(model.state(np.array([0.2, 0.7]), np.zeros(2)).y)
    real = drive(
        model, best(model), target, NearDriver(model), period=PERIOD, duration=2.0,
        watchdog=False, source=rig.hands.source,
    )  # fmt: skip
    twin = simulate(
        model, best(model), target, rig="file", observer=Ekf(model), period=PERIOD, duration=2.0
    )
    assert real.complete, real.reason
    assert not real.failed, real.reason
    assert math.dist(real.y[-1], twin.y[-1]) < 2e-3
    assert rig.stops == 1
    assert rig.rig.state()["relaxed_at"] is not None


def test_the_estimate_begins_where_the_arm_rests(model, rig):
    """The springs give way to the weight by far more than the readings' noise."""
    sag = settle(model, np.zeros(2)).q
    assert abs(sag).min() > 0.02
    observer = Ekf(model)
    log = run(model, rig, held(model, (0.0, 0.0)), observer=observer).log
    assert log.q[0] == pytest.approx(sag, abs=1e-9)
    assert log.q_seen == pytest.approx(np.tile(sag, (log.steps, 1)), abs=1e-3)
    assert observer.counts.refuted == 0


def test_the_log_has_both_clocks_and_comes_back_from_its_files(model, rig, tmp_path):
    log = run(model, rig).log
    assert np.allclose(np.diff(log.clock), PERIOD)
    assert log.missed.sum() == 0
    names = list(log.sensor_names)
    late = log.t - log.stamps[:, names.index("camera.x")]
    assert late.min() >= 0.02 - 1e-9
    assert late.max() <= 0.04 + 2 * PERIOD
    log.save(tmp_path / "a.npz")
    again = Log.load(tmp_path / "a.npz")
    assert (again.stamps == log.stamps).all()
    log.to_csv(tmp_path / "a.csv")
    header = (tmp_path / "a.csv").read_text().splitlines()[0]
    assert "stamp.camera.x (s)" in header
    assert "measured.elbow (rad)" in header


def test_commands_rise_and_fall(model, rig):
    sent = []
    rig.rig.obey, obey = lambda line: (sent.append(json.loads(line)), obey(line))[1], rig.rig.obey
    found = run(model, rig, limits=RigLimits(ramp=0.1), duration=0.3)
    commands = np.array([one["send"] for one in sent if "send" in one])
    assert np.allclose(commands[:, 0], np.clip(np.minimum(
        np.arange(80) / 20, (80 - np.arange(80) - 1) / 20), 0, 1) * 2.0)  # fmt: skip
    assert sent[-1] == {"stop": True}
    assert found.cause is StopCause.END
    assert np.allclose(found.log.command, commands[:60])


def fault(kind, sensors=("camera",), at=0.15, **more):
    """After `at` seconds, tell the rig a fault."""

    def on_step(step):
        if at <= step.t < at + PERIOD:
            NearDriver.tower.rig.obey(json.dumps({"fault": kind, "sensors": sensors, **more}))

    return on_step


@pytest.mark.parametrize("kind", ["lose", "repeat"])
def test_readings_that_stop_stop_the_run(model, rig, kind):
    found = run(model, rig, on_step=fault(kind))
    assert found.cause is StopCause.STALE
    assert "camera.x" in found.reason
    assert found.reason in found.log.reason
    assert found.log.t[-1] <= 0.15 + 0.1 + PERIOD
    assert rig.stops == 1


def test_late_readings_stop_the_run(model, rig):
    found = run(model, rig, on_step=fault("delay", seconds=0.2))
    assert found.cause is StopCause.STALE


def false_readings(value, rows, since):
    """A class of drivers whose readings of these rows are this value, with fresh stamps."""

    class Lying(NearDriver):
        def read(self):
            values, stamps = super().read()
            if self.tower.hands.time >= since:
                values, stamps = values.copy(), stamps.copy()
                values[rows], stamps[rows] = value, self.tower.hands.time
            return values, stamps

    return Lying


@pytest.mark.parametrize("value", [math.inf, -math.inf, 1e7, -1e300])
@pytest.mark.parametrize(("rows", "name"), [([1], "elbow"), ([3, 4, 5], "camera.x")])
def test_readings_that_no_observer_uses_stop_the_run(model, rig, value, rows, name):
    """Stamps say nothing: whoever reads such a value is blind, and the robot is not moved on."""
    found = driven_by(false_readings(value, rows, 100.2)(model), model, rig)
    assert found.cause is StopCause.STALE
    assert f"reading {name}" in found.reason
    assert found.log.t[-1] <= 0.2 + 0.1 + 0.04 + 2 * PERIOD  # a picture may be 40 ms old
    assert rig.stops == 1


def test_a_rig_that_never_sends_a_finite_reading_is_not_driven(model, rig):
    found = driven_by(false_readings(math.inf, [1], 0.0)(model), model, rig)
    assert found.cause is StopCause.STALE
    assert "elbow never came" in found.reason
    assert not found.log.steps


def test_an_observer_of_ones_own_is_not_judged_by_what_it_does_not_say(model, rig):
    class Silent:
        def __init__(self):
            self.inner = Ekf(model)

        def step(self, t, measurements, u):
            found = self.inner.step(t, measurements, u)
            return SimpleNamespace(q=found.q, v=found.v)

    driver = false_readings(1e7, [1], 100.2)(model)
    assert driven_by(driver, model, rig, observer=Silent()).cause is StopCause.END


def test_frozen_readings_are_a_lost_estimate(model, rig):
    def law(state, reference):  # the arm must move
        t = NearDriver.tower.hands.time
        return 4.0 * np.array([math.sin(20 * t), math.cos(20 * t)])

    found = run(
        model, rig, law, duration=2.0, on_step=fault("freeze", ("shoulder", "elbow"), at=0.6)
    )
    assert found.cause is StopCause.LOST
    assert 0.6 < found.log.t[-1] < 1.0


def test_a_reading_beyond_its_limits_stops_the_run(model, rig):
    found = run(model, rig, held(model, (59.0, 0.0)), duration=2.0, limits=RigLimits(ramp=0.0))
    assert found.cause is StopCause.LIMIT
    assert "shoulder" in found.reason


def driven_by(driver, model, rig, controller=None, observer=None):
    """A run of half a second by this driver."""
    return Drive(
        model, controller or held(model), SetPoint(np.zeros(3)), driver, observer, period=PERIOD,
        duration=0.5, watchdog=False, source=rig.hands.source,
    ).run()  # fmt: skip


def test_a_tension_beyond_its_bound_stops_the_run(model, rig):
    class Strong(NearDriver):
        def read(self):
            values, stamps = super().read()
            values = values.copy()
            values[2] = 70.0 if self.tower.hands.time > 100.2 else values[2]
            return values, stamps

    found = driven_by(Strong(model), model, rig)
    assert found.cause is StopCause.TENSION
    assert rig.stops == 1


class Broken:
    """A controller that does something else after a few calls."""

    def __init__(self, then):
        self.then, self.calls = then, 0

    def __call__(self, state, reference):
        self.calls += 1
        return np.zeros(2) if self.calls < 40 else self.then()

    def __deepcopy__(self, memo):
        raise TypeError("not to be copied")


def raises():
    raise RuntimeError("my own mistake")


def test_a_controller_s_exception_and_a_command_that_is_not_finite(model, rig):
    found = run(model, rig, Broken(raises))
    assert found.cause is StopCause.CONTROLLER
    assert "my own mistake" in found.log.reason
    assert isinstance(found.error, RuntimeError)
    found = run(model, rig, Broken(lambda: np.full(2, np.nan)))
    assert found.cause is StopCause.COMMAND
    assert rig.stops == 2


@pytest.mark.parametrize("method", ["start", "read", "send"])
def test_a_driver_s_exception(model, rig, method):
    class Failing(NearDriver):
        pass

    def fails(self, *_):
        if method == "start" or self.tower.hands.time > 100.2:
            raise OSError("cable unplugged")
        return getattr(NearDriver, method)(self, *_)

    setattr(Failing, method, fails)
    found = driven_by(Failing(model), model, rig)
    assert found.cause is StopCause.DRIVER
    assert found.reason == f"{method}(): OSError: cable unplugged"
    assert rig.stops == 1


def test_a_rig_that_cannot_be_relaxed_is_said_whatever_has_stopped_the_run(model, rig):
    class Stuck(NearDriver):
        def stop(self):
            super().stop()
            raise OSError("no answer")

    warning = "stop(): no answer; relax the rig by hand"
    found = driven_by(Stuck(model), model, rig)
    assert (found.cause, found.reason) == (StopCause.DRIVER, warning)
    found = driven_by(Stuck(model), model, rig, Broken(raises))
    assert found.cause is StopCause.CONTROLLER
    assert "my own mistake" in found.reason
    assert found.reason.endswith(warning)
    assert rig.stops == 4  # each is tried twice


def test_an_observer_s_exception(model, rig):
    class Blind:
        def step(self, t, measurements, u):
            raise ValueError("dark")

    found = run(model, rig, observer=Blind())
    assert found.cause is StopCause.OBSERVER
    assert rig.stops == 1


def test_a_miss_holds_the_last_command_and_many_stop_the_run(model, rig):
    slow = {20: 2.3, 30: 0.7}

    def law(state, reference):
        k = round((rig.hands.time - begin) / PERIOD)
        rig.hands.pass_(slow.get(k, 0.0) * PERIOD)
        return np.array([2.0, 1.0])

    begin = 100.0
    found = run(model, rig, law, limits=RigLimits(ramp=0.0))
    log = found.log
    assert found.cause is StopCause.END
    assert log.missed.sum() == 2
    left = np.flatnonzero(log.status == "left out")
    assert len(left) == 1
    assert np.isnan(log.clock[left]).all()
    assert (log.command[left] == log.command[left - 1]).all()
    slow[25] = 6.0
    begin = rig.hands.time
    assert run(model, rig, law).cause is StopCause.MISSED


class Slow(NearDriver):
    """A driver whose readings take nearly two periods, now and then."""

    since, calls = 100.0, 0

    def read(self):
        self.calls += 1
        if self.since < self.tower.hands.time and self.calls % 8 == 0:
            self.tower.hands.pass_(1.8 * PERIOD)
        return super().read()


@pytest.mark.parametrize("since", [100.5, 100.0])
def test_periods_left_out_while_the_commands_fall_do_not_mislead_the_observer(model, rig, since):
    class Late(Slow):
        pass

    class Seen(Ekf):
        def step(self, t, measurements, u, stamps=None, sent=None):
            found = super().step(t, measurements, u, stamps, sent)
            if rig.rig.state()["sent_at"]:  # no copy that only warms up
                seen.append((t, found.nis, found.used))
            return found

    Late.since, seen = since, []
    found = driven_by(Late(model), model, rig, held(model, (20.0, 15.0)), observer=Seen(model))
    assert found.cause is StopCause.END, found.reason
    falling = rig.hands.time - found.log.clock[0] - found.log.duration
    assert falling == pytest.approx(0.5, abs=2 * PERIOD)
    _, nis, used = np.array([row for row in seen if row[0] > 0.5]).T
    assert nis.sum() < chdtri(used.sum(), SURE)


def test_an_estimate_is_not_judged_while_the_commands_fall(model, rig):
    """Frozen readings of an arm that falls are the worst of estimates."""

    class Freezing(NearDriver):
        def send(self, commands):
            if rig.hands.time > 100.5 and commands[0] < 20.0:
                self.tell({"fault": "freeze", "sensors": ["shoulder", "elbow"]})
            super().send(commands)

    found = driven_by(Freezing(model), model, rig, held(model, (20.0, 15.0)))
    assert found.cause is StopCause.END, found.reason


def test_a_winch_turns_on_while_periods_are_left_out(model):
    winch = {"command": CommandKind.VELOCITY, "stiffness": 900.0}
    motors = tuple(replace(motor, **winch) for motor in model.robot.actuators)
    wound = softdyn.build(replace(model.robot, actuators=motors))
    safe = FailSafe(wound, RigLimits(ramp=0.0), PERIOD)
    state = wound.state(wound.q0, np.zeros(2))
    sent = []
    for left_out in (0, 3):
        driver = NearDriver(wound)
        driver.send = sent.append
        plant = RealRig(wound, driver, safe, PERIOD)
        plant.advance(np.array([9.0, 0.0]), 1, state)
        plant.leave_out(left_out)
        plant.advance(np.array([9.0, 0.0]), 1, state)
    assert sent[1] == pytest.approx(0.0, abs=1e-12)
    assert sent[3] == pytest.approx(-3 * sent[2])


def test_what_cannot_be_driven_is_refused(model, rig):
    with refused("driver", "no start()"):
        Drive(model, held(model), SetPoint(np.zeros(3)), object())
    with refused("stale", 0.03):
        run(model, rig, limits=RigLimits(stale=0.03))
