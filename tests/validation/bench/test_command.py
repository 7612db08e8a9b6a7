from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import pytest

from softdyn import InputError
from softdyn.validation import Log, files
from softdyn.validation.bench import drive as driving
from tests.support.bench import bench_arm, tower
from tests.support.command import command
from tests.support.robots import BENCH

NEAR = "from tests.support.bench import NearDriver\n"
BAD = "class Mute:\n    def __init__(self, model): pass\n"
LAW = (
    "from types import SimpleNamespace\n"
    "class Push:\n"
    "    def __init__(self, model):\n        self.calls = 0\n"
    "    def __deepcopy__(self, memo):\n        raise TypeError\n"
    "    def __call__(self, state, reference):\n"
    "        self.calls += 1\n"
    "        if self.calls > 20:\n            raise RuntimeError('slipped')\n"
    "        return SimpleNamespace(u=[1.0, 1.0])\n"
)


@pytest.fixture
def rig(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(BENCH)
    Path("near.py").write_text(NEAR)
    Path("bad.py").write_text(BAD)
    Path("law.py").write_text(LAW)
    rig = tower(bench_arm())
    made = partial(driving.Drive, watchdog=False, source=rig.hands.source)
    monkeypatch.setattr(driving, "Drive", made)
    return rig


def test_an_error_of_one_s_own_class_is_the_reason_and_leaves_the_log(rig):
    words = ["drive", "arm.urdf", "law.py:Push", "--driver", "near.py:NearDriver"]
    code, out, err = command(*words, "--target", "0.3", "0", "-0.1", "--log", "a.npz")
    assert code == 1
    assert "RuntimeError: slipped" in err
    assert err.splitlines()[-1].startswith("stopped by controller: controller: RuntimeError")
    assert "stopped by     controller" in out
    log = Log.load("a.npz")
    assert log.steps == 20
    assert "slipped" in log.reason
    assert rig.stops == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["arm.urdf", "best", "--target", "0.3", "0", "0"], "--driver: expected FILE.py:CLASS"),
        (["arm.urdf", "--driver", "near.py:NearDriver"], "expected a CONTROLLER with a target"),
        (["arm.urdf", "best", "--serve"], "--serve: not allowed with a CONTROLLER"),
        (["arm.urdf", "--driver", "bad.py:Mute", "--hold", "0", "0"], "driver: expected an object"),
        (["arm.urdf", "--driver", "near.py:Nobody", "--hold", "0", "0"], "driver: expected"),
        (["arm.urdf", "--driver", "near.py:NearDriver", "--hold", "0", "99"],
         "hold: expected a command of 'ub' from -60 to 60, got 99"),
        (["finger", "ic", "--theta", "0.5", "--driver", "near.py:NearDriver"], "<sensor>"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(rig, words, said):
    code, _, err = command("drive", *words)
    assert code == 2
    assert said in err
    assert len(err.splitlines()) == 1
    assert rig.starts == 0


STILL = (
    "from types import SimpleNamespace\n"
    "class Still:\n"
    "    def __init__(self, model): pass\n"
    "    def __call__(self, state, reference):\n"
    "        return SimpleNamespace(u=[0.0, 0.0])\n"
)
AWAY = (
    "import shutil\n"
    "class Leaving(NearDriver):\n"
    "    'Takes the folder of the results away at the end.'\n"
    "    def stop(self):\n"
    "        super().stop()\n"
    "        shutil.rmtree('out', ignore_errors=True)\n"
)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["law.py:Still", "--target", "0.3", "0", "-0.1"], 1),  # it does not get there
        (["law.py:Still", "--target", "0.3", "0", "-0.1", "--no-verdict"], 0),
        (["law.py:Push", "--target", "0.3", "0", "-0.1", "--no-verdict"], 1),  # it fails
        (["law.py:Off", "--target", "0.3", "0", "-0.1", "--no-verdict", "--ramp", "0"], 1),
        # its commands have not risen yet
        (["law.py:Off", "--target", "0.3", "0", "-0.1", "--no-verdict", "--ramp", "0.4"], 0),
        (["--hold", "0", "0"], 0),
    ],
)
def test_the_exit_code_is_the_verdict_s_unless_none_is_asked_for(rig, words, code):
    off = STILL.replace("Still", "Off").replace("[0.0, 0.0]", "[-40.0, -40.0]")
    Path("law.py").write_text(LAW + STILL + off)
    found, _, _ = command(
        "drive", "arm.urdf", *words, "--driver", "near.py:NearDriver", "--duration", "0.3"
    )
    assert found == code


@pytest.mark.parametrize(("option", "file"), [("--log", "a.npz"), ("--html", "a.html")])
def test_a_result_that_has_no_room_is_written_elsewhere_and_fails(
    rig, tmp_path, monkeypatch, option, file
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    Path("near.py").write_text(NEAR + AWAY)
    Path("out").mkdir()
    words = ["drive", "arm.urdf", "--hold", "0", "0", "--duration", "0.1"]
    code, out, err = command(*words, "--driver", "near.py:Leaving", option, f"out/{file}")
    (written,) = tmp_path.glob(f"*-{file}")
    assert code == 1
    assert f"wrote {written} instead" in err
    assert f"wrote {written}" in out


@pytest.mark.parametrize("option", ["--log", "--html"])
def test_a_result_that_has_no_room_anywhere_is_said_and_fails(rig, monkeypatch, option):
    def refuse(write, path):
        raise InputError(path, "room", "none")

    monkeypatch.setattr(files, "save_somewhere", refuse)
    words = ["drive", "arm.urdf", "--hold", "0", "0", "--duration", "0.1"]
    code, out, err = command(*words, "--driver", "near.py:NearDriver", option, "a.html")
    assert code == 1
    assert "nothing could be written elsewhere" in err
    assert "wrote" not in out


def test_a_report_that_cannot_be_written_fails(rig):
    Path("near.py").write_text(NEAR + AWAY)
    Path("out").mkdir()
    words = ["drive", "arm.urdf", "--hold", "0", "0", "--duration", "0.1"]
    code, _, err = command(*words, "--driver", "near.py:Leaving", "--json", "out/a.json")
    assert code == 1
    assert "out/a.json" in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--hold", "0", "0"], "commands held on a rig"),
        (["law.py:Still", "--target", "0.3", "0", "-0.1", "--no-verdict"], "settings.plant"),
    ],
)
def test_a_run_on_a_rig_is_not_repeated(rig, words, said):
    Path("law.py").write_text(LAW + STILL)
    given = ["--driver", "near.py:NearDriver", "--duration", "0.3", "--log", "rig.npz"]
    assert command("drive", "arm.urdf", *words, *given)[0] == 0
    code, out, err = command("run", "--from", "rig.npz")
    assert (code, out) == (2, "")
    assert said in err
    assert len(err.splitlines()) == 1
