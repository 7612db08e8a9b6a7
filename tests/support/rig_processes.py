"""Real processes: a served rig and a loop that drives it, until a fault of some kind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from softdyn.examples import served_rig
from softdyn.validation import Log
from tests.support import PATIENCE
from tests.support.bench import bench_arm
from tests.support.robots import BENCH

# the driver, the controller and the observer; each fails on request, and notes when
OWN = """
import os, sys, time
import numpy as np
from softdyn.estimation import Ekf
from softdyn.examples.served_rig import ServedRig

KIND, AFTER = os.environ["FAULT"], float(os.environ["FAULT_AFTER"])
NOTES = os.open("notes.txt", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
FIRST = []  # the time of the first command, in the module that was loaded first


def note(*words):
    os.write(NOTES, (" ".join(map(str, (time.monotonic(), *words))) + "\\n").encode())


class Part:
    def due(self, kind):
        first = sys.modules["own"].FIRST
        if kind != KIND or not first or time.monotonic() < first[0] + AFTER:
            return False
        note("fault")
        return True


class Rig(ServedRig, Part):
    def __init__(self, model):
        super().__init__(model)
        self.newest = np.full(self.size, np.nan)

    def start(self):
        note("start")
        super().start()

    def read(self):
        if self.due("blocked read"):
            time.sleep(1000)
        if self.due("driver"):
            raise OSError("cable unplugged")
        values, stamps = map(np.array, super().read())
        for k, (kind, value) in enumerate([("limit", 9.0), ("", 0.0), ("tension", 90.0)]):
            if self.due(kind):
                values[k], stamps[k] = value, time.monotonic()
        self.newest = np.fmax(self.newest, stamps)
        return values, stamps

    def send(self, commands):
        sys.modules["own"].FIRST.append(time.monotonic())
        note("send")
        super().send(commands)

    def stop(self):
        note("stop", float(self.newest.min()))
        super().stop()


class Push(Part):
    def __init__(self, model):
        self.period = 0.0

    def reset(self, period):
        self.period = period

    def __call__(self, state, reference):
        if self.due("controller"):
            raise RuntimeError("my own mistake")
        if self.due("not finite"):
            return np.full(2, np.nan)
        if self.due("missed deadlines"):
            end = time.monotonic() + 1.3 * self.period
            while time.monotonic() < end:
                pass
        t = 20 * time.monotonic()  # the arm must move, so that frozen readings are seen
        return 4.0 * np.array([np.sin(t), np.cos(t)])


class Eye(Ekf, Part):
    def step(self, t, *words, **more):
        if self.due("observer"):
            raise ValueError("dark")
        found = super().step(t, *words, **more)
        note("seen", float(t), float(found.nis), int(found.used))
        return found
"""
# what stops the run, as the command says it
SIGNALS = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM", "SIGHUP": "SIGHUP"}
READINGS = {
    "lose": "stale reading", "repeat": "stale reading", "delay": "stale reading",
    "freeze": "lost estimate",
}  # fmt: skip
OWN_FAULTS = {
    "controller": "controller", "observer": "observer", "driver": "driver",
    "limit": "reading outside its limits", "tension": "tension beyond its bound",
    "not finite": "command", "missed deadlines": "missed deadlines",
    "blocked read": "the watchdog: no heartbeat",
}  # fmt: skip
KILLS = {
    "kill loop": "the watchdog: the loop's process ended",
    "freeze loop": "the watchdog: no heartbeat", "kill watchdog": "watchdog: the watchdog",
    "kill rig": "driver", "kill command": "SIGHUP: the process of softdyn drive has ended",
}  # fmt: skip
END, FALLING = "planned end", "SIGINT while the commands fall"
CAUSES = {END: "", FALLING: "Ctrl-C", **SIGNALS, **READINGS, **OWN_FAULTS, **KILLS}
CODES = {FALLING: 130, "SIGINT": 130, "kill command": -9}  # others: 1; the verdict's at the end
STALE, LOST, RAMP = 0.1, 0.2, 0.5  # s, the limits of `softdyn drive`
SURE = 1 - 1e-6


@dataclass(frozen=True)
class Outcome:
    """The end of a run.

    Attributes
    ----------
    code : int
        Exit code of the command's process.
    err : str
        Its stderr.
    called : float
        Time (s) from the moment at which the fault can be known to the call of the driver's
        `stop`: a reading is stale at `--stale`, an estimate is lost once its innovations are
        beyond the quantile, a deadline is missed when it passes. A killed watchdog or rig is known
        once its process has ended, some 20 ms after the signal: its pipes are open until then.
    relaxed : float or None
        The same to the relaxed rig; None if the rig itself was killed.
    log : Log
        The run's log.
    unlogged : float
        Time (s) from the last beginning of a period in the log to that moment.
    """

    code: int
    err: str
    called: float
    relaxed: float | None
    log: Log
    unlogged: float


class StoppedBefore(Exception):
    """Something else has stopped the run before its fault."""


def softdyn(*words: str, env: Mapping[str, str], **more) -> subprocess.Popen:
    """Start a command."""
    program = [sys.executable, "-m", "softdyn.commands", *words]
    return subprocess.Popen(program, text=True, env=os.environ | env, **more)


def fault(
    folder: Path, kind: str, *options: str, after: float = 0.0,
    start: Callable[..., subprocess.Popen] = softdyn,
) -> Outcome:  # fmt: skip
    """Drive the small arm, and let one thing fail `after` seconds after the first command.

    The processes are new ones, or forks of this one if `start` is `forked`.
    """
    (folder / "arm.urdf").write_text(BENCH)
    (folder / "own.py").write_text(OWN)
    port = str(free_port())
    more = {"cwd": folder, "stderr": subprocess.PIPE}
    rig = start(
        "drive", "arm.urdf", "--serve", "--port", port, env={}, stdout=subprocess.PIPE, **more
    )
    assert re.search(rf":{port}\b", rig.stdout.readline())
    duration = str(after) if kind in (END, FALLING) else "1000"
    loop = start(
        "drive", "arm.urdf", "own.py:Push", "--driver", "own.py:Rig", "--observer", "own.py:Eye",
        "--target", "0.3", "0", "-0.1", "--duration", duration, "--log", "run.npz",
        "--no-verdict", *options, stdout=subprocess.DEVNULL, **more,
        env={"SERVED_RIG": port, "FAULT": kind, "FAULT_AFTER": str(after)},
    )  # fmt: skip
    try:
        return _end(rig, loop, kind, int(port), folder, after)
    finally:
        for one in (loop, rig):
            one.kill()
            one.communicate()


def free_port() -> int:
    """A port that nobody has at the moment."""
    import socket

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def _end(rig, loop, kind, port, folder, after) -> Outcome:
    served_rig.PORT = port
    witness = served_rig.ServedRig(bench_arm())
    witness.start()
    begun = wait(lambda: loop.poll() is not None or ask(witness)["sent_at"])
    if kind not in OWN_FAULTS:
        falls = RAMP / 2 if kind == FALLING else 0.0
        time.sleep(max(begun + after + falls - time.monotonic(), 0.0))
    if loop.poll() is not None and kind not in (END, *OWN_FAULTS):
        raise StoppedBefore(loop.stderr.read())
    began = time.monotonic()
    if kind in SIGNALS or kind == FALLING:
        loop.send_signal(getattr(signal, kind.split()[0]))
    elif kind in READINGS:
        some = {"sensors": ["shoulder", "elbow"]} if kind == "freeze" else {"seconds": 5.0}
        witness.say({"fault": kind, **some})
    elif kind in KILLS:
        began = _kill(kind, rig, loop)
    relaxed = None if kind == "kill rig" else wait(lambda: ask(witness)["relaxed_at"])
    _, err = loop.communicate(timeout=PATIENCE)
    wait((folder / "run.npz").exists)  # a killed command does not wait for it
    notes = [_Note.of(line) for line in (folder / "notes.txt").read_text().splitlines()]
    log = Log.load(folder / "run.npz")
    if kind in OWN_FAULTS and all(note.what != "fault" for note in notes):
        raise StoppedBefore(err)
    known = _known(kind, began, notes, log)
    called = next(note.at for note in notes if note.what == "stop")
    times = (called - known, None if relaxed is None else relaxed - known)
    return Outcome(loop.returncode, err, *times, log, known - float(np.nanmax(log.clock)))


@dataclass(frozen=True)
class _Note:
    """The notes of the user's own objects: the time (s) on the monotonic clock, a word, numbers."""

    at: float
    what: str
    more: tuple[float, ...]

    @classmethod
    def of(cls, line: str) -> _Note:
        at, what, *more = line.split()
        return cls(float(at), what, tuple(map(float, more)))


def _kill(kind, rig, loop) -> float:
    """Kill a process, or let it stand still; the time (s) at which others can know."""
    (inner,) = _children(loop.pid)
    victim = {
        "kill rig": lambda: rig.pid, "kill command": lambda: loop.pid,
        "kill watchdog": lambda: next(iter(_children(inner))),
    }.get(kind, lambda: inner)()  # fmt: skip
    began = time.monotonic()
    os.kill(victim, signal.SIGSTOP if kind == "freeze loop" else signal.SIGKILL)
    if kind in ("kill rig", "kill watchdog"):
        while _runs(victim):
            time.sleep(2e-4)
            began = time.monotonic()
    return began


def _runs(pid: int) -> bool:
    """Whether a process has not ended yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def _children(pid: int) -> list[int]:
    """The processes that a process has started, first ones first."""
    return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _known(kind: str, began: float, notes: list[_Note], log: Log) -> float:
    """The time (s) at which the loop can know of the fault."""
    stop = next(note for note in notes if note.what == "stop")
    if kind == END:
        return max(note.at for note in notes if note.what == "send")
    if READINGS.get(kind) == "stale reading":
        return stop.more[0] + STALE
    if kind == "freeze":
        seen = [note for note in notes if note.what == "seen" and note.more[0] >= RAMP]
        size = round(LOST / log.period)
        for k in range(size, len(seen) + 1):
            nis, used = (sum(note.more[n] for note in seen[k - size : k]) for n in (1, 2))
            if nis > chi2.ppf(SURE, used):
                return seen[k - 1].at
    if kind == "missed deadlines":  # the last one that passed before the loop could act
        first = log.clock[0]
        return first + log.period * np.floor((stop.at - first) / log.period)
    return next((note.at for note in notes if note.what == "fault"), began)


def wait(what):
    """The value of a function once it is true."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if found := what():
            return found
        time.sleep(0.005)
    raise TimeoutError


def ask(witness):
    """The state of the rig."""
    witness.say({"ask": "state"})
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        for line in witness.lines():
            if "state" in line:
                return line["state"]
        time.sleep(0.001)
    raise TimeoutError
