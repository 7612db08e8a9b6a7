"""Real processes: a served rig and a loop that drives it, until a fault of some kind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from softdyn.examples import served_rig
from tests.support.benched import ARM, benched

LAW = (
    "import numpy as np\n"
    "class Push:\n"
    "    def __init__(self, model):\n        pass\n"
    "    def __call__(self, state, reference):\n        return np.array([3.0, 2.0])\n"
)
SIGNALS = {"SIGINT": 130, "SIGTERM": 1, "SIGHUP": 1}
READINGS = ("lose", "repeat", "delay")
KINDS = (*SIGNALS, *READINGS, "kill loop", "freeze loop", "kill watchdog", "kill rig")
PATIENCE = 120.0  # s, in which every process must have answered


@dataclass(frozen=True)
class Outcome:
    """The end of a run.

    Attributes
    ----------
    code : int
        Exit code of the loop's process.
    err : str
        Its stderr.
    reaction : float or None
        Time (s) from the fault to the relaxed rig; None if the rig itself was killed.
    log : Path
        The run's log.
    """

    code: int
    err: str
    reaction: float | None
    log: Path


def softdyn(*words: str, **more) -> subprocess.Popen:
    """Start a command."""
    program = [sys.executable, "-m", "softdyn.commands", *words]
    return subprocess.Popen(program, text=True, stderr=subprocess.PIPE, **more)


def fault(folder: Path, kind: str, *options: str, after: float = 0.0) -> Outcome:
    """Drive the small arm, and let one thing fail `after` seconds after the first command."""
    (folder / "arm.urdf").write_text(ARM)
    (folder / "law.py").write_text(LAW)
    port = str(free_port())
    rig = softdyn(
        "drive", "arm.urdf", "--serve", "--port", port, stdout=subprocess.PIPE, cwd=folder
    )
    assert re.search(rf":{port}\b", rig.stdout.readline())
    log = folder / "run.npz"
    loop = softdyn(
        "drive", "arm.urdf", "law.py:Push", "--driver", f"{served_rig.__file__}:ServedRig",
        "--target", "0.3", "0", "-0.1", "--duration", "1000", "--log", str(log), *options,
        cwd=folder, stdout=subprocess.DEVNULL, env=os.environ | {"SERVED_RIG": port},
    )  # fmt: skip
    try:
        return _end(rig, loop, kind, int(port), log, after)
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


def _end(rig, loop, kind, port, log, after) -> Outcome:
    served_rig.PORT = port
    witness = served_rig.ServedRig(benched())
    witness.start()
    wait(lambda: loop.poll() is not None or ask(witness)["sent_at"])
    assert loop.poll() is None, loop.communicate()[1]
    time.sleep(after)
    began = time.monotonic()
    if kind in SIGNALS:
        loop.send_signal(getattr(signal, kind))
    elif kind in READINGS:
        witness.say({"fault": kind, "seconds": 5.0})
    elif kind == "kill watchdog":
        (watchdog,) = Path(f"/proc/{loop.pid}/task/{loop.pid}/children").read_text().split()
        os.kill(int(watchdog), signal.SIGKILL)
    else:
        victim = rig if kind == "kill rig" else loop
        victim.send_signal(signal.SIGSTOP if kind == "freeze loop" else signal.SIGKILL)
    reaction = None
    if kind != "kill rig":
        relaxed = wait(lambda: ask(witness)["relaxed_at"])
        reaction = relaxed - began
    _, err = loop.communicate(timeout=PATIENCE)
    return Outcome(loop.returncode, err, reaction, log)


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
