"""Files from public threads, each with its right value by hand or from MuJoCo's own model."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import statics
from softdyn.validation import compare
from softdyn.validation.mjcf.export import write_urdf

# google-deepmind/mujoco#928: two rotors drive the sum and the difference of two joints.
DIFFERENTIAL = """<mujoco><worldbody><body name="u">
  <joint name="bend" axis="0 1 0"/>
  <inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-5"/>
  <body name="v" pos="0 0 -0.1"><joint name="twist" axis="1 0 0"/>
    <inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-5"/></body></body></worldbody>
  <tendon>
    <fixed name="plus" {}><joint joint="bend" coef="1"/><joint joint="twist" coef="1"/></fixed>
    <fixed name="minus" {}><joint joint="bend" coef="1"/><joint joint="twist" coef="-1"/></fixed>
  </tendon></mujoco>"""

# google-deepmind/mujoco#971: a cable that cannot lengthen is a tendon with a range.
LEASH = """<mujoco><worldbody><site name="top"/><body name="bob" pos="0.1 0 0">
  <joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
  <joint name="z" type="slide" axis="0 0 1" range="-1 1" damping="0.4"/>
  <inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/><site name="loop"/></body>
  </worldbody>
  <tendon><spatial name="leash" limited="true" range="0 0.3"><site site="top"/><site site="loop"/>
  </spatial></tendon></mujoco>"""

# Yasu31/mjcf_urdf_simple_converter#1: several joints in one body, with ref, springref, eulerseq.
MULTI = """<mujoco><compiler angle="degree" eulerseq="zyx"/><worldbody>
  <body name="pelvis" pos="0 0 1" euler="10 20 30">
    <joint name="tx" type="slide" axis="1 0 0" range="-1 1"/>
    <joint name="rz" axis="0 0 1" pos="0.02 0.01 0" ref="15" range="-60 90" stiffness="3"
      springref="20" damping="0.1"/>
    <joint name="ry" axis="0 1 0.2" pos="-0.03 0 0.04" range="-60 60" armature="0.002"/>
    <joint name="rx" axis="1 0 0" pos="0 0.05 0" ref="-5" range="-30 45" stiffness="1.5"
      damping="0.2"/>
    <inertial pos="0.01 0.02 0.03" mass="1.5" fullinertia="0.01 0.012 0.015 0.001 -0.0005 0.0003"/>
    <site name="hip" pos="0.1 0 0"/>
    <body name="thigh" pos="0.1 0 -0.1" xyaxes="0 1 0 -1 0 0"><joint name="k1" axis="0 0 1"/>
      <joint name="k2" type="slide" axis="0 1 0" ref="0.02" range="-0.1 0.1" stiffness="50"
        springref="0.03"/>
      <inertial pos="0 0 -0.05" mass="0.4" diaginertia="0.002 0.002 0.0005"/>
      <site name="foot" pos="0 0 -0.2" euler="0 45 0"/></body></body></worldbody>
  <tendon><spatial name="strap" stiffness="20"><site site="hip"/><site site="foot"/></spatial>
  </tendon>
  <actuator><motor name="m_rz" joint="rz" gear="4" ctrlrange="-1 1"/>
    <motor name="m_k2" joint="k2" gear="-30" ctrlrange="-1 0.5"/></actuator></mujoco>"""


@pytest.mark.parametrize(("armatures", "off"), [((0.004, 0.004), 0.0), ((0.0, 0.008), -0.008)])
def test_rotors_on_a_sum_and_a_difference_are_never_lost_in_silence(tmp_path, armatures, off):
    bare, source, target = (tmp_path / name for name in ("bare.xml", "a.xml", "a.urdf"))
    bare.write_text(DIFFERENTIAL.format("", ""))
    source.write_text(DIFFERENTIAL.format(*(f'armature="{one}"' for one in armatures)))
    assert not compare(bare, source).passed
    result, lost = write_urdf(source, target)
    if not result.passed:
        assert any("armature" in line for line in lost)
        return
    model = softdyn.load(target)
    # by hand: links as two pendulums, plus Σ a JᵀJ
    links = np.diag([2e-4 + 0.1 * 0.05**2 + 0.1 * 0.15**2, 1e-4 + 0.1 * 0.05**2])
    right = links + np.array([[0.008, off], [off, 0.008]])
    assert pytest.approx(right, abs=1e-12) == model.state(model.q0, np.zeros(2)).M


def test_a_cable_that_cannot_lengthen_is_never_lost_in_silence(tmp_path):
    source = tmp_path / "leash.xml"
    source.write_text(LEASH)
    result, lost = write_urdf(source, tmp_path / "leash.urdf")
    assert not result.passed
    assert any("'leash'" in line and "tendon_range" in line for line in lost)


def test_several_joints_of_one_body_accelerate_as_in_mujoco(tmp_path):
    source, target = tmp_path / "multi.xml", tmp_path / "multi.urdf"
    source.write_text(MULTI)
    result, _ = write_urdf(source, target)
    assert result.passed, str(result)
    model, engine = softdyn.load(target), mujoco.MjModel.from_xml_path(str(source))
    engine.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, rng = mujoco.MjData(engine), np.random.default_rng(0)
    at = [engine.joint(name).qposadr[0] for name in model.joint_names]
    for _ in range(3):
        coordinates, v = rng.uniform(-0.5, 0.5, model.nv), rng.normal(size=model.nv)
        u = rng.uniform(-0.4, 0.4, 2)
        data.qpos[at], data.qvel[at], data.ctrl[:] = coordinates, v, u
        mujoco.mj_forward(engine, data)
        found = model.forward_dynamics(model.configuration(coordinates), v, u)
        assert found == pytest.approx(data.qacc[at], abs=1e-9 * np.abs(data.qacc).max())


def test_a_tentacle_of_balls_rests_where_mujoco_s_does(tmp_path):
    """google-deepmind/mujoco#1058 and public SpiRobs: it pulls by a negative input."""
    bodies = "".join(
        f'<body name="s{k}" pos="0 0 {-0.03 * (k > 0)}"><joint name="b{k}" type="ball"'
        ' stiffness="0.05" damping="0.002"/><inertial pos="0 0 -0.015" mass="0.01"'
        f' diaginertia="1e-6 1e-6 5e-7"/><site name="c{k + 1}" pos="0 0.01 -0.02"/>'
        for k in range(6)
    )
    sites = "".join(f'<site site="c{k}"/>' for k in range(7))
    source, target = tmp_path / "tentacle.xml", tmp_path / "tentacle.urdf"
    source.write_text(
        f'<mujoco><worldbody><site name="c0" pos="0 0.01 0"/>{bodies}{"</body>" * 6}</worldbody>'
        f'<tendon><spatial name="cable">{sites}</spatial></tendon><actuator><motor name="pull"'
        ' tendon="cable" gear="1" ctrllimited="true" ctrlrange="-5 0"/></actuator></mujoco>'
    )
    result, _ = write_urdf(source, target)
    assert result.passed, str(result)
    model = softdyn.load(target)
    engine = mujoco.MjModel.from_xml_path(str(source))
    engine.dof_damping[:] = 0.02  # which no rest depends on
    engine.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(engine)
    data.ctrl[:] = -2.0
    mujoco.mj_step(engine, data, 8000)
    found = model.link_poses(statics.settle(model, np.array([-2.0])).q)["s5"]
    assert abs(data.body("s5").xpos[1]) > 0.03  # it bends
    assert found[:3, 3] == pytest.approx(data.body("s5").xpos, abs=1e-7)
