"""A simulated rig in real time behind a local socket: something to drive without hardware.

Both sides write JSON, one object a line. A client sends

    {"send": [1.5, 0, …]}                         commands of all motors, which act until the next
    {"stop": true}                                relax: no motor pulls
    {"fault": "lose", "sensors": ["camera"]}      or delay, repeat, freeze, die, none
    {"fault": "jam", "motors": ["winch"]}         a motor that stays where it is; cut: its cable
    {"ask": "state"}                              see `ServedRig.state`

and gets, every two milliseconds, the readings that are new:

    {"values": [0.12, null, …], "stamps": [1234.5, null, …]}

with stamps in `time.monotonic()`. The rig is the twin with the motors and sensors of its file. It
begins at rest, with relaxed motors.
Commands act on if their sender goes away, as those of real motor drives do.
"""

from __future__ import annotations

import json
import math
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.checks import did_you_mean, number, vector
from softdyn.description.rig import CommandKind
from softdyn.exceptions import one_line
from softdyn.validation.bench.plant import rest_pose
from softdyn.validation.twin.rig import Rig, RiggedPlant
from softdyn.view.loopback import listener

TICK = 0.002  # s between two readings of sensors without a rate
BEHIND = 0.1  # s; if the simulation is later than this, its time stands still meanwhile
SAME = 1e-3  # of a sampling interval
FAULTS = ("none", "lose", "delay", "repeat", "freeze", "die")
BROKEN = ("cut", "jam")  # faults of motors
LONGEST_DELAY = 10.0  # s
MOST_WAITING = 1 << 20  # bytes that a client has not read; more ends it
MOST_CLIENTS = 16


class Faults:
    """The faults of the readings, by component.

    Parameters
    ----------
    model : SoftModel
        The robot with its sensors.
    """

    def __init__(self, model: SoftModel) -> None:
        sensors = model.robot.sensors
        self.names = [sensor.name for sensor in sensors]
        self._owner = np.repeat(np.arange(len(sensors)), [sensor.kind.size for sensor in sensors])
        self.clear()

    def clear(self) -> None:
        """No fault."""
        size = len(self._owner)
        self._lost, self._repeated, self._frozen = np.zeros((3, size), bool)
        self._delay, self._last = np.zeros(size), np.full((2, size), np.nan)
        self._waiting: deque[tuple[float, np.ndarray, np.ndarray]] = deque()

    def add(self, kind: str, sensors: Iterable[str], seconds: float) -> None:
        """A fault of some sensors; `seconds` is that of a delay.

        Raises
        ------
        InputError
            An unknown fault or sensor, a delay out of range.
        """
        for name in sensors:
            if name not in self.names:
                raise InputError("sensors", "names of sensors", did_you_mean(str(name), self.names))
        chosen = np.isin(self._owner, [self.names.index(name) for name in sensors])
        if kind == "lose":
            self._lost |= chosen
        elif kind == "repeat":
            self._repeated |= chosen
        elif kind == "freeze":
            self._frozen |= chosen
        else:
            late = number("seconds", seconds, lower=0.0, upper=LONGEST_DELAY)
            self._delay[chosen] = late

    def pass_on(
        self, values: np.ndarray, stamps: np.ndarray, now: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The readings that leave the rig at `now` (s); NaN where there is none."""
        frozen = self._frozen & ~np.isnan(values) & ~np.isnan(self._last[0])
        values = np.where(frozen, self._last[0], values)
        again = self._repeated & ~np.isnan(self._last[0])
        values, stamps = (
            np.where(again, old, new) for old, new in zip(self._last, (values, stamps), strict=True)
        )
        here = ~np.isnan(values)
        self._last[0, here], self._last[1, here] = values[here], stamps[here]
        sent = np.where(self._lost, np.nan, values)
        if not self._delay.any() and not self._waiting:
            return sent, stamps
        later = self._delay > 0
        for delay in np.unique(self._delay[later]):
            these = self._delay == delay
            self._waiting.append((now + delay, np.where(these, sent, np.nan), stamps))
        sent = np.where(later, np.nan, sent)
        for _ in range(len(self._waiting)):
            due, old, at = self._waiting.popleft()
            if due > now:
                self._waiting.append((due, old, at))
                continue
            ready = ~np.isnan(old)
            sent, stamps = np.where(ready, old, sent), np.where(ready, at, stamps)
        return sent, stamps


class ServedRig:
    """The twin of a robot with its rig, on a local socket.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    port : int, optional
        By default a free one.
    seed : int
        Seed of the sensors' noise.
    clock : Callable[[], float]
        The clock (s).

    Attributes
    ----------
    port : int
        The port on 127.0.0.1.

    Raises
    ------
    InputError
        A port that is taken.
    """

    def __init__(
        self,
        model: SoftModel,
        port: int | None = None,
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._model, self._clock = model, clock
        self._plant = RiggedPlant(Rig(seed=seed), model, TICK)
        self._plant.start(rest_pose(model), np.zeros(model.nv))
        self._relaxed = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
        self._commands: np.ndarray | None = None
        self._relaxed_at: float | None = None
        self._sent_at: float | None = None
        self._all, self._none = np.ones(model.nu, bool), np.zeros(model.nu, bool)
        sizes = [sensor.kind.size for sensor in model.robot.sensors]
        self._rates, self._latencies = (
            np.repeat([getattr(sensor, name) for sensor in model.robot.sensors], sizes)
            for name in ("rate", "latency")
        )
        self._number, self._nothing = np.full(sum(sizes), -np.inf), np.full(sum(sizes), np.nan)
        self.faults, motor = Faults(model), self._plant.twin.model
        self._jammed = np.full(model.nu, np.nan)  # commands of motors that no longer move
        self._law = motor.actuator_gainprm.copy(), motor.actuator_biasprm.copy()
        self._listening = listener(port)
        self._listening.setblocking(False)
        self.port = int(self._listening.getsockname()[1])
        self._clients: dict[socket.socket, tuple[bytearray, bytearray]] = {}
        self._steps, self._read, self._slipped, self.over = 0, 0, 0.0, False
        self._begin = clock()

    @property
    def timestep(self) -> float:
        """Plant step (s)."""
        return float(self._plant.twin.model.opt.timestep)

    def state(self) -> dict[str, Any]:
        """The answer to ``ask``.

        Returns
        -------
        dict
            ``tip`` (m); ``forces``, the inputs that act; ``relaxed_at``, since when no command
            acts, and ``sent_at``, the time of the last commands, on the clock of
            `time.monotonic` (s), or None; ``slipped``, the time (s) by which the simulation is
            slower than the clock.
        """
        q, v = self._plant.state()
        return {
            "tip": self._model.state(q, v).y.tolist(), "forces": self._plant.acting.tolist(),
            "relaxed_at": self._relaxed_at, "sent_at": self._sent_at, "slipped": self._slipped,
        }  # fmt: skip

    def serve(self) -> None:
        """Simulate and answer until the fault ``die``, or until `over` is set.

        Raises
        ------
        SimulationError
            The twin diverges.
        """
        due = self._clock()
        try:
            while not self.over:
                self._answer(max(due - self._clock(), 0.0))
                if self._clock() < due:
                    continue
                due = max(due + TICK, self._clock() - TICK)
                self.tick()
        finally:
            for one in (*self._clients, self._listening):
                one.close()

    def tick(self) -> None:
        """Simulate up to now, and send the new readings."""
        values, stamps = self.advance()
        new = ~np.isnan(values)
        if new.any():
            message = {
                name: [float(x) if there else None for x, there in zip(row, new, strict=True)]
                for name, row in (("values", values), ("stamps", stamps))
            }
            line = json.dumps(message).encode() + b"\n"
            for client in tuple(self._clients):
                self._tell(client, line)

    def advance(self) -> tuple[np.ndarray, np.ndarray]:
        """Simulate up to now; the new readings (k,), NaN where there is none, and their times.

        Raises
        ------
        SimulationError
            The twin diverges.
        """
        now = self._clock()
        self._simulate(now)
        if self._steps == self._read:
            return self._nothing, self._nothing
        self._read = self._steps
        return self.faults.pass_on(*self._readings(), now)

    def _simulate(self, now: float) -> None:
        """Simulate up to now (s) under the commands that act."""
        behind = now - self._begin - self._steps * self.timestep
        if behind > BEHIND:
            self._begin += behind - BEHIND
            self._slipped += behind - BEHIND
        steps = int((now - self._begin) / self.timestep) - self._steps
        if steps <= 0:
            return
        plant, state = self._plant, self._model.state(*self._plant.state())
        values, commanded = self._relaxed, self._none
        if self._commands is not None:
            values, commanded = self._commands, self._all
        stuck = ~np.isnan(self._jammed)
        u = plant.direct(np.where(stuck, self._jammed, values), commanded | stuck, state)
        plant.advance(u, steps, state)
        self._steps += steps

    def _readings(self) -> tuple[np.ndarray, np.ndarray]:
        """The readings (k,) that are new at the end of the last step, NaN for others; times."""
        t = self._steps * self.timestep
        values, own = self._plant.sample()["measured"], t - self._latencies
        sampled = self._rates > 0
        rate = np.where(sampled, self._rates, 1.0)
        found = np.floor(own * rate + SAME)
        own = np.where(sampled, found / rate, own)
        new = (~sampled | (found > self._number)) & (own >= 0)
        self._number = np.maximum(found, self._number)
        return np.where(new, values, np.nan), self._begin + own

    # -- clients ---------------------------------------------------------------------------------

    def _answer(self, longest: float) -> None:
        """Take what the clients have sent, or wait for it so long (s)."""
        writing = [one for one, (_, out) in self._clients.items() if out]
        ready, free, _ = select.select([self._listening, *self._clients], writing, [], longest)
        for one in free:
            self._tell(one, b"")
        for one in ready:
            if one is self._listening:
                with suppress(OSError):
                    client, _ = self._listening.accept()
                    if len(self._clients) >= MOST_CLIENTS:
                        client.close()
                        continue
                    client.setblocking(False)
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._clients[client] = bytearray(), bytearray()
            elif one in self._clients:
                self._listen(one)

    def _listen(self, client: socket.socket) -> None:
        try:
            data = client.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        heard = self._clients[client][0]
        heard += data
        if not data or len(heard) > MOST_WAITING:
            self._leave(client)
            return
        *lines, rest = bytes(heard).split(b"\n")
        heard[:] = rest
        for line in lines:
            answer = self.obey(line)
            if answer is not None:
                self._tell(client, json.dumps(answer).encode() + b"\n")

    def obey(self, line: bytes | str) -> dict[str, Any] | None:
        """Do what a line of JSON says; an answer, if it has one."""
        try:
            said = json.loads(line)
            match said:
                case {"send": values}:
                    commands, now = vector("send", values, self._model.nu), self._clock()
                    self._simulate(now)
                    self._commands, self._sent_at, self._relaxed_at = commands, now, None
                case {"stop": True}:
                    now = self._clock()
                    self._simulate(now)
                    self._commands, self._relaxed_at = None, self._relaxed_at or now
                case {"fault": "die"}:
                    self.over = True
                case {"fault": "none"}:
                    self.faults.clear()
                    self._mend()
                case {"fault": str(kind), "motors": names} if kind in BROKEN:
                    self._break(kind, names)
                case {"fault": str(kind)} if kind in FAULTS:
                    sensors = said.get("sensors", self.faults.names)
                    self.faults.add(kind, sensors, said.get("seconds", math.nan))
                case {"ask": "state"}:
                    return {"state": self.state()}
                case _:
                    raise InputError("message", "send, stop, fault or ask", one_line(said))
        except (ValueError, TypeError, RecursionError) as error:
            return {"error": one_line(error)}
        return None

    def _break(self, kind: str, names: Iterable[str]) -> None:
        """Jam motors, or cut their cables."""
        robot, law = self._model.robot, self._plant.twin.model
        known = [actuator.name for actuator in robot.actuators]
        for name in names:
            if name not in known:
                raise InputError("motors", "names of actuators", did_you_mean(str(name), known))
            k = known.index(name)
            if kind == "cut":
                law.actuator_gainprm[k] = law.actuator_biasprm[k] = 0.0
            else:
                speed = robot.actuators[k].command is CommandKind.VELOCITY
                self._jammed[k] = 0.0 if speed else self._plant.command[k]

    def _mend(self) -> None:
        """Undo `_break`."""
        law = self._plant.twin.model
        law.actuator_gainprm[:], law.actuator_biasprm[:] = self._law
        self._jammed[:] = np.nan

    def _tell(self, client: socket.socket, line: bytes) -> None:
        """Send a line, or as much of it as the client takes."""
        waiting = self._clients[client][1]
        waiting += line
        try:
            sent = client.send(waiting) if waiting else 0
            del waiting[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._leave(client)
            return
        if len(waiting) > MOST_WAITING:
            self._leave(client)

    def _leave(self, client: socket.socket) -> None:
        del self._clients[client]
        client.close()
