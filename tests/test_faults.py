"""Faults of the machine: nothing is lost or half-written, and the error states the reason.

Tested elsewhere: killed workers and interrupted grids (test_benchmark.py, test_sweep.py),
interrupted writes and two writers of one file (test_files.py), kernels without a writable cache
(test_compiled.py). docs/robustness.md lists them all.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from softdyn.commands import rollout, run
from softdyn.validation import Log
from softdyn.validation.files import atomic, write_json, write_text
from tests.support import PATIENCE, ROOT
from tests.support.command import command, of_itself
from tests.support.forked import forked
from tests.support.refused import refused
from tests.support.sweeps import wait_for

RUN = ["scripts/run.py", "finger", "ic", "--theta", "0.5", "--duration", "0.5"]
NOWHERE = "/proc/nowhere"  # a place where not even root can create a folder


def start(arguments: list[str], **options) -> subprocess.Popen:
    """Start a command in a new process."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **options.pop("env", {})}
    return subprocess.Popen(
        [sys.executable, str(ROOT / arguments[0]), *arguments[1:]], env=environment, text=True,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
    )  # fmt: skip


def finish(process: subprocess.Popen) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, err


@contextmanager
def small_files(size: int = 4096) -> Iterator[None]:
    """Limit files to `size` bytes; as on a full disk, small writes succeed and later ones fail."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


# -- a full disk ---------------------------------------------------------------------------------


def test_a_full_disk_loses_no_figures_and_leaves_nothing_half_written(
    tmp_path: Path, capsys
) -> None:
    old = tmp_path / "run.npz"
    old.write_bytes(b"before")
    command = [*RUN[1:], "--log", str(old), "--json", str(tmp_path / "run.json")]
    assert run.main(RUN[1:]) in (0, 1)  # kernels may have to be compiled, and cached
    capsys.readouterr()
    with small_files():  # everywhere
        assert run.main(command) == 1
    out, err = capsys.readouterr()
    assert "final error" in out
    assert "wrote" not in out
    assert [line.split(": expected")[0] for line in err.splitlines()] == [
        f"error: {tmp_path / name}" for name in ("run.npz", "run.json")
    ]
    assert old.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [old]


LEAVING = """
import os, numpy
class Leaving:
    def __init__(self, model):
        self.u, self.left = numpy.array(model.relaxed), False
    def __call__(self, state, reference):
        if not self.left:
            os.rmdir("out")
            self.left = True
        return type("Answer", (), {"u": self.u})()
"""


@pytest.mark.parametrize(
    ("option", "file"), [("--log", "a.npz"), ("--log", "a.csv"), ("--html", "a.html"),
                         ("--json", "a.json")]
)  # fmt: skip
def test_a_run_whose_folder_is_gone_is_written_elsewhere(
    option: str, file: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    kept = tmp_path / "kept"
    for folder in ("out", "kept"):
        Path(folder).mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(kept))
    Path("leaving.py").write_text(LEAVING)
    words = ["run", "finger", "leaving.py:Leaving", "--theta", "0.5", "--duration", "0.01"]
    code, out, err = command(*words, "--no-verdict", option, f"out/{file}")
    (written,) = kept.glob(f"*-{file}")
    assert code == 1
    assert f"wrote {written}" in out
    assert f"error: out/{file}" in err


def test_a_rollout_that_has_no_room_is_said(tmp_path: Path, capsys) -> None:
    words = ["finger", "--seconds", "0.01"]
    assert rollout.main(words) == 0
    capsys.readouterr()
    with small_files(100):
        assert rollout.main([*words, "--log", str(tmp_path / "a.npz")]) == 1
    out, err = capsys.readouterr()
    assert "of computing" in out
    assert err.startswith(f"error: {tmp_path / 'a.npz'}: expected a writable file")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a Linux device")
def test_a_full_disk_behind_stdout_is_no_success(monkeypatch, capsys) -> None:
    with open("/dev/full", "w") as full, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", full)
        assert run.main([*RUN[1:], "--json", "-"]) == 1
    assert capsys.readouterr().err == (
        "error: stdout: expected a stream to write to, got No space left on device\n"
    )


@pytest.mark.parametrize("kept", [0, 1, 4095, 4096])
def test_every_length_at_which_a_write_may_stop(kept: int, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"before")
    with small_files(kept), refused("file", "File too large"):
        write_text(path, "x" * 4097)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_that_fills_at_the_last_moment(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "file.json"
    write_json(path, {"a": 1})

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for call in ("fsync", "replace"):  # delayed allocation reports the error later than write()
        with monkeypatch.context() as patch:
            patch.setattr(os, call, full)
            with refused("file.json", "No space left on device"):
                write_json(path, {"a": 2})
    assert json.loads(path.read_text()) == {"a": 1}
    assert list(tmp_path.iterdir()) == [path]


# -- killed in the middle ------------------------------------------------------------------------


def test_killed_while_writing(tmp_path: Path) -> None:
    """After SIGKILL between two writes, the old file is complete, and a later run succeeds."""
    path = tmp_path / "file"
    path.write_bytes(b"before")
    code = (
        "import signal\nfrom softdyn.validation.files import atomic\n"
        f"with atomic({str(path)!r}) as file:\n"
        "    file.write(b'half')\n    file.flush()\n    print('now', flush=True)\n"
        "    signal.pause()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "now\n"
    process.kill()
    process.communicate()
    assert path.read_bytes() == b"before"
    with atomic(path) as file:
        file.write(b"after")
    assert path.read_bytes() == b"after"


SLOW = """
from pathlib import Path
from time import sleep
import numpy as np
from softdyn.controllers import Command

class Slow:
    def __init__(self, model):
        self.u, self.calls = np.zeros(model.nu), 0

    def __call__(self, state, reference):
        self.calls += 1
        while self.calls == 3:  # until it is interrupted
            Path(__file__).with_name("began").touch()
            sleep(0.01)
        return Command(self.u)
"""


def test_a_run_that_is_interrupted_keeps_what_it_has(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    target = tmp_path / "run.npz"
    words = ("run", "finger", f"{tmp_path}/slow.py:Slow", "--theta", "0.5", "--log", target)
    process = forked(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait_for((tmp_path / "began").exists)
    process.send_signal(signal.SIGINT)
    code, out, err = finish(process)
    assert (code, out) == (130, "")
    assert of_itself(err).endswith("error: interrupted\n")
    left = {path.name for path in tmp_path.iterdir() if path.name != "__pycache__"}
    assert left <= {"began", "slow.py", "run.npz"}
    if "run.npz" in left:  # unless it was interrupted in its first step
        assert of_itself(err).startswith(f"wrote {target}: the run up to t = ")
        assert Log.load(target).reason.endswith("s: interrupted")


def test_two_runs_into_one_file(tmp_path: Path) -> None:
    """The file of the last run remains, complete."""
    path = tmp_path / "run.npz"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    processes = [forked("run", *RUN[1:], "--log", path, **pipes) for _ in range(2)]
    for process in processes:
        code, _, err = finish(process)
        assert (code in (0, 1), of_itself(err)) == (True, "")
    assert Log.load(path).steps == 100
    assert list(tmp_path.iterdir()) == [path]


# -- an unfriendly environment -------------------------------------------------------------------


def test_no_home_and_no_display(tmp_path: Path) -> None:
    """The home folder is read-only, and a plot library should use a display that does not exist."""
    bare = dict.fromkeys(("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "MPLCONFIGDIR"), "")
    homeless = {"HOME": NOWHERE, "XDG_CACHE_HOME": NOWHERE, "XDG_CONFIG_HOME": NOWHERE}
    folder = tmp_path / "out"
    grid = ["scripts/benchmark.py", "--robots", "finger", "--controllers", "ic", "--thetas", "0.5",
            "--omegas", "--jobs", "1", "--out", str(folder)]  # fmt: skip
    code, _, err = finish(start(grid, env={**bare, **homeless, "MPLBACKEND": "TkAgg"}))
    assert code == 0, err
    assert "Traceback" not in err
    assert list((folder / "figures").iterdir())


@pytest.fixture(scope="module")
def comma(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment whose locale writes 0,5."""
    folder = tmp_path_factory.mktemp("locales")
    tool = shutil.which("localedef")
    target = str(folder / "de_DE.UTF-8")
    if tool is None or subprocess.run(
        [tool, "-i", "de_DE", "-f", "UTF-8", target], capture_output=True, check=False
    ).returncode not in (0, 1):
        pytest.skip("no locale with decimal commas can be made here")
    return {"LOCPATH": str(folder), "LC_ALL": "de_DE.UTF-8"}


COMMA = """
import locale, sys
import numpy as np, softdyn
from softdyn.validation import Twin
from softdyn.validation.files import to_json
def numbers():
    model = softdyn.load("spirob")
    state = model.state(np.full(model.nv, 0.1), np.full(model.nv, 0.2))
    twin = Twin(model)
    masses = twin.model.body_mass, twin.model.dof_damping, twin.model.jnt_stiffness
    return [state.M, state.h, state.B, state.J, *masses]
before = numbers()
locale.setlocale(locale.LC_ALL, "")
assert locale.localeconv()["decimal_point"] == ",", locale.localeconv()
assert f"{0.5:n}" == "0,5"
for a, b in zip(before, numbers(), strict=True):
    np.testing.assert_array_equal(a, b)
print(to_json({"half": 0.5}))
"""


def test_a_locale_with_decimal_commas(comma: dict[str, str]) -> None:
    """Libraries that read numbers by the locale would read 0.274 kg as 0 kg."""
    done = subprocess.run(
        [sys.executable, "-c", COMMA], cwd=ROOT, env={**os.environ, **comma},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"half": 0.5}
