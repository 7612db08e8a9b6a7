"""The fuzzer sees what it is for, and a short run of it finds nothing."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import softdyn
from softdyn import InputError, Robot, SoftdynError, parse
from softdyn.commands import cli
from softdyn.validation import Log
from softdyn.validation.live.session import Session
from softdyn.validation.studies.engine import store
from tests.proof import fuzz
from tests.proof.fuzzing import arguments, campaign, data, messages
from tests.proof.fuzzing.second_reading import differences
from tests.proof.fuzzing.verdict import ACCEPTED, EXCEPTION, FINDINGS, LOST, MESSAGE, REFUSED, judge
from tests.support.dying_worker import dying_worker
from tests.support.misuses import ARM, MISUSES
from tests.support.random_robots import random_urdf

BASES = sorted(fuzz.CORPUS.glob("base/*.urdf"))
FOUND = sorted(fuzz.CORPUS.glob("found/*.urdf"))


def read(folder: Path, text: str) -> Robot:
    path = folder / "robot.urdf"
    path.write_text(text)
    return parse(path)


def test_a_short_run_finds_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["--count", "150", "--seed", "11", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["refused"] + report["accepted"] == report["count"] == 150
    assert min(report["refused"], report["accepted"]) > 25
    assert report["compared_in_both_engines"] > 5
    assert set(report["findings"]) == set(FINDINGS)
    assert not any(report["findings"].values())
    assert report["kinds_of_refusal"] > 50


@pytest.mark.parametrize("path", BASES, ids=lambda path: path.stem)
def test_base_files_are_accepted(path: Path, tmp_path: Path) -> None:
    verdict = judge(path.read_bytes(), tmp_path / "robot.urdf", True)
    assert (verdict.kind, verdict.deep) == (ACCEPTED, True), verdict.detail


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.stem)
def test_what_was_found_once_is_found_no_more(path: Path, tmp_path: Path) -> None:
    verdict = judge(path.read_bytes(), tmp_path / "robot.urdf", True)
    assert verdict.kind in (ACCEPTED, REFUSED), verdict


# -- the second reading ------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_two_readings_of_random_robots_agree(seed: int, tmp_path: Path) -> None:
    text = random_urdf(seed)
    assert differences(read(tmp_path, text), text.encode()) == []


def losses(robot: Robot) -> dict[str, Robot]:
    """The robot with one thing lost or changed, by what that is."""
    joint, link, tendon, actuator = robot.joints[2], robot.links[3], *robot.tendons[:1], (
        robot.actuators[0]
    )  # fmt: skip

    def joints(**change: object) -> Robot:
        changed = replace(joint, **change)  # type: ignore[arg-type]
        return replace(robot, joints=tuple(changed if j is joint else j for j in robot.joints))

    def tendons(**change: object) -> Robot:
        changed = replace(tendon, **change)  # type: ignore[arg-type]
        return replace(robot, tendons=(changed, *robot.tendons[1:]))

    lighter = replace(link, mass=0.0)
    turned = replace(link, moments=(9e-5, 0, 0, 1e-5, 0, 9e-5))
    cable = robot.tendons[1]
    shorter = replace(cable, sites=cable.sites[:2])
    return {
        "a joint": replace(robot, joints=robot.joints[:-1]),
        "a link": replace(robot, links=robot.links[:-1]),
        "a tendon": replace(robot, tendons=robot.tendons[:2]),
        "an actuator": replace(robot, actuators=robot.actuators[1:]),
        "the task": replace(robot, task="pad"),
        "a site": replace(robot, tendons=(tendon, shorter, *robot.tendons[2:])),
        "a term": tendons(terms=tendon.terms[:1]),
        "a tendon's spring": tendons(stiffness=0.0),
        "a tendon's rest": tendons(rest=None),
        "a gear": replace(robot, actuators=(replace(actuator, gear=1.0), *robot.actuators[1:])),
        "a bound": replace(robot, actuators=(replace(actuator, upper=2.0), *robot.actuators[1:])),
        "a spring": joints(stiffness=0.0),
        "a damper": joints(damping=0.0),
        "a limit": joints(lower=0.0),
        "an axis": joints(direction=(0.0, 1.0, 0.0)),
        "a place": joints(origin=replace(joint.origin, xyz=(0.0, 0.0, 1e-6))),
        "a mass": replace(robot, links=tuple(lighter if x is link else x for x in robot.links)),
        "an inertia": replace(robot, links=tuple(turned if x is link else x for x in robot.links)),
    }


def test_every_loss_is_seen(tmp_path: Path) -> None:
    robot = read(tmp_path, ARM)
    assert differences(robot, ARM.encode()) == []
    unseen = [what for what, less in losses(robot).items() if not differences(less, ARM.encode())]
    assert unseen == []


def test_every_loss_of_a_rig_is_seen(tmp_path: Path) -> None:
    text = (fuzz.CORPUS / "base" / "rig.urdf").read_text()
    robot = read(tmp_path, text)
    assert differences(robot, text.encode()) == []
    for old, new in (
        (' slack="true"', ""), ('"length" stiff', '"velocity" stiff'), ("900", "901"),
        ('lag="0.02"', ""), ('rate="0.08"', 'rate="0.09"'), ('delay="0.005"', ""),
        ('length_lower="0.01"', ""), ("length_upper", "length_uper"), ('damping="4"', ""),
        ('"tension"', '"length"'), ('tension" tendon="flexor"', 'tension" tendon="cable"'),
        ('"1e-4" resolution', '"2e-4" resolution'), ("5e-5", "6e-5"), ('rate="200"', ""),
        ('latency="0.04"', ""), ('"0 0.1 0"', '"0 0.2 0"'), ('bias="-0.2"', 'bias="0.2"'),
        ('joint="bend"/>', 'joint="twist"/>'), ('xyz="0.01 0 0"', ""),
    ):  # fmt: skip
        assert text.count(old) == 1, old
        assert differences(robot, text.replace(old, new).encode()), old


# -- verdicts ----------------------------------------------------------------------------------


def test_verdicts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "robot.urdf"
    assert judge(ARM.encode(), path, True).kind == ACCEPTED
    kinds = {judge(misuse.data, path, False).kind for misuse in MISUSES if len(misuse.data) < 1e5}
    assert kinds == {REFUSED}

    def parsed(robot: object) -> None:
        monkeypatch.setattr("tests.proof.fuzzing.verdict.parse", robot)

    robot = parse(_written(path, ARM))
    parsed(lambda path, **_: replace(robot, actuators=()))
    assert judge(ARM.encode(), path, False).kind == LOST
    parsed(lambda path, **_: 1 / 0)
    assert judge(ARM.encode(), path, False).kind == EXCEPTION

    def two_lines(path: Path, **_: object) -> None:
        raise SoftdynError(f"{path}: one\ntwo")

    parsed(two_lines)
    assert judge(ARM.encode(), path, False).kind == MESSAGE


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_dead_process_is_a_finding_and_is_replaced() -> None:
    outcomes = list(campaign.in_a_process([], 0, range(8), dying_worker))
    assert [index for index, _, _ in outcomes] == list(range(8))
    kinds = [kind for _, (kind, _, _), _ in outcomes]
    assert kinds == [ACCEPTED, ACCEPTED, "crash", ACCEPTED, ACCEPTED, "hang", ACCEPTED, ACCEPTED]


# -- logs, stores and TOML ---------------------------------------------------------------------


def test_a_short_run_on_data_finds_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["--data", "--count", "300", "--seed", "5", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["refused"] + report["accepted"] == report["count"] == 300
    assert report["accepted"] > 5
    assert report["kinds_of_refusal"] > 20


def test_data_of_every_kind_is_accepted_and_its_loss_is_seen(tmp_path, monkeypatch) -> None:
    bases = data.kinds()
    for kind in bases:
        assert data.judge(kind, kind.base, tmp_path).kind == ACCEPTED, kind.name
        assert data.judge(kind, b"[" * 10_000, tmp_path).kind == REFUSED, kind.name
    drawn = [data.mutant(bases, 3, k)[1] for k in range(30)]
    assert [data.mutant(data.kinds(), 3, k)[1] for k in range(30)] == drawn
    log, result = bases[:2]
    load = Log.load
    monkeypatch.setattr(Log, "load", lambda path: replace(load(path), robot="other"))
    assert data.judge(log, log.base, tmp_path).kind == LOST
    monkeypatch.setattr(store, "_seal", lambda content: content.get("sha256"))
    monkeypatch.setattr(store, "_read", lambda path: json.loads(path.read_bytes()))
    assert data.judge(result, result.base.replace(b"1.5", b"123.456"), tmp_path).kind == LOST
    monkeypatch.setattr(store, "_read", lambda path: 1 / 0)
    assert data.judge(result, result.base, tmp_path).kind == EXCEPTION


# -- messages to a live robot --------------------------------------------------------------------


def test_a_short_run_of_messages_finds_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["--messages", "--count", "300", "--seed", "1", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["refused"] + report["accepted"] == report["count"] == 300
    assert report["accepted"] > 5
    assert report["kinds_of_refusal"] > 15


def test_a_refused_message_that_changes_something_is_a_finding(monkeypatch) -> None:
    session = Session(softdyn.load("finger"), {}, "open loop")
    assert all(messages.judge(session, one).kind in (ACCEPTED, REFUSED) for one in messages.said())

    def careless(message):
        session.plant.twin.data.qpos[0] += 0.1
        raise InputError("do", "something else", "this")

    monkeypatch.setattr(session, "apply", careless)
    assert messages.judge(session, b'{"do": "release"}').kind == LOST
    monkeypatch.setattr(session, "apply", lambda message: 1 / 0)
    assert messages.judge(session, b'{"do": "release"}').kind == EXCEPTION


# -- command lines -----------------------------------------------------------------------------


def test_a_short_run_on_command_lines_finds_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["--arguments", "--count", "60", "--seed", "8", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["refused"] + report["accepted"] == report["count"] == 60
    assert report["accepted"] > 2
    assert report["kinds_of_refusal"] > 10


def _refuse(said: str) -> int:
    print(said, file=sys.stderr)
    return 2


@pytest.mark.parametrize(
    ("main", "kind"),
    [
        (lambda words: 0, LOST),  # --json out.json is not written
        (lambda words: Path("out.json").write_text("{}") and 0, ACCEPTED),
        (lambda words: Path("out.json").write_text("") or 0, LOST),
        (lambda words: _refuse("error: a: expected b, got c"), REFUSED),
        (lambda words: Path("half").write_text("x") and _refuse("error: no"), LOST),
        (lambda words: _refuse("error: two\nlines"), MESSAGE),
        (lambda words: _refuse("wrong"), MESSAGE),
        (lambda words: _refuse("error: " + "x" * 5000), MESSAGE),
        (lambda words: 1 / 0, EXCEPTION),
        (lambda words: sys.exit("done"), EXCEPTION),
        (lambda words: 7, EXCEPTION),
        (lambda words: _forever(), ACCEPTED),  # ended as by Ctrl-C
    ],
)
def test_what_a_command_may_not_do(main, kind, tmp_path: Path, monkeypatch) -> None:
    parser = cli.Parser(None)
    cli.add_json(parser)
    command = SimpleNamespace(main=main, parser=parser)
    monkeypatch.setitem(sys.modules, "strange_command", command)
    monkeypatch.setattr(arguments, "PATIENCE", 0.05)
    monkeypatch.chdir(tmp_path)
    line = arguments.Line("strange_command", ("--json", "out.json"), {}, True)
    assert arguments.judge(line, line.words, tmp_path / "a" / "b").kind == kind


def _forever() -> int:
    try:
        while True:
            pass
    except KeyboardInterrupt:
        return 130
