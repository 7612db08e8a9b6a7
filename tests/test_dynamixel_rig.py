"""The example of Dynamixel winches, on motors that are emulated on a pseudo-terminal."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

import softdyn
from softdyn import SetPoint
from softdyn.controllers import best
from softdyn.examples import dynamixel_rig as example
from softdyn.validation.bench.drive import Drive, hold_commands
from softdyn.validation.bench.fail_safe import StopCause
from tests.support import ROOT, dynamixel_bus
from tests.support.bench import Hands
from tests.support.command import command
from tests.support.sweeps import wait_for

PERIOD = 0.01
WATCHDOG, TORQUE_ON = dynamixel_bus.WATCHDOG, dynamixel_bus.TORQUE_ON


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finger")
    table = Path(ROOT / "docs/examples/dynamixel_finger.toml")
    assert command("new", str(table), "--out", str(folder / "finger.urdf"))[0] == 0
    return softdyn.load(folder / "finger.urdf")


@pytest.fixture
def bus(model, monkeypatch):
    """Two motors whose clock moves by hand, and whose answers have 0.2 s of real time or more."""
    hands = Hands()
    winches = dynamixel_bus.Winches(
        model, hands.source.now, example.SPOOL, example.AMPERE, example.TORQUE
    )
    made = dynamixel_bus.DynamixelBus(winches, 2, hands.source.now)
    made.hands = hands
    clock = SimpleNamespace(monotonic=hands.source.now, sleep=hands.pass_)
    monkeypatch.setattr(example, "time", clock)
    monkeypatch.setattr(example, "PORT", made.path)
    monkeypatch.setattr(example, "PATIENCE", 200.0)
    # the package waits 0.04 s for the answer to a written register
    monkeypatch.setattr(
        PortHandler, "setPacketTimeout", lambda port, _: port.setPacketTimeoutMillis(1000)
    )
    yield made
    made.close()


def driven(model, bus, driver, duration=0.5, on_step=None):
    """A run to a target."""
    target = SetPoint(model.state(np.full(model.nv, 0.12), np.zeros(model.nv)).y)
    run = Drive(
        model, best(model), target, driver, period=PERIOD, duration=duration, watchdog=False,
        source=bus.hands.source,
    )  # fmt: skip
    return run.run(on_step=on_step)


def test_the_protocol_is_that_of_the_package(bus):
    """Ping, registers and stuffed words, by the package's own checks."""
    port, packets = PortHandler(bus.path), PacketHandler(2.0)
    assert port.setBaudRate(1_000_000)
    assert packets.ping(port, 1) == (1190, COMM_SUCCESS, 0)
    value = 0x00FDFFFF  # whose bytes are those of a header
    assert packets.write4ByteTxRx(port, 2, 108, value) == (COMM_SUCCESS, 0)
    assert packets.read4ByteTxRx(port, 2, 108) == (value, COMM_SUCCESS, 0)
    bus.dead.add(2)
    assert packets.ping(port, 2)[1] != COMM_SUCCESS
    port.closePort()


def test_lengths_and_tensions_are_those_of_the_rig(model, bus):
    """Constant commands: one cable is wound up by 6 mm, its readings are the model's at rest."""
    rig = hold_commands(
        model, [-0.006, 0.004], example.DynamixelRig(model), period=PERIOD, duration=1.0,
        watchdog=False, source=bus.hands.source,
    ).run()  # fmt: skip
    assert rig.cause is StopCause.END, rig.reason
    measured = dict(zip(rig.log.sensor_names, rig.log.measured[-50:].mean(axis=0), strict=True))
    relaxed = softdyn.statics.settle(model, np.array([measured["load_cable_1"], 0.0]))
    assert measured["load_cable_1"] > 0.3
    assert measured["load_cable_2"] == pytest.approx(0.0, abs=0.15)
    state = model.state(relaxed.q, np.zeros(model.nv))
    assert measured["winch_cable_1"] == pytest.approx(state.lengths[0], abs=5e-4)


def test_lost_packets_are_counted_and_stop_nothing(model, bus):
    """1 % lost, 1 % with a wrong checksum, 1 % cut short."""
    bus.lose = bus.spoil = bus.cut = 0.01
    driver = example.DynamixelRig(model)
    found = driven(model, bus, driver, duration=1.5)
    assert found.cause is StopCause.END, found.reason
    assert bus.spoilt > 0
    assert driver.lost >= bus.spoilt  # the answers behind a short one may be lost with it
    assert driver.lost < driver.packets / 4
    assert np.linalg.norm(found.log.error[-1]) < 2e-3


def test_a_dead_motor_stops_the_run(model, bus, monkeypatch):
    monkeypatch.setattr(example, "PATIENCE", 20.0)

    def die(step):
        if step.t > 0.2:
            bus.dead.add(2)

    found = driven(model, bus, example.DynamixelRig(model), on_step=die)
    assert found.cause is StopCause.STALE
    assert "cable_2" in found.reason
    assert found.log.t[-1] < 0.2 + 0.1 + 3 * PERIOD
    wait_for(lambda: bus.registers[0][TORQUE_ON] == 0)  # the living one is relaxed
    wait_for(lambda: bus._winches.rig.state()["relaxed_at"] is not None)


def test_a_motor_s_own_fault_stops_the_run(model, bus):
    found = driven(
        model, bus, example.DynamixelRig(model),
        on_step=lambda step: bus.failing.update({1} if step.t > 0.2 else ()),
    )  # fmt: skip
    assert found.cause is StopCause.DRIVER
    assert "motor 1 has a fault" in found.reason


def test_a_motor_that_does_not_answer_at_the_start(model, bus):
    bus.dead.add(2)
    found = driven(model, bus, example.DynamixelRig(model))
    assert found.cause is StopCause.DRIVER
    assert "motor 2 does not answer" in found.reason
    wait_for(lambda: bus.registers[0][TORQUE_ON] == 0)


def test_the_motors_own_watchdog_is_set_and_taken_back(model, bus):
    """Without a packet for 100 ms a motor takes no goal; a new start mends it."""
    driver = example.DynamixelRig(model)
    driver.start()
    assert [one[WATCHDOG] for one in bus.registers] == [5, 5]
    bus.hands.pass_(0.2)
    driver.send([-0.001, 0.0])
    driver.read()
    wait_for(lambda: [one[WATCHDOG] for one in bus.registers] == [255, 255])
    driver.stop()
    driver.stop()
    wait_for(lambda: [one[TORQUE_ON] for one in bus.registers] == [0, 0])
    other = example.DynamixelRig(model)
    other.start()
    assert [one[WATCHDOG] for one in bus.registers] == [5, 5]
    other.stop()


def test_sensors_that_motors_cannot_read_are_refused():
    from tests.support.bench import bench_arm

    with pytest.raises(ValueError, match="motors read lengths and tensions"):
        example.DynamixelRig(bench_arm())
