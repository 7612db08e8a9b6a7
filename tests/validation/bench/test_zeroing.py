"""Zeros of a rig: found on a served rig with offsets, written, driven with, and refused by name."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint
from softdyn.controllers import best
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.validation.bench import zeroing
from softdyn.validation.bench.drive import Drive
from softdyn.validation.bench.fail_safe import RigLimits, Stop, StopCause
from softdyn.validation.bench.zeroing import Zeroing, ZeroSettings, _Sweep, zero_drive
from tests.support.bench import NearDriver, tower
from tests.support.command import command
from tests.support.refused import refused
from tests.support.robots import cable, motor, two_links

WINCH = {"command": "length", "stiffness": 900, "damping": 4, "lag": 0.02}
ARM = two_links(
    "wound", cable("below", "base -0.02 0 -0.03", "upper 0.1 0 -0.03", "fore 0.15 0 -0.03"),
    cable("above", "shoulder -0.03"), motor("below", 0, 30, -1, "flexor", **WINCH),
    motor("above", 0, 30, -1, "lifter", **WINCH), '<task frame="tip"/>',
    '<sensor name="wire" type="length" tendon="below" noise="5e-4"/>',
    '<sensor name="cord" type="length" tendon="above" noise="5e-4"/>',
    '<sensor name="pull" type="tension" tendon="below" noise="0.2"/>',
    '<sensor name="lift" type="tension" tendon="above" noise="0.2"/>',
)  # fmt: skip
OFFSETS, BIASES = (0.02, -0.02), (0.007, -0.004)
PERIOD = 0.01


def stated(robot, offsets, biases=(0.0, 0.0)):
    """The robot with these offsets of its winches and biases of its encoders."""
    motors = (replace(a, offset=z) for a, z in zip(robot.actuators, offsets, strict=True))
    encoders = (
        replace(s, bias=(b,)) for s, b in zip(robot.sensors[:2], biases, strict=True)
    )  # fmt: skip
    return replace(robot, actuators=tuple(motors), sensors=(*encoders, *robot.sensors[2:]))


def built(*of):
    return softdyn.build(stated(parse_text(ARM, path=Path("wound.urdf")), *of))


@pytest.fixture(scope="module")
def model():
    return built((0.0, 0.0))


def zeroed(model, rig, on_step=None, driver=NearDriver, **settings):
    """A run of the procedure on the near rig, and what it found."""
    how = ZeroSettings(**{"repeats": 2, "reach": 0.03, **settings})
    run, found = zero_drive(
        model, driver(model), how, period=PERIOD, watchdog=False, source=rig.hands.source
    )
    return run.run(on_step=on_step), found


@pytest.fixture(scope="module")
def measured(model):
    """The zeros of the rig with offsets, and the run."""
    rig = tower(built(OFFSETS, BIASES))
    done, found = zeroed(model, rig)
    assert done.cause is StopCause.END, done.reason
    return rig, done.log, found


def test_offsets_of_20_mm_are_found_within_half_a_millimetre(measured):
    rig, log, found = measured
    offsets = [zero.offset for zero in found.zeros]
    biases = [*found.zeros[0].biases.values(), *found.zeros[1].biases.values()]
    np.testing.assert_allclose(offsets, OFFSETS, atol=5e-4)
    np.testing.assert_allclose(biases, BIASES, atol=5e-4)
    assert rig.stops == 1
    assert log.measured[:, 2:].max() < 1.5 * found._cables[0].pull  # nothing is torn
    assert np.abs(np.diff(log.command[5:], axis=0)).max() < 1.01 * 0.01 * PERIOD


def test_the_written_file_is_driven_as_the_rig_without_offsets(model, measured):
    *_, found = measured
    new = softdyn.build(parse_text(write(found.robot(model.robot)), path=Path("new.urdf")))
    target = SetPoint(model.state(np.array([0.25, 0.3]), np.zeros(2)).y)
    tips, ends = [], []
    usual, never = RigLimits().lost, 9.0
    for known, true, lost in (
        (new, built(OFFSETS, BIASES), usual),
        (model, model, usual),
        (model, built(OFFSETS), never),
    ):
        rig = tower(true)
        run = Drive(
            known, best(known), target, NearDriver(known), period=0.005, duration=1.0,
            watchdog=False, source=rig.hands.source, limits=RigLimits(lost=lost),
        )  # fmt: skip
        done = run.run(on_step=lambda _, rig=rig: tips.append(rig.rig.state()["tip"]))
        assert done.cause is StopCause.END, done.reason
        ends.append(tips[-1])
    assert math.dist(ends[0], ends[1]) < 2e-3
    assert math.dist(ends[2], ends[1]) > 1e-2  # as the file was before


def breaking(kind, motor, when):
    """Tell the rig a fault of a motor as soon as `when(rig, t)` holds."""
    done = []

    def on_step(step):
        rig = NearDriver.tower.rig
        if not done and when(rig, step.t):
            done.append(rig.obey(json.dumps({"fault": kind, "motors": [motor]})))

    return on_step


def pulls(k):
    return lambda rig, t: rig.state()["forces"][k] > 1.6


def slack_again():
    """Whether the first cable has been pulled, and is slack."""
    before = []

    def when(rig, t):
        force = rig.state()["forces"][0]
        before.append(force)
        return max(before) > 2.0 and force == 0.0

    return when


@pytest.mark.parametrize(
    ("kind", "motor", "when", "said"),
    [
        ("cut", "flexor", lambda rig, t: t >= 0, "'flexor': it does not tighten from"),
        ("jam", "lifter", lambda rig, t: t >= 0.5, "'lifter': it does not tighten from"),
        ("jam", "flexor", pulls(0), "'flexor': its tension stays at"),
        ("jam", "lifter", pulls(1), "'lifter': its tension stays at"),
        ("cut", "flexor", slack_again(), "'flexor': its tension stays at"),
    ],
)
def test_a_cut_and_a_jammed_cable_are_refused_by_name(model, kind, motor, when, said):
    rig = tower(model)
    done, _ = zeroed(model, rig, breaking(kind, motor, when))
    assert done.cause is StopCause.CABLE
    assert said in done.reason
    assert rig.stops == 1


def test_a_slack_and_a_tight_cable_are_refused_by_name(model):
    rig = tower(built((0.0, 0.09)))
    done, found = zeroed(model, rig)
    assert done.cause is StopCause.CABLE
    assert done.reason.startswith("cable of 'lifter': it does not tighten from 0.0191 to")
    assert [zero.actuator for zero in found.zeros] == ["flexor"]
    done, _ = zeroed(model, tower(built((-0.06, 0.0))))
    assert "cable of 'flexor': it is tight" in done.reason


def test_a_zero_that_scatters_is_refused_by_name(model):
    class Slipping(NearDriver):
        def send(self, commands):
            slip = 2e-4 * (self.tower.hands.time - 100.0)
            super().send(commands + np.array([slip, 0.0]))

    done, _ = zeroed(model, tower(model), driver=Slipping)
    assert done.cause is StopCause.CABLE
    assert "'flexor': its zero scatters by" in done.reason


def misread(change):
    """A class of drivers whose readings (wire, cord, pull, lift) are changed by `change`."""

    class Misread(NearDriver):
        def read(self):
            values, stamps = super().read()
            return change(np.array(values)), stamps

    return Misread


def frozen(values):
    """The readings, with a first encoder that stands still at 0.1 m."""
    return np.where([True, False, False, False] & np.isfinite(values), 0.1, values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda readings: readings[[1, 0, 2, 3]], "has a bias of -366"),
        (frozen, "changes by"),
    ],
    ids=["exchanged", "frozen"],
)
def test_an_encoder_that_does_not_follow_the_model_is_refused_by_name(model, change, said):
    done, found = zeroed(model, tower(model), driver=misread(change))
    assert done.cause is StopCause.CABLE, done.reason
    assert done.reason.startswith("cable of 'flexor': its encoder 'wire'")
    assert said in done.reason
    assert not found.zeros


def sweeps_of(found, read, lags=(0.0115, 0.0095)):
    """Two pulls of the first cable by the model's own curve; `read` is its encoder's, of ℓ (m)."""
    cable, rng = found._cables[0], np.random.default_rng(0)
    free = np.linspace(cable.rest + 2e-3, cable.rest - cable.travel, 400)
    for winding, offset in zip([True, False] * 2, lags * 2, strict=True):
        wire = read(cable.length(free)) + 5e-4 * rng.normal(size=len(free))
        yield _Sweep(np.array([free - offset, cable.tension(free), wire]).T.tolist(), winding)


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (lambda length: 1e3 * length, "changes by"),
        (lambda length: -length, "changes by"),
        (lambda length: 0.2 * length, "changes by"),
        (lambda length: np.full_like(length, 1e7), "changes by"),
        (lambda length: length + 0.06, "has a bias of"),
        (lambda length: length - 0.06, "has a bias of"),
    ],
)
def test_an_encoder_of_another_slope_or_far_away_is_refused(model, read, said):
    found = Zeroing(model, ZeroSettings(repeats=2))
    with pytest.raises(Stop) as refused:
        found._judged(found._cables[0], list(sweeps_of(found, read)))
    assert refused.value.cause is StopCause.CABLE
    assert f"its encoder 'wire' {said}" in refused.value.reason


def test_a_coarse_encoder_is_not_refused(model):
    """Ticks of 5 mm, more than the cable moves in a pull, are no frozen encoder."""
    ticks = (replace(s, resolution=(5e-3,)) if s.name == "wire" else s for s in model.robot.sensors)
    coarse = softdyn.build(replace(model.robot, sensors=tuple(ticks)))
    found = Zeroing(coarse, ZeroSettings(repeats=2))
    sweeps = list(sweeps_of(found, lambda length: 5e-3 * np.round(length / 5e-3)))
    zero = found._judged(found._cables[0], sweeps)
    assert zero.biases["wire"] == pytest.approx(0.0, abs=5e-3)


def test_the_offset_is_the_mean_of_both_directions(model):
    """Sweeps that lag by 1.5 mm wound up, and by 0.5 mm the other way paid out."""
    found = Zeroing(model, ZeroSettings(repeats=2))
    sweeps = list(sweeps_of(found, lambda length: length + 3e-3))
    zero = found._judged(found._cables[0], sweeps)
    assert zero.offset == pytest.approx(0.0105, abs=1e-6)
    assert zero.hysteresis == pytest.approx(-0.002, abs=1e-6)
    assert zero.biases["wire"] == pytest.approx(3e-3, abs=1e-4)


@pytest.mark.parametrize(("factor", "refused"), [(9.81, True), (0.102, True), (1.3, False)])
def test_a_tension_in_another_unit_is_refused_and_friction_is_not(model, factor, refused):
    cable = Zeroing(model)._cables[0]
    free = np.linspace(cable.rest + 2e-3, cable.rest - cable.travel, 200)
    rows = np.array([free - 0.01, factor * cable.tension(free)]).T
    if refused:
        with pytest.raises(Stop, match=f"rises {factor} times as much as the model"):
            cable.fit(rows)
    else:
        assert cable.fit(rows) == pytest.approx(0.01, abs=1e-6)


@pytest.mark.parametrize("row", [0, 2])
def test_a_reading_that_is_not_finite_is_none(model, row):
    def change(values):
        values[row] = math.inf
        return values

    done, found = zeroed(model, tower(model), driver=misread(change))
    assert done.cause is StopCause.STALE
    assert "never came" in done.reason
    assert not found.zeros


def test_load_cells_with_zeros_and_a_file_that_has_biases(model):
    """Stated zeros of load cells do no harm, and an encoder's bias is found anew to 0.1 mm."""
    loads = {"pull": 4.0, "lift": -3.0}

    def biased(built, encoders):
        stated = {**loads, **encoders}
        changed = (replace(s, bias=(stated[s.name],)) for s in built.robot.sensors)
        return softdyn.build(replace(built.robot, sensors=tuple(changed)))

    known = biased(model, {"wire": 0.005, "cord": 0.002})
    true = biased(built(OFFSETS), {"wire": 0.007, "cord": -0.004})
    done, found = zeroed(known, tower(true), repeats=3)
    assert done.cause is StopCause.END, done.reason
    np.testing.assert_allclose([zero.offset for zero in found.zeros], OFFSETS, atol=5e-4)
    sensors = {s.name: s.bias[0] for s in found.robot(known.robot).sensors}
    assert sensors["wire"] == pytest.approx(0.007, abs=1e-4)
    assert sensors["cord"] == pytest.approx(-0.004, abs=1e-4)
    assert {name: sensors[name] for name in loads} == loads
    done, _ = zeroed(model, tower(true))
    assert "cable of 'flexor': it is tight" in done.reason
    assert "its sensor's bias is not that of the file" in done.reason


@pytest.mark.parametrize(
    ("change", "settings", "said"),
    [
        (("command=\"length\" stiffness=\"900\" damping=\"4\"", ""), {},
         ("zero", 'command="force"')),
        (('<sensor name="pull" type="tension" tendon="below" noise="0.2"/>', ""), {},
         ("zero", "none")),
        (("", ""), {"pull": 40.0}, ("pull", "40 N")),
        (("", ""), {"reach": 0.0}, ("reach", 0.0)),
        (("", ""), {"repeats": 1}, ("repeats", 1)),
    ],
)  # fmt: skip
def test_what_cannot_be_zeroed(change, settings, said):
    text = ARM.replace(*change) if change[0] else ARM
    model = softdyn.build(parse_text(text, path=Path("wound.urdf")))
    with refused(*said):
        zero_drive(model, NearDriver(model), ZeroSettings(**settings))


# -- the command -------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ARM)
    Path("near.py").write_text("from tests.support.bench import NearDriver\n")

    def served(true):
        rig = tower(true)
        made = partial(Drive, watchdog=False, source=rig.hands.source)
        monkeypatch.setattr(zeroing, "Drive", made)
        return rig

    return served


ZERO = "drive arm.urdf --zero --driver near.py:NearDriver --repeats 2 --reach 0.03"
WORDS = ZERO.split()


def test_the_command_writes_the_zeros(folder):
    folder(built(OFFSETS, BIASES))
    code, out, err = command(*WORDS, "--out", "new.urdf", "--json", "-")
    assert code == 0, err
    report = json.loads(out)
    assert [zero["actuator"] for zero in report["zeros"]] == ["flexor", "lifter"]
    robot = softdyn.parse("new.urdf")
    np.testing.assert_allclose([a.offset for a in robot.actuators], OFFSETS, atol=5e-4)
    np.testing.assert_allclose([s.bias[0] for s in robot.sensors[:2]], BIASES, atol=5e-4)
    assert softdyn.parse("arm.urdf").actuators[0].offset == 0.0


def test_a_refused_cable_writes_nothing(folder):
    folder(built((0.09, 0.0)))
    code, _, err = command(*WORDS, "--out", "new.urdf")
    assert code == 1
    assert err.splitlines()[-1].startswith("stopped by cable: cable of 'flexor': it does not")
    assert not list(Path().glob("new.urdf*"))


def test_zeros_are_kept_and_a_second_run_goes_on_from_them(folder):
    """The second cable is out of reach; with a larger reach it alone is pulled."""
    folder(built((OFFSETS[0], 0.04)))
    code, _, err = command(*WORDS, "--out", "new.urdf")
    assert code == 1
    assert "new.urdf.zeros.json: 1 of 2 zeros" in err
    kept = Path("new.urdf.zeros.json").read_text()
    again = [*WORDS, "--out", "new.urdf", "--resume", "new.urdf.zeros.json", "--reach", "0.05"]
    for fault in ({"digest": "other"}, {"format": "softdyn-zeros-2"}, {"zeros": [{"offset": 1}]}):
        Path("new.urdf.zeros.json").write_text(json.dumps(json.loads(kept) | fault))
        code, _, err = command(*again)
        assert code == 2, err
        assert "new.urdf.zeros.json: expected" in err
    first = json.loads(kept)["zeros"][0]["offset"]
    Path("new.urdf.zeros.json").write_text(kept.replace(str(first), str(first + 1e-3)))
    code, _, err = command(*again)
    assert code == 0, err
    offsets = [a.offset for a in softdyn.parse("new.urdf").actuators]
    assert offsets[0] == pytest.approx(first + 1e-3, abs=1e-9)
    assert offsets[1] == pytest.approx(0.04, abs=5e-4)
    assert not Path("new.urdf.zeros.json").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--out: expected a FILE"),
        (("--out", "arm.urdf"), "a file that this command does not read"),
        (("best", "--out", "new.urdf"), "--zero: not allowed with a CONTROLLER"),
    ],
)
def test_bad_input_is_one_line(folder, words, said):
    rig = folder(built((0.0, 0.0)))
    code, _, err = command(*WORDS[:2], *words, *WORDS[2:])
    assert code == 2
    assert said in err
    assert rig.starts == 0
