"""A driver of winches with Dynamixel motors of the X series; needs `softdyn[dynamixel]`.

softdyn drive ROBOT CONTROLLER --driver dynamixel_rig.py:DynamixelRig --target X Y Z
"""

import math
import os
import sys
import time
from typing import Any

from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

PORT = os.environ.get("DYNAMIXEL_PORT", "/dev/ttyUSB0")
BAUD = 1_000_000  # motors leave the factory with 57 600
SPOOL = 0.01  # m, radius of the spool to the middle of its cable
TICK = 2 * math.pi / 4096  # rad
AMPERE = 0.001  # A, unit of a current: that of an XL330; an XM430 has 0.00269
TORQUE = 0.36  # N m/A, of an XL330-M288: hang a weight on your cable and measure it
PATIENCE = 1.0  # ms in which an answer must have come that was asked for a period ago

# registers of the X series: address, and bytes in the comments
MODE = 11  # 1; 5 is a position of many turns, with a bound on the current
TORQUE_ON = 64  # 1
WATCHDOG = 98  # 1; in 20 ms
GOAL_CURRENT, GOAL_POSITION = 102, 116  # 2, 4
PRESENT, BLOCK = 126, 10  # current 2, velocity 4, position 4
ALERT = 128  # in a status: the motor has a fault of its own


class DynamixelRig:
    """One motor for each actuator, with ids 1, 2, … in the order of the file.

    A turn winds cable up: the command of a free length is -SPOOL times the angle. The position of a
    motor and the stretch of its cable are read as the length of the tendon, the current as its
    tension.
    """

    def __init__(self, model):
        motors = model.robot.actuators
        self.ids = list(range(1, len(motors) + 1))
        self.most = [max(abs(m.gear * m.lower), abs(m.gear * m.upper)) for m in motors]
        self.soft = [m.stiffness for m in motors]
        tendons = [m.tendon for m in motors]
        self.readings = []  # the motor of each sensor, and whether it is a tension
        for sensor in model.robot.sensors:
            if sensor.tendon not in tendons:
                raise ValueError(f"{sensor.name}: motors read lengths and tensions of their cables")
            tension = sensor.kind.value == "tension"
            self.readings.append((tendons.index(sensor.tendon), tension))
        self.port: Any = None
        self.bus, self.asked = PacketHandler(2.0), None
        self.packets = self.lost = 0

    def start(self):
        self.port = PortHandler(PORT)
        if not self.port.setBaudRate(BAUD):
            raise OSError(f"{PORT} does not take {BAUD} baud")
        for motor, most in zip(self.ids, self.most, strict=True):
            _, result, _ = self.bus.ping(self.port, motor)
            if result != COMM_SUCCESS:
                raise OSError(f"motor {motor} does not answer")
            self.write(motor, TORQUE_ON, 1, 0)
            self.write(motor, WATCHDOG, 1, 0)  # after it has acted, the motor takes no goal
            self.write(motor, MODE, 1, 5)
            self.write(motor, GOAL_CURRENT, 2, round(most * SPOOL / TORQUE / AMPERE))
            self.write(motor, TORQUE_ON, 1, 1)  # its goal is now where it is
            self.write(motor, WATCHDOG, 1, 5)  # 100 ms without a packet: it stands still
        self.ask()

    def read(self):
        values, stamps = [math.nan] * len(self.readings), [math.nan] * len(self.readings)
        if self.asked is None:
            self.ask()
            return values, stamps
        for k, motor in enumerate(self.ids):
            self.packets += 1
            self.port.setPacketTimeoutMillis(PATIENCE)
            data, result, error = self.bus.readRx(self.port, motor, BLOCK)
            if result != COMM_SUCCESS or len(data) != BLOCK:
                self.lost += 1  # the next one will do; drive stops if none comes
                continue
            if error & ALERT:
                raise OSError(f"motor {motor} has a fault: read its hardware error status")
            current = int.from_bytes(bytes(data[:2]), "little", signed=True)
            position = int.from_bytes(bytes(data[6:]), "little", signed=True)
            tension = current * AMPERE * TORQUE / SPOOL
            length = -SPOOL * TICK * position + tension / self.soft[k]
            for row, (of, tense) in enumerate(self.readings):
                if of == k:
                    values[row], stamps[row] = (tension if tense else length), self.asked
        self.asked = None
        return values, stamps

    def send(self, commands):
        words = []
        for motor, length in zip(self.ids, commands, strict=True):
            goal = round(-length / (SPOOL * TICK))
            words += [motor, *goal.to_bytes(4, "little", signed=True)]
        self.bus.syncWriteTxOnly(self.port, GOAL_POSITION, 4, words, len(words))
        self.ask()

    def stop(self):
        if self.port is None:  # not started, or stopped before
            return
        port, self.port = self.port, None
        words = [word for motor in self.ids for word in (motor, 0)]
        for _ in range(3):  # one may be lost, and nobody answers
            port.is_using = False
            self.bus.syncWriteTxOnly(port, TORQUE_ON, 1, words, len(words))
            time.sleep(0.001)
        port.closePort()
        if self.lost:
            print(f"{self.lost} of {self.packets} packets were lost", file=sys.stderr)

    def ask(self):
        """Ask all motors; the answers are there when the next period begins."""
        self.port.is_using = False  # answers that are still to come do not count
        self.bus.syncReadTx(self.port, PRESENT, BLOCK, self.ids, len(self.ids), False)
        self.asked = time.monotonic()

    def write(self, motor, address, size, value):
        """Write one register, and see that it is done; three tries."""
        data = list(value.to_bytes(size, "little"))
        for _ in range(3):
            result, error = self.bus.writeTxRx(self.port, motor, address, size, data)
            if result == COMM_SUCCESS and not error & ~ALERT:
                return
        raise OSError(f"motor {motor} does not take {value} in register {address}")
