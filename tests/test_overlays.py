"""Annotations in a separate file: their effect, every misuse, and the shipped examples."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import UrdfError
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.description.urdf import parse
from softdyn.validation import crosscheck, paper, simulate
from tests.support import ROOT, robots
from tests.support.misuses import ARM
from tests.support.refused import refused

EXAMPLES = ROOT / "docs" / "examples"
BLOCK = re.search(r"<softdyn.*</softdyn>", ARM, re.DOTALL)
assert BLOCK is not None
INSIDE = BLOCK.group().removeprefix('<softdyn version="1">').removesuffix("</softdyn>")
PLAIN = ARM.replace(BLOCK.group(), "")
TARGETS = {  # robot, example, reached within 1 mm in 4 s
    "soft_ur5": ("ur5", (0.45, 0.35, 0.0)),
    "soft_panda": ("panda", (0.4, 0.15, 0.3)),
    "soft_allegro": ("allegro_right_hand", (0.0789, 0.0492, 0.04)),
}


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = robots.write(tmp_path, PLAIN, "arm.urdf")
    return path


def overlay(folder: Path, inside: str, head: str = '<softdyn version="1">') -> Path:
    path = folder / "soft.xml"
    path.write_text(f"{head}{inside}</softdyn>")
    return path


def test_the_block_says_the_same_in_either_file(arm, tmp_path):
    whole = robots.write(tmp_path, ARM, "whole.urdf")
    apart = softdyn.load(arm, annotations=overlay(tmp_path, INSIDE))
    beside = softdyn.load(whole)
    q, v = apart.configuration(np.linspace(-0.3, 0.3, apart.nv)), np.linspace(-1, 1, apart.nv)
    for name in ("M", "bias", "K", "D", "B", "y", "lengths"):
        np.testing.assert_array_equal(
            getattr(apart.state(q, v), name), getattr(beside.state(q, v), name)
        )
    assert apart.robot.task == beside.robot.task
    np.testing.assert_array_equal(apart.u_max, beside.u_max)


def joints(path: Path, annotations: Path) -> dict[str, tuple[float, ...]]:
    return {
        joint.name: (joint.stiffness, joint.rest, joint.damping, joint.armature)
        for joint in parse(path, annotations=annotations).joints
    }


def test_springs_and_dampers_replace_those_of_the_urdf(arm, tmp_path):
    before = joints(arm, overlay(tmp_path, ""))
    assert before["bend"][:3] == (0.5, 0.1, 0.02)
    given = '<joint name="bend" stiffness="3" damping="0.7" rest="-0.2" armature="0.01"/>'
    after = joints(arm, overlay(tmp_path, given))
    assert after.pop("bend") == (3.0, -0.2, 0.7, 0.01)
    assert after == {name: values for name, values in before.items() if name != "bend"}
    half = joints(arm, overlay(tmp_path, '<joint name="bend" damping="0"/>'))
    assert half["bend"] == (0.5, 0.1, 0.0, 0.0)


@pytest.mark.parametrize(
    ("inside", "element", "expected", "got"),
    [
        ('<joint name="bend" stiffness="-1"/>', '<joint name="bend">', "stiffness >= 0", "-1.0"),
        ('<joint name="bend" damping="x"/>', '<joint name="bend">', "a finite number", "'x'"),
        ('<joint name="bend" rest="nan"/>', '<joint name="bend">', "a finite number", "'nan'"),
        ('<joint name="bend" lower="0"/>', '<joint name="bend">', "no attribute but", "lower"),
        ('<joint name="thumb" damping="1"/>', '<joint name="thumb">', "name of a joint", "thumb"),
        ('<joint name="glue" damping="1"/>', '<joint name="glue">', "that moves", "'glue'"),
        ('<joint name="spin" stiffness="1"/>', '<joint name="spin">', "revolute or pris", "spin"),
        ('<spring joint="bend"/>', "<spring>", "<joint> or <tendon>", "<spring>"),
        ('<tendon name="t"/>', '<tendon name="t">', "at least one <joint>", "an empty tendon"),
        ('<task frame="nail"/>', "<task>", "the name of a link", "'nail'"),
        (
            '<task frame="pad"/><task frame="pad"/>',
            "<task>",
            "a unique task name",
            "a second 'pad'",
        ),
    ],
)
def test_misuses_name_the_overlay_and_its_line(inside, element, expected, got, arm, tmp_path):
    path = overlay(tmp_path, f"\n{inside}")
    with pytest.raises(UrdfError) as caught:
        softdyn.load(arm, annotations=path)
    error = caught.value
    assert (error.file, error.line) == (path, 2)
    assert element in error.element
    assert expected in error.expected
    assert got in error.got
    assert len(str(error).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ("file",)),
        ('<softdyn version="1">', ("file",)),
        ("<robot/>", ("<robot>", "<robot>")),
        ("<softdyn/>", ("<softdyn>", "none")),
        ('<softdyn version="2"/>', ("<softdyn>", "'2'")),
        ('<!DOCTYPE x><softdyn version="1"/>', ("<!DOCTYPE>", "a document type declaration")),
    ],
)
def test_what_is_no_overlay_is_refused(text, expected, arm, tmp_path):
    path = tmp_path / "soft.xml"
    path.write_text(text)
    with refused(*expected, by=UrdfError) as caught:
        softdyn.load(arm, annotations=path)
    assert caught.value.file == path


def test_a_missing_overlay_is_named(arm, tmp_path):
    with refused("file", "No such file or directory", by=UrdfError):
        softdyn.load(arm, annotations=tmp_path / "absent.xml")


def test_a_urdf_with_a_block_takes_no_overlay(tmp_path):
    with refused("<softdyn>", "a block here and another in…", by=UrdfError):
        softdyn.load("finger", annotations=overlay(tmp_path, ""))


@pytest.mark.parametrize("script", ["crosscheck", "run"])
def test_commands_exit_with_code_2_and_one_line(script, tmp_path, monkeypatch, capsys):
    main = importlib.import_module(f"softdyn.commands.{script}").main
    path = overlay(tmp_path, '<joint name="thumb"/>')
    goal = ["ic", "--theta", "0"] if script == "run" else []
    assert main(["double_pendulum", *goal, "--annotations", str(path)]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"error: {path}:1: ")
    assert message.count("\n") == 1


# -- the examples ----------------------------------------------------------------------------------


def example(name: str) -> softdyn.SoftModel:
    return softdyn.load(TARGETS[name][0], annotations=EXAMPLES / f"{name}.xml")


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", TARGETS)
def test_examples_are_underactuated_and_cross_checked(name):
    model = example(name)
    assert 0 < model.nu < model.nv
    assert (model.stiffness > 0).all()
    assert (model.damping > 0).all()
    result = crosscheck(model, samples=3, trajectories=False)
    assert result.passed, [(c.quantity, c.max_error, c.reason) for c in result.checks]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", TARGETS)
def test_examples_reach_their_targets(name):
    model = example(name)
    gains = Gains(**tomllib.loads((EXAMPLES / f"{name}.toml").read_text()))
    target = paper.setup_of(model).target(TARGETS[name][1])
    log = simulate(model, SoftIdClfQp(model, gains), target, duration=4.0)
    assert not log.failed, log.reason
    assert log.fallbacks == log.not_solved == 0
    assert np.linalg.norm(log.error[-1]) < 1e-3 < 0.1 < np.linalg.norm(log.error[0])
    assert np.abs(log.v[-1]).max() < 0.05
