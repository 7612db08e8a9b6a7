"""The ends of `softdyn drive` as processes of its own: none loses a signal, the log or a word.

The driver does what a test asks for at a place that the test names, so that no test needs a fast
machine.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from softdyn.validation import Log
from tests.support import PATIENCE
from tests.support.forked import forked
from tests.support.robots import BENCH

OWN = """
import os, signal, sys, threading, time
import numpy as np

NOTES = os.open("notes.txt", os.O_WRONLY | os.O_APPEND | os.O_CREAT)


def do(place):
    os.write(NOTES, f"{place} ".encode())
    exec(os.environ.get(place, ""), globals())


def tell(*numbers):
    for number in numbers:
        os.kill(os.getpid(), number)


def tell_on(*numbers):
    "Again and again, also while the log is written."

    def work():
        while True:
            tell(*numbers)
            time.sleep(1e-3)

    threading.Thread(target=work, daemon=True).start()


def watchdog():
    "The only child of the loop's process; the driver is in one or the other."
    text = open(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read()
    return int(text.split()[0])


class Rig:
    def __init__(self, model):
        self.size, self.reads = sum(sensor.kind.size for sensor in model.robot.sensors), 0

    def start(self):
        do("start")

    def read(self):
        self.reads += 1
        if self.reads == 6:
            do("read")
        values = np.full(6, np.nan) if "blind" in os.environ else np.array([0, 0, 0, 0.4, 0, 0])
        return values, np.full(self.size, time.monotonic())

    def send(self, commands):
        do("send")

    def stop(self):
        do("stop")


do("load")
"""
SLOW = ("--period", "0.2", "--missed", "1000", "--stale", "60", "--lost", "1000", "--ramp", "0")


@dataclass(frozen=True)
class End:
    """The end of a command.

    Attributes
    ----------
    code : int
        Its exit code.
    err : str
        Its stderr.
    calls : list of str
        What was called of the driver, the watchdog's too.
    folder : Path
        Its folder.
    """

    code: int
    err: str
    calls: list[str]
    folder: Path

    @property
    def log(self) -> Log:
        """The log, wherever it is."""
        (path,) = self.folder.rglob("*run.npz")
        return Log.load(path)


def drive(folder: Path, *more: str, duration: float = 1.0, closed=(), **places: str) -> End:
    """Hold the arm for some periods of 0.2 s, with code of the driver by the place's name."""
    (folder / "arm.urdf").write_text(BENCH)
    (folder / "own.py").write_text(OWN)
    for name in ("out", "spare"):
        (folder / name).mkdir()

    words = ["drive", "arm.urdf", "--driver", "own.py:Rig", "--hold", "0", "0", *SLOW,
             "--duration", str(duration), "--log", "out/run.npz", *more]  # fmt: skip
    pipes = {"cwd": folder, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    places |= {"TMPDIR": str(folder / "spare")}
    if closed:  # by the interpreter that starts
        process = subprocess.Popen(
            [sys.executable, "-m", "softdyn.commands", *words], text=True, env=os.environ | places,
            preexec_fn=lambda: [os.close(number) for number in closed] and None, **pipes,
        )  # fmt: skip
    else:
        process = forked(*words, env=places, **pipes)
    _, err = process.communicate(timeout=PATIENCE)
    notes = folder / "notes.txt"
    calls = notes.read_text().split() if notes.exists() else []
    return End(process.returncode, err, calls, folder)


# -- signals before the run ------------------------------------------------------------------------

SWALLOWED = "try:\n    tell({})\n    time.sleep(0.01)\nexcept BaseException:\n    pass"


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 1), ("SIGHUP", 1)])
def test_a_signal_that_the_loaded_code_swallows_ends_the_command(tmp_path, name, code):
    found = drive(tmp_path, load=SWALLOWED.format(f"signal.{name}"))
    assert found.code == code
    assert found.calls == ["load"]
    assert len(found.err.splitlines()) == 1
    assert "Traceback" not in found.err


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 1)])
def test_a_signal_that_start_swallows_stops_before_the_first_command(tmp_path, name, code):
    found = drive(tmp_path, start=SWALLOWED.format(f"signal.{name}"))
    assert found.code == code
    assert found.calls == ["load", "start", "stop"]
    said = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM"}[name]
    assert found.err.splitlines() == [f"stopped by {said}, before the first reading: {said}"]


# -- ends before the first reading -----------------------------------------------------------------


def test_a_start_that_fails_is_one_line_and_no_log(tmp_path):
    found = drive(tmp_path, start="raise OSError('no \\x1b[31madapter')")
    assert found.code == 1
    assert "\x1b" not in found.err  # neither in the line nor in the traceback above it
    last = found.err.splitlines()[-1]
    assert last == (
        r"stopped by driver, before the first reading: start(): OSError: no \x1b[31madapter"
    )
    assert found.calls == ["load", "start", "stop"]
    assert list((tmp_path / "out").iterdir()) == []


def test_no_run_begins_while_a_sensor_never_sends(tmp_path):
    found = drive(tmp_path, blind="1")
    assert found.code == 1
    assert found.calls == ["load", "start", "read", "stop"]
    (line,) = found.err.splitlines()
    assert line.startswith("stopped by stale reading, before the first reading: ")
    assert "shoulder never came" in line


# -- ends that keep the log ------------------------------------------------------------------------

STORM = "tell_on(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)"


def test_more_signals_lose_no_log(tmp_path):
    found = drive(tmp_path, duration=100.0, read="tell(signal.SIGINT)", stop=STORM)
    assert found.code == 130
    assert found.log.steps >= 1
    assert found.err.splitlines()[-1] == "stopped by Ctrl-C: Ctrl-C"


def test_a_log_without_room_is_written_elsewhere(tmp_path):
    found = drive(tmp_path, stop="os.path.isdir('out') and os.rmdir('out')")
    assert found.code == 1
    assert found.log.complete
    assert f"wrote {tmp_path}/spare/" in found.err.splitlines()[-1]
    assert "out/run.npz" in found.err


def test_the_watchdog_s_log_without_room_is_written_elsewhere(tmp_path):
    found = drive(tmp_path, read="os.rmdir('out'); tell(signal.SIGKILL)")
    assert found.code == 1
    assert found.log.steps >= 1
    assert f"wrote {tmp_path}/spare/" in found.err
    assert "out/run.npz" in found.err


def test_a_loop_that_exits_by_itself_is_a_failure(tmp_path):
    found = drive(tmp_path, read="os._exit(0)")
    assert found.code == 1
    assert found.calls[-2:] == ["start", "stop"]  # the watchdog's
    assert "without a result" in found.err


def test_a_loop_that_is_killed_before_it_opens_the_rig_leaves_the_rig_alone(tmp_path):
    found = drive(tmp_path, load="tell(signal.SIGKILL)")
    assert (found.code, found.calls) == (1, ["load"])


# -- slow ends -------------------------------------------------------------------------------------


def test_a_slow_stop_ends_the_run_as_planned(tmp_path):
    """It takes longer than a missing heartbeat."""
    found = drive(tmp_path, stop="time.sleep(1.0)")
    assert (found.code, found.err) == (0, "")
    assert found.log.complete
    assert found.calls.count("stop") == 1


def test_a_stop_that_does_not_return_is_interrupted_and_said(tmp_path):
    found = drive(tmp_path, stop="time.sleep(1000)")
    assert found.code == 1
    assert found.log.steps == 5
    assert "stop(): it has not returned for 2 s; relax the rig by hand" in found.err
    assert found.calls.count("stop") == 2


NEVER = "while True:\n    try:\n        time.sleep(1000)\n    except BaseException:\n        pass"


def test_a_stop_that_cannot_be_interrupted_is_ended_by_the_watchdog(tmp_path):
    """Its own driver relaxes the rig, and its log has all rows."""
    loop = f"if os.getpid() == LOOP:\n    {NEVER.replace(chr(10), chr(10) + '    ')}"
    found = drive(tmp_path, load="LOOP = os.getpid()", stop=loop)
    assert found.code == 1
    assert "stopped by the watchdog: stop() has not returned for 5000 ms" in found.err
    assert found.log.steps == 5
    assert found.calls[-2:] == ["start", "stop"]


def test_a_watchdog_that_stands_still_does_not_keep_the_command(tmp_path):
    found = drive(tmp_path, stop="os.kill(watchdog(), signal.SIGSTOP)")
    assert found.code == 0
    assert found.log.complete
    assert "the watchdog's process does not end" in found.err


# -- closed streams --------------------------------------------------------------------------------


@pytest.mark.parametrize(("closed", "code"), [((0,), 0), ((0, 1), 1), ((0, 1, 2), 1)])
def test_closed_streams_give_no_traceback(tmp_path, closed, code):
    found = drive(tmp_path, closed=closed)
    assert found.code == code
    assert "Traceback" not in found.err
    assert found.log.complete
