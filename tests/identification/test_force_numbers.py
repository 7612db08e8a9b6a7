"""Numbers of forces of one's own, identified from the motion of MuJoCo and from rests."""

from __future__ import annotations

import json

import numpy as np
import pytest

import softdyn
from softdyn import InputError, identification
from softdyn.commands import identify
from softdyn.dynamics import Wrench
from softdyn.loading import load_text
from softdyn.statics import settle
from softdyn.validation.identification.trials import Excitation, trial
from tests.support.sweeps import PENDULUM

DRAG = '''
class Drag:
    """A drag that grows with the square of a joint's velocity, beside a linear one."""

    name = "drag"
    linear = 0.05
    square = 0.02

    def __call__(self, model, q, v):
        return -self.linear * v - self.square * v * abs(v)
'''


@pytest.fixture
def drag(tmp_path, monkeypatch):
    (tmp_path / "drag.py").write_text(DRAG)
    monkeypatch.chdir(tmp_path)
    return softdyn.controllers.find_controller("drag.py:Drag")()


def test_a_drag_is_found_within_its_interval(drag):
    """The twin has another coefficient, and its angles have 5 mrad of noise."""
    model = load_text(PENDULUM, path="pendulum.urdf").with_forces(drag)
    both = identification.parameters(model, "force")
    assert [one.label for one in both] == ["force drag.linear", "force drag.square"]
    one = trial(model, both, ["q.turn"], Excitation(0.4, timestep=5e-4), 1.0, 2)
    assert np.abs(one.scores).max() < 3
    assert np.abs(one.relative).max() < 0.05


def test_the_command_writes_the_number_and_the_interval_of_a_rest(tmp_path, monkeypatch, capsys):
    """Rows at rest under a load of 0.03 N. The force in the model begins with 0.01 N."""
    (tmp_path / "weight.py").write_text(
        "class Weight:\n    name = 'weight'\n    newton = 0.01\n\n"
        "    def __call__(self, model, q, v):\n"
        "        return -self.newton * model.link_jacobian(q, 'tip')[2]\n"
    )
    monkeypatch.chdir(tmp_path)
    loaded = softdyn.load("finger", forces=[Wrench("tip", force=[0, 0, -0.03])])
    rows, rng = ["u.u1,u.u2,tip.x,tip.y,tip.z"], np.random.default_rng(1)
    for part in np.linspace(0.02, 0.3, 20):
        u = part * loaded.u_max * [1, 0]
        y = settle(loaded, u).y + 1e-4 * rng.normal(size=3)
        rows.append(",".join(map(repr, [*u.tolist(), *y.tolist()])))
    (tmp_path / "rests.csv").write_text("\n".join(rows))
    words = ["finger", "rests.csv", "--static", "--force", "weight.py:Weight"]
    code = identify.main([*words, "--free", "force.weight.newton", "--json", "fit.json"])
    assert code == 0
    (found,) = json.loads((tmp_path / "fit.json").read_text())["parameters"]
    assert found["low"] < 0.03 < found["high"]
    assert found["high"] - found["low"] < 0.003
    assert "--force-set weight.newton=0.0" in capsys.readouterr().out


@pytest.mark.parametrize("word", ["force.drag.lineer", "force", "stiffness.joint9"])
def test_a_number_that_no_force_has_is_refused(word, drag):
    forces = [] if word == "force" else [drag]
    with pytest.raises(InputError):
        identification.parameters(softdyn.load("finger", forces=forces), word)
