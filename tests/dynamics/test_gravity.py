"""Gravity in any direction: an argument, the block, a table; judged by MuJoCo's own."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import InputError, UrdfError, design, statics
from softdyn.controllers import Impedance
from softdyn.description.urdf_writer import write
from softdyn.validation import Log, Twin, compare, crosscheck, paper, rollout, simulate
from softdyn.validation.loop.repeat import compare_runs, experiment_of
from softdyn.validation.mjcf.export import write_mjcf, write_urdf
from tests.support import robots

TILTED = (3.0, -4.0, -8.0)
FILE = robots.GRIPPER.replace('<softdyn version="1">', '<softdyn version="1" gravity="3 -4 -8">')


@pytest.mark.parametrize("floating", [False, True])
def test_the_force_of_gravity_is_mujoco_s(floating, tmp_path):
    text = robots.WALKER if floating else robots.GRIPPER
    path = robots.write(tmp_path, text)
    model = softdyn.load(path, gravity=TILTED, floating=floating)
    found = crosscheck(model, samples=20)
    assert found.passed, str(found)
    assert tuple(Twin(model).model.opt.gravity) == TILTED
    down = softdyn.load(path, floating=floating)
    assert np.abs(down.gravity(down.q0) - model.gravity(model.q0)).max() > 0.1


def test_turning_gravity_is_turning_the_base(tmp_path):
    """A rod on a base that is turned by -0.7 rad about y hangs as one in turned gravity."""
    c, s = np.cos(0.7), -np.sin(0.7)
    turned = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    section = design.Section(0.1, 0.01, design.Material(0.25e6, 0.49, 1070), 4)
    rests = []
    for mount in (
        design.Mount(direction=turned @ [0, 0, -1]),
        design.Mount(gravity=turned.T @ [0, 0, -9.81]),
    ):
        model = robots.load(tmp_path, design.urdf(design.Arm((section,), mount=mount)))
        rests.append(statics.settle(model, model.relaxed).q)
    assert np.abs(rests[0]).max() > 0.01
    np.testing.assert_allclose(*rests, atol=1e-9)


def test_argument_block_and_table_state_the_same(tmp_path):
    bare = robots.load(tmp_path, robots.GRIPPER)
    given = softdyn.load(bare.robot.path, gravity=np.array(TILTED))
    (tmp_path / "stated.urdf").write_text(FILE)
    stated = softdyn.load(tmp_path / "stated.urdf")
    both = softdyn.load(tmp_path / "stated.urdf", gravity=TILTED)
    assert given.robot == stated.robot == both.robot
    assert given.robot.digest == stated.robot.digest != bare.robot.digest
    (tmp_path / "again.urdf").write_text(write(given.robot))
    assert softdyn.parse(tmp_path / "again.urdf") == given.robot
    table = {"log_spiral": {
        "length_mm": 500, "mass_g": 200, "max_tension_N": 9, "radius_mm": 30, "ratio": 0.9,
        "joint_stiffness_Nm_rad": 1, "joint_damping_Nms_rad": 0.1,
    }, "mount": {"gravity_m_s2": list(TILTED)}}  # fmt: skip
    (tmp_path / "made.urdf").write_text(design.read(table).text)
    assert softdyn.parse(tmp_path / "made.urdf").gravity == TILTED


def test_export_and_back_keep_it_and_compare_names_another(tmp_path):
    (tmp_path / "stated.urdf").write_text(FILE)
    write_mjcf(tmp_path / "stated.urdf", tmp_path / "out.xml")
    assert tuple(mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml")).opt.gravity) == TILTED
    assert compare(tmp_path / "stated.urdf", tmp_path / "out.xml").passed
    write_urdf(tmp_path / "out.xml", tmp_path / "back.urdf")
    assert softdyn.parse(tmp_path / "back.urdf").gravity == TILTED
    other = compare(robots.write(tmp_path, robots.GRIPPER), tmp_path / "out.xml")
    assert not other.passed
    assert "gravity" in {cause.kind for cause in other.causes}


def test_a_run_under_it_is_the_twin_s_and_repeats(tmp_path):
    model = softdyn.load("finger", gravity=[0, 9.81, 0])
    assert model.bundled is None
    ours, twins = (rollout(model, [0.1, 0], 0.2, **more) for more in ({"plant": "model"}, {}))
    np.testing.assert_allclose(ours.q, twins.q, atol=1e-12)
    assert np.abs(rollout(softdyn.load("finger"), [0.1, 0], 0.2).q - twins.q).max() > 0.01
    law = Impedance(model, gains=Impedance(softdyn.load("finger")).gains)
    log = simulate(model, law, paper.set_point("finger", 0.5), duration=0.02)
    log.save(tmp_path / "run.npz")
    kept = Log.load(tmp_path / "run.npz")
    assert compare_runs(log, simulate(**experiment_of(kept.record, kept.source)[0])).equal


@pytest.mark.parametrize("wrong", [[0, -9.81], [0, 0, np.nan], 9.81, "down"])
def test_a_gravity_that_is_none_is_refused(wrong):
    with pytest.raises(InputError) as caught:
        softdyn.load("finger", gravity=wrong)
    assert caught.value.name == "gravity"


def test_two_statements_must_agree(tmp_path):
    (tmp_path / "stated.urdf").write_text(FILE)
    with pytest.raises(UrdfError):
        softdyn.load(tmp_path / "stated.urdf", gravity=[0, 0, -9.81])
    other = '<mujoco><option gravity="0 0 -9.81"/></mujoco><softdyn'
    with pytest.raises(UrdfError):
        robots.load(tmp_path, FILE.replace("<softdyn", other))
    for wrong in ("0 0", "0 0 nan", "0 0 down"):
        with pytest.raises(UrdfError):
            robots.load(tmp_path, FILE.replace("3 -4 -8", wrong))
