"""Commands in strange environments: closed streams, small alphabets, hostile TOML."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress

import pytest

from softdyn.commands import cli
from softdyn.view.page import Page
from tests.support import SCRIPTS
from tests.support.command import command, of_itself

RUN = [sys.executable, str(SCRIPTS / "run.py"), "finger", "ic", "--theta", "0.5",
       "--duration", "0.05"]  # fmt: skip
NEW = [sys.executable, str(SCRIPTS / "new.py")]  # which needs no engine


def shell(words, redirection, **environment):
    line = " ".join(f"'{word}'" for word in words) + redirection
    return subprocess.run(
        line, shell=True, capture_output=True, env={**os.environ, **environment},
        encoding=environment.get("PYTHONIOENCODING", "utf-8"),
    )  # fmt: skip


def test_closed_streams(tmp_path):
    log = tmp_path / "x.npz"
    done = shell([*RUN, "--json", "-", "--log", str(log)], " 2>&-")
    assert done.returncode in (0, 1)
    assert json.loads(done.stdout)["steps"] == 10
    assert log.exists()
    wrong = shell([*NEW, "--json", "-"], " 2>&-")
    assert (wrong.returncode, wrong.stdout) == (2, "")  # no error where JSON is expected
    silent = shell(RUN, " >&-")  # the run is over, and nobody hears of it
    assert silent.returncode == 1
    assert of_itself(silent.stderr) == (
        "error: stdout: expected a stream to write to, got a closed one\n"
    )
    assert shell([*NEW, "--examples", str(tmp_path / "new")], " >&- 2>&- <&-").returncode in (1, 2)


def test_a_small_alphabet():
    done = shell([sys.executable, str(SCRIPTS / "benchmark.py"), "--help"], "",
                 PYTHONIOENCODING="ascii")  # fmt: skip
    assert done.returncode == 0
    done = shell(RUN, "", PYTHONIOENCODING="ascii")
    assert done.returncode in (0, 1)
    assert "Traceback" not in done.stderr
    wrong = shell([*NEW, "ℓ.toml"], "", PYTHONIOENCODING="ascii")
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("error: \\u2113.toml: ")


@pytest.mark.parametrize(
    "value", ["1" * 5000, "[" * 5000 + "]" * 5000, "0x" + "f" * 10_000, "'\xff"]
)
def test_hostile_toml(tmp_path, value):
    for name, key, words in (("gains", "Kp", [*RUN[2:], "--gains"]), ("sweep", "robots", [])):
        path = tmp_path / f"{name}.toml"
        path.write_bytes(f"{key} = {value}\n".encode("latin-1"))
        done = command("run" if words else "sweep", *words, path)
        assert done.code == 2
        assert done.err.count("\n") == 1
        assert name in done.err


def test_a_large_toml(tmp_path):
    (tmp_path / "gains.toml").write_text("#" * 1_000_001)
    done = command("run", *RUN[2:], "--gains", tmp_path / "gains.toml")
    assert done.code == 2
    assert "at most 1000000 bytes" in done.err


def test_what_swallows_an_end_does_not_keep_a_command_alive():
    """A compiler's callback swallows exceptions, for example."""
    reached = []
    with cli.ends_cleanly() as over:
        assert not over()
        with suppress(BaseException):
            signal.raise_signal(signal.SIGTERM)
        reached.append(over())
        cli.serve(Page("", (), ()), cli.Arguments(port=None, no_open=True, origin=None), over)
        reached.append("the end")
    assert reached == [True, "the end"]
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
