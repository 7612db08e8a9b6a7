"""Dynamixel motors of the X series on a pseudo-terminal: their protocol, and faults of the bus.

It shares no code with `dynamixel-sdk`: the checksum is computed bit by bit.
"""

from __future__ import annotations

import json
import math
import os
import select
import threading
import tty
from collections.abc import Callable

import numpy as np

from softdyn import SoftModel
from softdyn.description.rig import SensorKind
from softdyn.validation.bench.served import ServedRig

HEADER = b"\xff\xff\xfd\x00"
PING, READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x55, 0x82, 0x83
EVERYBODY = 0xFE
TORQUE_ON, WATCHDOG, GOAL_CURRENT, GOAL, PRESENT = 64, 98, 102, 116, 126
TICK = 2 * math.pi / 4096


def checksum(data: bytes) -> int:
    """CRC-16 with the polynomial 0x8005."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def packet(motor: int, instruction: int, words: bytes) -> bytes:
    """A packet, with its stuffing and its checksum."""
    body = (bytes([instruction]) + words).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = HEADER + bytes([motor]) + (len(body) + 2).to_bytes(2, "little") + body
    return head + checksum(head).to_bytes(2, "little")


class Winches:
    """The winches of a served rig as motors with spools: goals in ticks, currents and positions.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    clock : Callable[[], float]
        Its clock (s).
    spool, ampere, torque : float
        Radius of the spools (m), unit of a current (A), torque constant (N m/A).
    """

    def __init__(
        self, model: SoftModel, clock: Callable[[], float], spool: float, ampere: float,
        torque: float,
    ) -> None:  # fmt: skip
        self.rig = ServedRig(model, clock=clock)
        self._per_tick, self._per_newton = spool * TICK, spool / torque / ampere
        robot = model.robot
        kinds = [sensor.kind for sensor in robot.sensors]
        tendons = [sensor.tendon for sensor in robot.sensors]
        self._rows = []
        for motor in robot.actuators:
            places = [k for k, tendon in enumerate(tendons) if tendon == motor.tendon]
            length = next(k for k in places if kinds[k] is SensorKind.LENGTH)
            tension = next(k for k in places if kinds[k] is SensorKind.TENSION)
            self._rows.append((length, tension, motor.stiffness))
        self._last = np.zeros(len(kinds))

    def present(self) -> list[tuple[int, int]]:
        """Current and position of each motor."""
        values, _ = self.rig.advance()
        self._last = np.where(np.isnan(values), self._last, values)
        found = []
        for length, tension, soft in self._rows:
            pull = float(self._last[tension])
            free = float(self._last[length]) - pull / soft
            found.append((round(pull * self._per_newton), round(-free / self._per_tick)))
        return found

    def turn(self, goals: list[int | None]) -> None:
        """Send goals in ticks; None of a motor without torque relaxes all."""
        if any(goal is None for goal in goals):
            assert self.rig.obey('{"stop": true}') is None
            return
        lengths = [-goal * self._per_tick for goal in goals if goal is not None]
        assert self.rig.obey(json.dumps({"send": lengths})) is None


class DynamixelBus(threading.Thread):
    """Motors with ids from 1 on, on a pseudo-terminal.

    Attributes
    ----------
    path : str
        The terminal.
    lose, spoil, cut : float
        Chances that an answer is lost, has a wrong checksum, or lacks its last bytes.
    dead, failing : set of int
        Motors that no longer answer, and that report a fault of their own.
    answers, spoilt : int
        The number of answers to sync reads, and of those that did not come as they should.
    registers : list of bytearray
        The control table of each motor.
    """

    def __init__(self, winches: Winches, count: int, clock: Callable[[], float]) -> None:
        super().__init__(daemon=True)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path, self._winches, self._clock = os.ttyname(self._slave), winches, clock
        self.registers = [bytearray(160) for _ in range(count)]
        self.lose = self.spoil = self.cut = 0.0
        self.dead, self.failing = set[int](), set[int]()
        self.answers = self.spoilt = 0
        self._random, self._rest, self._heard = np.random.default_rng(0), b"", clock()
        self._over = threading.Event()
        self.start()

    def close(self) -> None:
        """End it."""
        self._over.set()
        self.join()
        for end in (self._master, self._slave):
            os.close(end)

    def run(self) -> None:
        """Answer until `close`."""
        while not self._over.is_set():
            if not select.select([self._master], [], [], 0.05)[0]:
                continue
            self._rest += os.read(self._master, 4096)
            while (found := self._next()) is not None:
                self._obey(*found)

    def _next(self) -> tuple[int, int, bytes] | None:
        """The next instruction: motor, instruction, words."""
        while (begin := self._rest.find(HEADER)) >= 0 and len(self._rest) >= begin + 7:
            self._rest = self._rest[begin:]
            end = 7 + int.from_bytes(self._rest[5:7], "little")
            if len(self._rest) < end:
                return None
            whole, self._rest = self._rest[:end], self._rest[end:]
            if checksum(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
                continue
            body = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            return whole[4], body[0], body[1:]
        return None

    def _obey(self, motor: int, instruction: int, words: bytes) -> None:
        now = self._clock()
        for registers in self.registers:  # 255 after the watchdog has acted
            if 0 < registers[WATCHDOG] < 255 and now - self._heard > 0.02 * registers[WATCHDOG]:
                registers[WATCHDOG] = 255
        self._heard = now
        if instruction == PING:
            self._answer(motor, b"\xa6\x04\x2d")
        elif instruction == READ:
            at, size = (int.from_bytes(words[k : k + 2], "little") for k in (0, 2))
            self._answer(motor, bytes(self._of(motor)[at : at + size]))
        elif instruction == WRITE:
            self._write(motor, int.from_bytes(words[:2], "little"), words[2:])
            self._answer(motor, b"")
        elif instruction == SYNC_READ:
            at, size = (int.from_bytes(words[k : k + 2], "little") for k in (0, 2))
            for registers, (current, position) in zip(
                self.registers, self._winches.present(), strict=True
            ):
                registers[PRESENT : PRESENT + 2] = current.to_bytes(2, "little", signed=True)
                registers[PRESENT + 6 : PRESENT + 10] = position.to_bytes(4, "little", signed=True)
            for one in words[4:]:
                self._answer(one, bytes(self._of(one)[at : at + size]), faulty=True)
        elif instruction == SYNC_WRITE:
            at, size = (int.from_bytes(words[k : k + 2], "little") for k in (0, 2))
            each = words[4:]
            for k in range(0, len(each), size + 1):
                self._write(each[k], at, each[k + 1 : k + 1 + size])
        if instruction in (WRITE, SYNC_WRITE):
            self._winches.turn([
                int.from_bytes(one[GOAL : GOAL + 4], "little", signed=True)
                if one[TORQUE_ON] else None
                for one in self.registers
            ])  # fmt: skip

    def _of(self, motor: int) -> bytearray:
        return self.registers[motor - 1]

    def _write(self, motor: int, at: int, data: bytes) -> None:
        registers = self._of(motor)
        if motor in self.dead or (at >= GOAL_CURRENT and registers[WATCHDOG] == 255):
            return
        if at == TORQUE_ON and data == b"\x01" and not registers[TORQUE_ON]:
            _, position = self._winches.present()[motor - 1]
            registers[GOAL : GOAL + 4] = position.to_bytes(4, "little", signed=True)
        registers[at : at + len(data)] = data

    def _answer(self, motor: int, words: bytes, faulty: bool = False) -> None:
        if motor in self.dead or not 1 <= motor <= len(self.registers):
            return
        error = 0x80 if motor in self.failing else 0
        whole = packet(motor, STATUS, bytes([error]) + words)
        if faulty:
            self.answers += 1
            chance = self._random.random()
            if chance < self.lose + self.spoil + self.cut:
                self.spoilt += 1
            if chance < self.lose:
                return
            if chance < self.lose + self.spoil:
                whole = whole[:-1] + bytes([whole[-1] ^ 0x55])
            elif chance < self.lose + self.spoil + self.cut:
                whole = whole[: -self._random.integers(1, 8)]
        os.write(self._master, whole)
