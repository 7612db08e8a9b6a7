"""One name for all commands."""

import re
import subprocess
import sys
import tomllib

import pytest

from softdyn.commands import __main__ as softdyn_command
from softdyn.commands.__main__ import COMMANDS, main
from tests.support import ROOT, SCRIPTS

NAMES = [name for names in COMMANDS.values() for name in names]
HELPERS = {"__init__", "__main__", "cli"}


def test_every_script_is_a_command_and_listed(capsys):
    assert {path.stem for path in SCRIPTS.glob("*.py")} - HELPERS == set(NAMES)
    assert main([]) == 0
    listed = capsys.readouterr().out
    assert re.findall(r"(?m)^  (\S+) ", listed) == [name.replace("_", "-") for name in NAMES]
    assert max(map(len, listed.splitlines())) <= 120


def test_version(capsys):
    import softdyn

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"softdyn {softdyn.__version__}\n"


@pytest.mark.parametrize("name", NAMES)
def test_help_names_the_command(name, capsys):
    spelt = name.replace("_", "-")
    with pytest.raises(SystemExit) as stop:
        main([spelt, "--help"])
    assert stop.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: softdyn {spelt} ")


@pytest.mark.parametrize(
    ("name", "message"),
    [("crosschek", "expected crosscheck?"), ("", "`softdyn` lists them"), ("os", "got os")],
)
def test_a_wrong_name_is_one_line(name, message, capsys):
    assert main([name]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: command: ")
    assert message in err


def test_one_program_three_ways(tmp_path):
    entry = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["softdyn"]
    assert entry == f"{softdyn_command.__name__}:main"
    outputs = []
    for words in (["-m", "softdyn.commands", "crosscheck"], [SCRIPTS / "crosscheck.py"],
                  ["-m", "softdyn.commands.crosscheck"]):  # fmt: skip
        command = [sys.executable, *words, "finger", "--samples", "1", "--json", "-"]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        outputs.append(done.stdout)
    assert outputs[0] == outputs[1] == outputs[2]
