"""Forces of one's own on the command line, in records and in repetitions."""

from __future__ import annotations

import json

import numpy as np
import pytest

import softdyn
from softdyn.commands import check, export, rollout, run, statics
from softdyn.controllers import Impedance
from softdyn.dynamics import Wrench
from softdyn.validation import Log, paper, simulate
from softdyn.validation.loop.repeat import compare_runs, experiment_of, lost_parts

FORCE = """
class Drag:
    name = "drag"
    size = 0.01

    def __call__(self, model, q, v):
        return -self.size * v
"""


@pytest.fixture
def drag(tmp_path, monkeypatch):
    (tmp_path / "drag.py").write_text(FORCE)
    monkeypatch.chdir(tmp_path)
    return "drag.py:Drag"


def test_a_run_has_it_and_repeats_with_it(drag, capsys):
    words = ["finger", "ic", "--theta", "0.5", "--duration", "0.05", "--no-verdict"]
    run.main([*words, "--log", "dry.npz"])
    run.main([*words, "--log", "wet.npz", "--force", drag, "--force-set", "drag.size=0.05"])
    dry, wet = Log.load("dry.npz"), Log.load("wet.npz")
    assert np.abs(dry.q - wet.q).max() > 1e-5
    (said,) = wet.record["robot"]["forces"]
    assert said["numbers"] == {"size": 0.05}
    capsys.readouterr()
    assert run.main(["--from", "wet.npz"]) == 0
    assert "equal to the bit" in capsys.readouterr().out


def test_the_other_commands_take_it(drag, capsys):
    assert rollout.main(["finger", "--u", "0.1", "0", "--seconds", "0.02", "--force", drag]) == 0
    assert check.main(["finger", "--force", drag, "--samples", "1"]) in (0, 1)
    assert statics.main(["finger", "--inputs", "0.1", "0", "--hold", "0.1", "--force", drag]) == 0
    assert capsys.readouterr().err == ""


def test_an_export_lists_it_as_lost(drag, capsys):
    assert export.main(["finger", "--mjcf", "out.xml", "--force", drag]) == 0
    assert "lost: the force 'drag'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["--force", "drag.py:Dreg"],
        ["--force", "drag.py:Drag", "--force", "drag.py:Drag"],
        ["--force-set", "drag.size=3"],
        ["--force", "drag.py:Drag", "--force-set", "drag.sise=3"],
        ["--force", "drag.py:Drag", "--force-set", "drag.size=much"],
        ["--force", "drag.py:Drag", "--force-set", "size"],
    ],
)  # fmt: skip
def test_what_is_no_force_is_one_line(words, drag, capsys):
    assert rollout.main(["finger", "--seconds", "0.01", *words]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_wrench_is_recorded_and_a_class_without_a_file_is_named(tmp_path):
    def log_of(*forces):
        model = softdyn.load("finger").with_forces(*forces)
        return simulate(model, Impedance(model), paper.set_point("finger", 0.5), duration=0.02)

    log = log_of(Wrench("tip", force=[0, 0, 0.1]))
    log.save(tmp_path / "run.npz")
    kept = Log.load(tmp_path / "run.npz")
    parts, _ = experiment_of(kept.record, kept.source)
    assert parts["model"].forces == (Wrench("tip", force=[0, 0, 0.1]),)
    assert compare_runs(log, simulate(**parts)).equal
    assert json.loads(json.dumps(kept.record))

    class Local:
        name = "local"

        def __call__(self, model, q, v):
            return 0 * v

    assert lost_parts(log_of(Local()).record) != []
