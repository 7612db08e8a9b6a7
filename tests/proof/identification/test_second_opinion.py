"""MuJoCo's own identification compared with ours, and the problems that it refuses."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import identification
from softdyn.identification import Measurements
from softdyn.identification.parameters import apply_values, member_values
from softdyn.validation.identification.trials import Excitation, twin_data
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin
from tests.proof.identification import second_opinion as second


@pytest.fixture(scope="module")
def finger(tmp_path_factory) -> softdyn.SoftModel:
    """The finger with rotor inertias, without which MuJoCo would need steps below 0.1 ms."""
    path = tmp_path_factory.mktemp("finger") / "finger.urdf"
    rotors = "".join(f'<joint name="joint{k}" armature="1e-4"/>' for k in (1, 2, 3, 4))
    text = softdyn.load("finger").robot.path.read_text()
    path.write_text(text.replace("</softdyn>", f"{rotors}</softdyn>"))
    return softdyn.load(path)


@pytest.fixture(scope="module")
def factors(finger):
    return [
        one
        for kind in ("stiffness", "damping")
        for one in identification.parameters(finger, kind, shared=True)
    ]


@pytest.fixture(scope="module")
def recorded(finger, factors) -> tuple[Measurements, np.ndarray]:
    joints = [f"q.{name}" for name in finger.joint_names]
    return twin_data(finger, factors, joints, Excitation(0.4), 0.2, 0)


def test_both_agree_with_each_other_and_with_the_truth(finger, factors, recorded):
    for needed in ("absl", "tabulate", "plotly", "imageio"):
        pytest.importorskip(needed, reason="the extra sysid is not installed")
    data, theta = recorded
    found = identification.identify(finger, data, factors, hold_out=0)
    opinion = second.second_opinion(finger, data, factors, found, hold_out=0)
    assert np.abs(opinion.differences).max() < 0.3  # the same optimum of the same data
    assert opinion.left < second.UNFINISHED
    for ours, theirs, truth in zip(opinion.ours, opinion.theirs, theta, strict=True):
        assert abs(theirs.value - truth) < 4 * theirs.deviation
        assert abs(ours.value - theirs.value) < np.hypot(ours.deviation, theirs.deviation)
        # ours are widened by the residuals' autocorrelation, theirs are not
        assert 0.6 < theirs.deviation / ours.deviation < 1.2
        assert theirs.deviation < 0.05 * abs(truth)  # otherwise this test shows nothing
        assert f"{theirs.value:.6g}" in str(opinion)


@pytest.mark.parametrize("kind", [*second.WRITERS])
def test_each_kind_is_written_where_mujoco_reads_it(kind, tmp_path):
    """With other values, the twin's accelerations equal the model's, not those of the file."""
    text = softdyn.load("finger").robot.path.read_text()
    text = text.replace('<tendon name="', '<tendon stiffness="2" damping="0.1" name="')
    text = text.replace("</softdyn>", '<joint name="joint1" armature="1e-3"/></softdyn>')
    path = tmp_path / "finger.urdf"
    path.write_text(text)
    model, rng = softdyn.load(path), np.random.default_rng(4)
    several = identification.parameters(model, kind)
    theta = np.array([one.nominal for one in several]) * 1.3 + 0.1 * (kind == "rest")
    twin, changed = Twin(model), apply_values(model, several, theta)
    q, v = rng.uniform(-0.5, 0.5, (2, model.nv))
    u = rng.uniform(model.u_min, model.u_max)
    states = StateMap(model, twin)
    twin.model = second.written(twin.model, member_values(model, several, theta))
    twin.set_state(*states.to_twin(q, v))
    twin.data.ctrl[:] = u
    twin.advance(u)  # which leaves the acceleration of the previous state
    expected = changed.forward_dynamics(q, v, u)
    size = np.abs(expected).max()
    assert np.allclose(twin.data.qacc[states.dofs], expected, atol=1e-6 * size)
    assert not np.allclose(model.forward_dynamics(q, v, u), expected, atol=1e-4 * size)
