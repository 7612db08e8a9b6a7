"""One-step differences, for a short record of the reference implementation and for made ones."""

import json
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn.commands import cli
from softdyn.validation import paper
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.studies.engine.case import Case
from tests.proof import reproduce
from tests.proof.paper import one_step
from tests.proof.paper.reproduction import changed

# finger, Soft ID-CLF-QP, θ = 0: the first steps of the reference implementation's run at 37d7d0f
Q = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [
            0.0013854942278572397,
            7.938033554604244e-05,
            -0.0002577011966093153,
            -0.00013743715301712075,
        ],
        [
            0.0022844396376598755,
            0.00725390526297713,
            -0.00040935088472230567,
            0.0065624211561119946,
        ],
        [0.005573142967362332, 0.01703494923328098, 0.00039606106346714827, 0.01311446450314982],
        [0.0111047501759522, 0.02800722068851112, 0.0038824621061338102, 0.021957947492514278],
        [0.018989582688247648, 0.04081882064900072, 0.008078898644237598, 0.03072362500299014],
        [0.02887689113627734, 0.05463045380940562, 0.014440850765095534, 0.04133839173537006],
        [0.04054972707797522, 0.06954318933123156, 0.022800497812431448, 0.05352129939170118],
    ]
)
V = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [0.2770988455714479, 0.015876067109208487, -0.05154023932186306, -0.027487430603424148],
        [0.17978908196052718, 1.4349049854862175, -0.030329937622598068, 1.339971661825823],
        [0.6577406659404914, 1.9562087940607695, 0.1610823896378908, 1.3104086694075652],
        [1.1063214417179739, 2.194454291046028, 0.6972802085333324, 1.768696597872892],
        [1.5769665024590893, 2.5623199920979207, 0.8392873076207576, 1.7531355020951722],
        [1.977461689605938, 2.76232663208098, 1.2723904241715869, 2.122953346475983],
        [2.334567188339575, 2.982547104365188, 1.6719294094671828, 2.4365815312662233],
    ]
)
CTRL = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [1.0, -1.0, 0.40335218567462305, -0.40335218567462305],
        [0.9999999478942827, -0.9999999478942827, 0.360363658697447, -0.360363658697447],
        [0.999999941867524, -0.999999941867524, 0.4554643264985834, -0.4554643264985834],
        [0.9999996498708851, -0.9999996498708851, 0.4317336753369946, -0.4317336753369946],
        [1.0, -1.0, 0.509311039966116, -0.509311039966116],
        [0.9993661568535229, -0.9993661568535229, 0.5660040145649595, -0.5660040145649595],
        [-0.16566180602839156, 0.16566180602839156, 0.19856057150860978, -0.19856057150860978],
    ]
)
TARGET = (0.19798989873223327, 0.0, 0.15514718625761428)
CUT = "finger_soft-id-clf-qp_theta0.npz"


def save(path, q=Q, v=V, ctrl=CTRL, target=TARGET):
    np.savez(path, q=q, v=v, ctrl=ctrl, target=np.tile(target, (len(q), 1)))
    return path


@pytest.fixture
def cut(tmp_path):
    return one_step.read_run(save(tmp_path / CUT))


def test_a_record_is_read_in_our_terms(cut):
    assert cut.case == Case("finger", "soft-id-clf-qp", "set_point", 0.0)
    assert (cut.robot, cut.u.shape) == ("finger", (len(Q), 2))
    np.testing.assert_array_equal(cut.u, CTRL[:, [0, 2]])
    np.testing.assert_allclose(cut.targets[0] + [0, 0, 0.24], TARGET)


def test_the_emulation_of_the_finger_is_complete(cut):
    found = one_step.row(cut, cut.experiment)
    assert found["target_m"] < 1e-12
    assert found["state_max"] < 1e-9
    # as exact as the SCS of the record
    assert found["input_median"] < 1e-5
    assert found["input_max"] < 1e-3
    assert (found["steps"], found["state_off"], found["touching"]) == (len(Q), 0, 0)
    assert found["solver_max"] is None


def test_a_law_s_own_record_is_met(tmp_path):
    """A record of the emulation itself is reproduced to the last digits, with helix's inputs."""
    name, period = "reference", paper.setup("helix").period
    cell = Case("helix", "ic", "set_point", 0.5)
    case, model = changed(cell, name), softdyn.load("helix")
    plan, errors = case.experiment(model), RunOptions.of(case.options).plant
    twin = errors.twin(model.robot, timestep=period)
    law = case.around(case.law("ic", model))
    rows = []
    for k in range(6):
        q, v = twin.qpos, twin.qvel
        u = law(model.state(q, v), plan.reference(k * period)).u
        rows.append((q, v, u))
        twin.advance(u)
    q, v, u = map(np.array, zip(*rows, strict=True))
    ctrl = np.einsum("ij,kj->ki", model.state(q[0], v[0]).B, u)
    target = plan.reference(0.0).y + np.array([0, 0, 0.7])
    record = one_step.read_run(save(tmp_path / "helix_ic_theta0.5.npz", q, v, ctrl, target))
    found = one_step.row(record, name)
    assert found["input_max"] < 1e-12
    assert found["state_max"] < 1e-12
    off = one_step.row(replace(record, u=record.u + 1.0), name)
    assert off["input_max"] == pytest.approx(1 / 25)  # of a range of 25 N
    assert off["state_off"] == 5


def test_command_prints_the_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "one_thread", lambda: None)
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)
    (tmp_path / "runs").mkdir()
    save(tmp_path / "runs" / CUT)
    assert reproduce.main(["--records", "runs", "--json", "-"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert (row["robot"], row["experiment"]) == ("finger", "reference+jdot")
    assert math.isfinite(row["input_max"])
    assert "reference+jdot" in (tmp_path / "results/reproduction/one_step.md").read_text()
    assert reproduce.main(["late", "--records", "runs", "--robots", "finger", "helix"]) == 0
    assert "late" in capsys.readouterr().out
    assert reproduce.main(["--records", "runs", "--robots", "helix"]) == 2
