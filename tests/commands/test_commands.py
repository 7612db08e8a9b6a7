"""One name for all commands."""

import importlib
import itertools
import os
import re
import subprocess
import sys
import tomllib
from contextlib import suppress
from pathlib import Path

import pytest

from softdyn.commands import __main__ as softdyn_command
from softdyn.commands import cli
from softdyn.commands.__main__ import NAMES, main
from tests.support import ROOT, SCRIPTS, robots
from tests.support.command import command

HELPERS = {"__init__", "__main__", "cli", "study_options", "working"}


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


def test_help_of_all_commands_imports_nothing_heavy():
    code = (
        "import sys, importlib\n"
        f"for name in {NAMES}:\n"
        "    try: importlib.import_module(f'softdyn.commands.{name}').main(['--help'])\n"
        "    except SystemExit as stop: assert stop.code == 0\n"
        "    loaded = {'mujoco', 'pinocchio', 'tqdm', 'joblib', 'numpy'} & set(sys.modules)\n"
        "    assert not loaded, (name, loaded)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def said_by(parser, words, capsys) -> str:
    """The one line on stderr with which a parser refuses words."""
    with pytest.raises(SystemExit) as stop:
        parser.parse_args(words)
    out, err = capsys.readouterr()
    assert (stop.value.code, out, err.count("\n")) == (2, "", 1), words
    return err


def called(action) -> list[str]:
    """An option with as many values as it takes."""
    count = action.nargs if isinstance(action.nargs, int) else 1
    return [action.option_strings[0], *count * ["1"]]


@pytest.mark.parametrize("name", NAMES)
def test_a_parser_refuses_what_its_options_do_not_take(name, capsys):
    """Each command's parser: values of another kind or number, choices, groups, what is missing."""
    parser = importlib.import_module(f"softdyn.commands.{name}").parser
    options = [one for one in parser._actions if one.option_strings]
    for one in options:
        flag, spelt = one.option_strings[0], f"error: argument {'/'.join(one.option_strings)}: "
        if one.choices or one.type not in (None, str, Path):
            least = ["x"] * (one.nargs if isinstance(one.nargs, int) else 1)
            assert said_by(parser, [flag, *least], capsys).startswith(spelt), flag
        for word in {cli.positive: ("0", "-1", "nan"), cli.count: ("0", "1.5"),
                     cli.whole: ("-1",), cli.finite: ("nan", "inf")}.get(one.type, ()):  # fmt: skip
            wrong = [word] * (one.nargs if isinstance(one.nargs, int) else 1)
            assert f"got '{word}'" in said_by(parser, [flag, *wrong], capsys), flag
        if one.nargs not in (0, "?", "*"):
            assert said_by(parser, [flag], capsys).startswith(spelt + "expected "), flag
    for group in parser._mutually_exclusive_groups:
        for one, other in itertools.pairwise(group._group_actions):
            assert "not allowed with" in said_by(parser, [*called(one), *called(other)], capsys)
    needed = [one.dest for one in parser._actions if one.required]
    if needed or any(group.required for group in parser._mutually_exclusive_groups):
        assert "required" in said_by(parser, [], capsys)
    assert "--help lists, got '--zzz'" in said_by(parser, ["--zzz"], capsys)


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
    (folder / "tour.ipynb").write_text("mine")
    for path in folder.glob("soft*"):
        path.unlink()
    capsys.readouterr()
    assert main(["new", "--examples", str(folder)]) == 2
    assert "tour.ipynb" not in capsys.readouterr().out
    assert (folder / "tour.ipynb").read_text() == "mine"
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


def test_a_word_too_many_is_named_with_the_option_before_it(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["run", "finger", "best", "--targets", "0.1", "0", "-0.2"])
    assert stop.value.code == 2
    meant = "(after --targets; did you mean --target?)"
    assert capsys.readouterr().err == f"error: unrecognized arguments: 0 -0.2 {meant}\n"


def test_what_begins_with_a_dash_is_not_always_an_option(capsys):
    for line in ("statics finger --target -20 -1e-3 -inf", "check finger --sampl 0"):
        with suppress(SystemExit):
            assert main(line.split()) == 2
        assert "option:" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "message"),
    [("crosschek", "did you mean 'crosscheck'?"), ("", "`softdyn` lists"), ("os", "got 'os'")],
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
    assert "tour.ipynb" in outputs[0][1]


@pytest.mark.parametrize("name", ["statics", "play"])
def test_a_target_far_out_of_reach_is_refused(name, capsys):
    assert main([name, "finger", "--target", "20", "0", "0"]) == 2
    said = "within the robot's reach of 0.24 m, got one 20 m from the base: in cm?"
    assert said in capsys.readouterr().err


# -- options without use ---------------------------------------------------------------------------

USELESS = [
    (("statics", "--inputs", "9", "5", "--hold", "0.02", "--rays", "5"), "--rays", "--inputs"),
    (("statics", "--axis", "1", "0", "0", "--rays", "1", "--hold", "1"), "--hold", "--axis maps"),
    (("crosscheck", "--states-only", "--samples", "1", "--repair-inertia"), "--repair-inertia", ""),
    (("check", "--samples", "1", "--repair-inertia"), "--repair-inertia", "impossible inertia"),
    (("rollout", "--seconds", "0.01", "--contacts"), "--contacts", "collision shapes"),
    (("rollout", "--seconds", "0.01", "--friction"), "--friction", "has friction"),
    (("rollout", "--seconds", "0.01", "--rig"), "--rig", "states no lag"),
    (("export", "--mjcf", "out.xml", "--contacts"), "--contacts", "collision shapes"),
    (("export", "--urdf", "out.urdf", "--floating"), "--floating", "as its file states it"),
    (("view", "--html", "out.html", "--port", "9000"), "--port", "serves no page"),
    (("identify", "--twin", "0.1", "--folds", "2", "--timestep", "0.001"), "--folds", "own data"),
]


@pytest.mark.parametrize(("words", "option", "reason"), USELESS)
def test_an_option_that_changes_nothing_says_so(tmp_path, words, option, reason):
    file = robots.write(tmp_path, robots.preloaded())
    with pytest.warns(UserWarning, match=f"{option} changes nothing: .*{reason}") as told:
        done = command(words[0], file, *words[1:], cwd=tmp_path)
    assert done.code in (0, 1), done.err
    assert len([one for one in told if "changes nothing" in str(one.message)]) == 1


def test_keys_of_a_rig_that_change_nothing_say_so(tmp_path):
    (tmp_path / "arm.urdf").write_text(robots.preloaded())
    (tmp_path / "rig.toml").write_text(
        "stiffness = 500\nlag = 0.01\n[plant]\nfriction = true\ncontacts = true\n"
    )
    words = ("arm.urdf", "--rig", "rig.toml", "--seconds", "0.01")
    with pytest.warns(UserWarning, match="changes nothing") as told:
        done = command("rollout", *words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert [str(one.message).partition(" changes")[0] for one in told] == [
        f"rig.toml: {key}" for key in ("stiffness", "plant.contacts", "plant.friction")
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lagg = 0.01", "rig.toml: lagg: expected one of plant, sensors, lag, "),
        ("lag = -1.0", "rig.toml: lag: expected a finite number >= 0, got -1.0"),
        ("[plant]\nmas = 2.0", "rig.toml: [plant]: mas: expected one of contacts, "),
    ],
)
def test_a_bad_rig_file_is_named(tmp_path, text, said):
    (tmp_path / "arm.urdf").write_text(robots.preloaded())
    (tmp_path / "rig.toml").write_text(text)
    words = ("arm.urdf", "--rig", "rig.toml", "--seconds", "0.01")
    done = command("rollout", *words, cwd=tmp_path)
    assert (done.code, said in done.err) == (2, True), done.err


def test_an_option_with_a_use_says_nothing(tmp_path, recwarn):
    file = robots.write(tmp_path, robots.preloaded())
    done = command("statics", file, "--inputs", "9", "5", "--hold", "0.02", "--json", "-")
    assert done.code == 0, done.err
    assert not recwarn.list


def test_obstacles_of_a_robot_without_shapes_are_refused(tmp_path):
    (tmp_path / "arm.urdf").write_text(robots.preloaded())
    (tmp_path / "around.toml").write_text("[[sphere]]\ncentre = [1.0, 0, 0]\nradius = 0.1\n")
    (tmp_path / "gains.toml").write_text("Kp = 100.0\neps = 0.05\n")
    target, around = ("--target", "0.02", "0", "-0.199"), ("--obstacles", "around.toml")
    law = ("soft-id-clf-qp", "--gains", "gains.toml")
    for words in (
        ("run", "arm.urdf", "best", *target, "--duration", "0.01"),
        ("run", "arm.urdf", *law, *target, "--duration", "0.01"),
        ("play", "arm.urdf", *law, *target),
        ("rollout", "arm.urdf", "--seconds", "0.01"),
    ):
        done = command(*words, *around, cwd=tmp_path)
        assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
        assert done.err.startswith("error: around.toml: links: expected a link of arm.urdf")


def test_a_preload_can_be_exported(tmp_path):
    """MuJoCo refuses a range of width zero."""
    (tmp_path / "arm.urdf").write_text(robots.preloaded())
    done = command("export", "arm.urdf", "--mjcf", "arm.xml", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "the files agree" in done.out
