from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from softdyn.validation import Log
from softdyn.validation.bench import drive as driving
from tests.support.benched import ARM, benched, tower
from tests.support.command import command

NEAR = "from tests.support.benched import NearDriver\n"
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
    Path("arm.urdf").write_text(ARM)
    Path("near.py").write_text(NEAR)
    Path("bad.py").write_text(BAD)
    Path("law.py").write_text(LAW)
    rig = tower(benched())
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
