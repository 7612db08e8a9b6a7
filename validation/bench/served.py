"""A simulated rig in real time behind a local socket: something to drive without hardware.

Both sides write JSON, one object a line. A client sends

    {"send": [1.5, 0, …]}                         commands of all motors, which act until the next
    {"stop": true}                                relax: no motor pulls
    {"fault": "lose", "sensors": ["camera"]}      or delay, repeat, freeze, die, none
    {"fault": "jam", "motors": ["winch"]}         a motor that stays where it is; cut: its cable
    {"ask": "state"}                              see `ServedRig.state`

and gets, every two milliseconds, the readings that are new:

    {"values": [0.12, null, …], "stamps": [1234.5, null, …]}

with stamps in `time.monotonic()`. What cannot be done is answered by ``{"error": …}``: commands
beyond the bounds of their motors, and those of a second program while another one drives the rig,
which is the first that sent commands and is still connected. A refused program cannot stop the rig
either. The rig is the twin with the motors and sensors of its file. It
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
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.actuation import Winches
from softdyn.checks import did_you_mean, number, vector
from softdyn.description.readings import ReadingLayout, SampledSensor
from softdyn.exceptions import one_line
from softdyn.validation.bench.plant import rest_pose
from softdyn.validation.twin.rig import Rig, RiggedPlant
from softdyn.view.loopback import listener

TICK = 0.002  # s between two readings of sensors without a rate
BEHIND = 0.1  # s; if the simulation is later than this, its time stands still meanwhile
FAULTS = ("none", "lose", "delay", "repeat", "freeze", "die")
BROKEN = ("cut", "jam")  # faults of motors
LONGEST_DELAY = 10.0  # s
MOST_WAITING = 1 << 20  # bytes that a client has not read; more ends it
MOST_CLIENTS = 16
MOST = 1e6  # the largest length (m) or speed (m/s) of a command whose motor has no bound
ROUNDING = 1e-9  # of a command, in its unit


@dataclass
class _Client:
    """A program at the other end of a connection.

    Attributes
    ----------
    heard, waiting : bytearray
        What it has begun to say, and what it has not read yet.
    refused : bool
        Whether it has sent commands to a rig that another program drives.
    """

    heard: bytearray = field(default_factory=bytearray)
    waiting: bytearray = field(default_factory=bytearray)
    refused: bool = False


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
        self._owner = ReadingLayout(sensors).owners
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
        self._relaxed = model.relaxed
        winches = Winches(model)
        self._bounds = [
            np.clip(np.where(model.robot.speeds, sign * MOST, bound + sign * ROUNDING), -MOST, MOST)
            for sign, bound in ((-1, winches.lower), (1, winches.upper))
        ]
        self._commands: np.ndarray | None = None
        self._relaxed_at: float | None = None
        self._sent_at: float | None = None
        self._all, self._none = np.ones(model.nu, bool), np.zeros(model.nu, bool)
        self._layout = ReadingLayout(model.robot.sensors)
        self._times = [SampledSensor.of(sensor) for sensor in model.robot.sensors]
        self._taken = [-math.inf] * len(self._times)  # own times of the newest readings
        self._nothing = np.full(self._layout.size, np.nan)
        self.faults, motor = Faults(model), self._plant.twin.model
        self._jammed = np.full(model.nu, np.nan)  # commands of motors that no longer move
        self._law = motor.actuator_gainprm.copy(), motor.actuator_biasprm.copy()
        self._listening = listener(port)
        self._listening.setblocking(False)
        self.port = int(self._listening.getsockname()[1])
        self._clients: dict[socket.socket, _Client] = {}
        self._driving: tuple[socket.socket, int] | None = None  # a client, and its port
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

    def serve(self, over: Callable[[], bool] = lambda: False) -> None:
        """Simulate and answer until the fault ``die``, or until `over` is set or says so.

        Parameters
        ----------
        over : Callable[[], bool]
            Whether the command is to end.

        Raises
        ------
        SimulationError
            The twin diverges.
        """
        due = self._clock()
        try:
            while not (self.over or over()):
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
        values, own = self._plant.sample()["measured"], [one.own_time(t) for one in self._times]
        new = [now >= 0 and now > last for now, last in zip(own, self._taken, strict=True)]
        self._taken = own
        values = np.where(self._layout.spread(new).astype(bool), values, np.nan)
        return values, self._begin + self._layout.spread(own)

    # -- clients ---------------------------------------------------------------------------------

    def _answer(self, longest: float) -> None:
        """Take what the clients have sent, or wait for it so long (s)."""
        writing = [one for one, client in self._clients.items() if client.waiting]
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
                    self._clients[client] = _Client()
            elif one in self._clients:
                self._listen(one)

    def _listen(self, client: socket.socket) -> None:
        try:
            data = client.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        heard = self._clients[client].heard
        heard += data
        if not data or len(heard) > MOST_WAITING:
            self._leave(client)
            return
        *lines, rest = bytes(heard).split(b"\n")
        heard[:] = rest
        for line in lines:
            answer = self.obey(line, client)
            if answer is not None and client in self._clients:
                self._tell(client, json.dumps(answer).encode() + b"\n")

    def obey(self, line: bytes | str, client: socket.socket | None = None) -> dict[str, Any] | None:
        """Do what a line of JSON of a client says; an answer, if it has one."""
        try:
            said = json.loads(line)
            match said:
                case {"send": values}:
                    self._drives(client)
                    commands, now = self._bounded(values), self._clock()
                    self._simulate(now)
                    self._commands, self._sent_at, self._relaxed_at = commands, now, None
                case {"stop": True} if client and self._clients[client].refused:
                    pass  # it is not this program's run that must stop
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
        except (ValueError, TypeError, RecursionError, OSError) as error:
            return {"error": one_line(error)}
        return None

    def _drives(self, client: socket.socket | None) -> None:
        """Refuse commands of a client while another one drives."""
        if client is None:
            return
        if self._driving is None:
            self._driving = client, int(client.getpeername()[1])
        driver, port = self._driving
        if client is not driver:
            self._clients[client].refused = True
            got = f"a second one; that on port {port} drives it"
            raise InputError("send", "one program that drives this rig", got)

    def _bounded(self, values: Any) -> np.ndarray:
        """The commands (nu,) in a message; refuses those that no motor takes."""
        commands = vector("send", values, self._model.nu)
        bounds = zip(self._model.robot.actuators, commands, *self._bounds, strict=True)
        for actuator, command, lower, upper in bounds:
            if not lower <= command <= upper:
                expected = f"a command of {actuator.name!r} from {lower:g} to {upper:g}"
                raise InputError("send", expected, f"{command:g}")
        return commands

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
                self._jammed[k] = 0.0 if robot.speeds[k] else self._plant.command[k]

    def _mend(self) -> None:
        """Undo `_break`."""
        law = self._plant.twin.model
        law.actuator_gainprm[:], law.actuator_biasprm[:] = self._law
        self._jammed[:] = np.nan

    def _tell(self, client: socket.socket, line: bytes) -> None:
        """Send a line, or as much of it as the client takes."""
        waiting = self._clients[client].waiting
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
        if self._driving is not None and client is self._driving[0]:
            self._driving = None
        client.close()
