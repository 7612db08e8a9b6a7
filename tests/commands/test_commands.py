"""One name for all commands."""

import os
import re
import subprocess
import sys
import tomllib
from contextlib import suppress

import pytest

from softdyn.commands import __main__ as softdyn_command
from softdyn.commands.__main__ import NAMES, main
from tests.support import ROOT, SCRIPTS

HELPERS = {"__init__", "__main__", "cli", "study_options"}


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
    for typed in {name, spelt}:  # step_time is step-time
        with pytest.raises(SystemExit) as stop:
            main([typed, "--help"])
        assert stop.value.code == 0
        assert capsys.readouterr().out.startswith(f"usage: softdyn {spelt} ")


@pytest.mark.parametrize(
    ("line", "expected"),
    [("softdyn cross", ["crosscheck "]), ("softdyn run finger --the", ["--theta "])],
)
def test_the_shell_completes(line, expected, tmp_path):
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)),
             "_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "answer")}  # fmt: skip
    command = [sys.executable, "-m", "softdyn.commands"]
    done = subprocess.run(command, env={**os.environ, **asked}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "answer").read_text().split("\v") == expected


def test_examples_are_copied_whole_or_not_at_all(tmp_path, capsys):
    folder = tmp_path / "new" / "examples"
    assert main(["new", "--examples", str(folder)]) == 0
    theirs = ROOT / "docs" / "examples"
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        path.name: path.read_bytes() for path in theirs.iterdir() if path.is_file()
    }
    (folder / "tour.py").write_text("mine")
    for path in folder.glob("soft*"):
        path.unlink()
    capsys.readouterr()
    assert main(["new", "--examples", str(folder)]) == 2
    assert "tour.py" not in capsys.readouterr().out
    assert (folder / "tour.py").read_text() == "mine"
    assert not list(folder.glob("soft*"))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("new", "FILE: expected a TOML file, or --examples DIR, got neither"),
        ("new a.toml --examples DIR", "FILE: expected a TOML file, or --examples DIR, got both"),
        ("new a.toml --segments 2 4", "expected --converge to go with them"),
        ("new a.toml --converge --out b.urdf", "--out: expected none: --converge writes no file"),
        ("new --examples DIR --converge", "--converge: expected a FILE to go with it"),
        ("new --examples DIR --out b.urdf", "--out: expected a FILE to go with it"),
    ],
)
def test_jobs_of_new_exclude_each_other(line, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("run finger ic --theta 0.5 --gians x", "got '--gians'; did you mean '--gains'?"),
        ("identify --fere x", "got '--fere'; did you mean '--free'?"),  # before what is missing
        ("run finger ic -theta 0.5", "got '-theta'; did you mean '--theta'?"),
        ("view finger --colour=red", "got '--colour'"),
    ],
)
def test_a_misspelt_option_is_named_with_the_nearest(line, said, capsys):
    with pytest.raises(SystemExit) as stop:
        main(line.split())
    assert stop.value.code == 2
    expected = f"error: option: expected one of those that --help lists, {said}\n"
    assert capsys.readouterr() == ("", expected)


def test_what_begins_with_a_dash_is_not_always_an_option(capsys):
    for line in ("statics finger --target -20 -1e-3 -inf", "check finger --sampl 0"):
        with suppress(SystemExit):
            assert main(line.split()) == 2
        assert "option:" not in capsys.readouterr().err


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
    for words in (["-m", "softdyn.commands", "new"], [SCRIPTS / "new.py"],
                  ["-m", "softdyn.commands.new"]):  # fmt: skip
        folder = tmp_path / str(len(outputs))
        folder.mkdir()
        command = [sys.executable, *words, "--examples", "here"]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        assert done.returncode == 0, done.stderr
        outputs.append((done.stdout, {path.name for path in folder.rglob("*")}))
    assert outputs[0] == outputs[1] == outputs[2]
    assert "tour.py" in outputs[0][1]


@pytest.mark.parametrize("name", ["statics", "play"])
def test_a_target_far_out_of_reach_is_refused(name, capsys):
    assert main([name, "finger", "--target", "20", "0", "0"]) == 2
    said = "within the robot's reach of 0.24 m, got one 20 m from the base: in cm?"
    assert said in capsys.readouterr().err
