"""The neutral form rebuilt for MuJoCo: against Pinocchio, the user's own model, and an oracle."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn.description.inertia import Inertia
from softdyn.exceptions import UrdfError
from softdyn.validation import compare
from softdyn.validation.crosschecks.engines import engine_errors
from softdyn.validation.mjcf.comparison.dynamics import (
    QUANTITIES,
    evaluate,
    misreading,
    random_states,
    relative_errors,
)
from softdyn.validation.mjcf.comparison.from_mjcf import compile_mjcf, from_mjcf
from softdyn.validation.mjcf.comparison.side import Side, neutral
from softdyn.validation.mjcf.mjcf_file import read_mjcf
from tests.support import mjcf_features, robots
from tests.support import neutral_terms as oracle
from tests.support.refused import refused

WALKER = """
<mujoco>
  <compiler angle="degree" eulerseq="zyx"/>
  <default><joint armature="0.01" damping="0.2"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="trunk" pos="0 0 1" euler="20 30 40">
      <freejoint/>
      <geom type="box" size="0.2 0.1 0.05" density="700"/>
      <body name="pack" pos="0 0 0.1"><geom size="0.05" mass="0.3" pos="0.01 0 0"/></body>
      <body name="leg" pos="0.2 0.05 0" euler="0 45 0">
        <joint name="hip" axis="1 2 0" pos="0 0 0.01" range="-40 60" ref="5"/>
        <joint name="slide" type="slide" axis="0 0 1" range="-0.1 0.2"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0 0.05 -0.3" density="900"/>
        <site name="end" pos="0 0.05 -0.3"/>
      </body>
    </body>
  </worldbody>
  <option gravity="1 2 -9"/>
</mujoco>
"""


@pytest.mark.parametrize("name", ["finger", "helix", "spirob"])
def test_a_urdf_against_the_model(name):
    model, robot = softdyn.load(name), neutral(name)
    states = random_states(robot, 3, 0)
    terms = evaluate(robot, states)
    names = [part.name for part in robot.parts]
    order = [names.index(joint) for joint in model.joint_names]
    found = dict(zip((c.name for c in robot.cables), terms.lengths.T, strict=True))
    for k in range(3):
        q = np.array([q[k, 0] for q in states.q])[order]
        state = model.state(q, states.v[k][order])
        pairs = [
            (state.M, terms.M[k][np.ix_(order, order)]),
            (state.bias, terms.bias[k][order]),
            (state.g, terms.g[k][order]),
            (state.lengths, np.array([found[t.name][k] for t in model.robot.tendons])),
        ]
        for expected, got in pairs:
            np.testing.assert_allclose(got, expected, atol=1e-12 * np.abs(expected).max())


BALL = """
<mujoco>
  <worldbody>
    <body pos="0 0 1" euler="30 40 50">
      <joint type="ball" pos="0 0.1 0" armature="0.02"/><geom size="0.1 0.2 0.3" type="box"/>
      <body pos="0.1 0.2 0.3" quat="1 2 3 4">
        <joint axis="1 2 3"/><joint axis="0 1 0" type="slide"/>
        <geom size="0.1 0.1 0.2" type="box" pos="0.1 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


MASSES = """
<mujoco><worldbody>
  <body name="held" gravcomp="0.6" pos="0 0 1"><joint name="a" axis="0 1 0" armature="1e-3"/>
    <inertial pos="0.1 0 0" mass="0.5" diaginertia="1e-3 2e-3 2e-3"/>
    <site name="s" pos="0.05 0.02 0"/>
    <body gravcomp="1.5" pos="0.1 0 0">
      <inertial pos="0 0.1 0" mass="0.2" diaginertia="1e-4 2e-4 2e-4"/></body>
    <body pos="0.2 0 0"><joint name="b" axis="1 0 0"/><joint name="c" type="slide" axis="0 1 1"/>
      <inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 2e-3 2e-3"/>
      <site name="t" pos="0 0 0.1"/></body>
    <body pos="0 0.3 0"><joint name="d"/>
      <inertial pos="0 0 0.1" mass="0.4" diaginertia="1e-3 2e-3 2e-3"/></body>
  </body>
  <site name="u" pos="0.3 0 0.2"/>
</worldbody>
<tendon>
  <spatial name="path" armature="0.3"><site site="u"/><site site="s"/><pulley divisor="3"/>
    <site site="s"/><site site="t"/></spatial>
  <fixed name="sum" armature="0.2"><joint joint="b" coef="2"/><joint joint="d" coef="-1"/></fixed>
</tendon></mujoco>
"""


@pytest.mark.parametrize("text", [WALKER, BALL, MASSES, mjcf_features.BASE])
def test_an_mjcf_against_the_users_own_model_and_the_oracle(tmp_path, text):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    model, robot = compile_mjcf(read_mjcf(path)), neutral(path)
    states = random_states(robot, 4, 1)
    assert max(misreading(robot, model, states).values()) < 1e-14
    _as_the_oracle(robot, states)


def _as_the_oracle(robot, states):
    ours, theirs = evaluate(robot, states), oracle.evaluate(robot, states)
    assert max(relative_errors(ours, theirs).values()) < 1e-13
    np.testing.assert_allclose(ours.tips, theirs.tips, atol=1e-14)
    np.testing.assert_allclose(ours.lengths, theirs.lengths, atol=1e-14)
    np.testing.assert_allclose(ours.arms, theirs.arms, atol=1e-14)


@pytest.mark.parametrize(
    ("mass", "moments"),
    [(1.0, (1e-3, 1e-3, 9e-3)), (1e-20, (1e-25, 1e-25, 1e-25)), (0.0, (0, 0, 0))],
)
def test_inertias_that_mujocos_compiler_refuses_are_measured(tmp_path, mass, moments):
    """Impossible moments (A + B < C), a negligible mass, none at all."""
    robot = neutral(robots.write(tmp_path, robots.GRIPPER))
    for k in range(len(robot.parts)):
        body = Inertia(mass, np.array([0.1, 0.2, 0.3]), np.diag(moments))
        changed = replace(robot.parts[k], pieces=(("body", body),), armature=0.0)
        _as_the_oracle(robot.with_part(k, changed), random_states(robot, 2, 0))


def test_a_cable_beside_a_joint_by_less_than_a_micrometre(tmp_path):
    """MuJoCo takes such a site for the body's frame, unless it is told not to."""
    path = tmp_path / "robot.xml"
    path.write_text(MASSES)
    robot = neutral(path)
    (cable, *others), (first, point, *rest) = robot.cables, robot.cables[0].path
    joint = robot.parts[point.part].point
    beside = replace(cable, path=(first, replace(point, xyz=joint + 3e-7), *rest))
    _as_the_oracle(replace(robot, cables=(beside, *others)), random_states(robot, 2, 0))


def test_a_misread_file_is_an_error(tmp_path):
    """A mass that is wrong in its tenth digit."""
    path = tmp_path / "robot.xml"
    path.write_text(WALKER)
    side = Side.of(path)
    part = side.neutral.parts[0]
    name, piece = part.pieces[0]
    heavier = ((name, replace(piece, mass=piece.mass * (1 + 1e-10))), *part.pieces[1:])
    wrong = side.neutral.with_part(0, replace(part, pieces=heavier))
    side.__dict__["neutral"] = wrong
    with refused("<mujoco>", by=UrdfError):
        compare(side, "finger")


def test_each_file_in_its_own_engine(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(WALKER)
    errors = engine_errors(path, samples=3)
    assert errors.keys() == set(QUANTITIES)
    assert max(errors.values()) < 1e-13
    assert max(engine_errors("spirob", samples=3).values()) < 1e-12
    assert engine_errors(robots.write(tmp_path, robots.GRIPPER)) == {}


def test_jacobian_is_the_derivative_of_the_tip(tmp_path):
    robot = neutral(robots.write(tmp_path, robots.GRIPPER))
    states = random_states(robot, 2, 0)
    terms = evaluate(robot, states)
    step = 1e-6
    for k in range(robot.nv):
        ends = []
        for sign in (1, -1):
            q = [q + sign * step * (m == k) for m, q in enumerate(states.q)]
            ends.append(evaluate(robot, type(states)(tuple(q), states.v)).tips)
        slope = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(terms.J[..., k], slope, atol=1e-8)


def test_a_file_of_a_catalogue_name():
    assert neutral("panda").format == "urdf"
    assert isinstance(neutral("finger").path, Path)


DRIVES = """
<mujoco><worldbody>
  <body><joint name="a" axis="0 1 0"/><geom size="0.1"/>
    <body pos="0 0 1"><joint name="b" axis="0 1 0"/><geom size="0.1"/></body></body>
</worldbody>
<tendon><fixed name="t" damping="{damping}"><joint joint="a" coef="1"/></fixed></tendon>
<equality><joint joint1="b" joint2="a" polycoef="0 2 0 0 0" active="{active}"/></equality>
<actuator><motor joint="a" gear="-3" forcelimited="true" forcerange="-2 1"/></actuator></mujoco>
"""


@pytest.mark.parametrize("active", ["true", "false"])
def test_drives_as_mujoco_computes_them(tmp_path, active):
    """Largest torque, tendon damping and what holds from the start: against one step of MuJoCo."""
    path = tmp_path / "drives.xml"
    path.write_text(DRIVES.format(damping=0.2, active=active))
    model, robot = compile_mjcf(read_mjcf(path)), neutral(path)
    data = mujoco.MjData(model)
    data.ctrl[:], data.qvel[:] = -100.0, [0.5, 0.0]
    mujoco.mj_forward(model, data)
    assert robot.parts[0].effort == abs(data.qfrc_actuator[0]) == 6.0
    damping = robot.cables[0].damping
    np.testing.assert_allclose(data.qfrc_passive, [-damping * 0.5, 0.0], rtol=1e-12)
    assert len(robot.couplings) == data.ne == (active == "true")


def test_another_damping_of_a_tendon_is_a_cause(tmp_path):
    files = tmp_path / "a.xml", tmp_path / "b.xml"
    for path, damping in zip(files, (0.2, 0.3), strict=True):
        path.write_text(DRIVES.format(damping=damping, active="true"))
    (cause,) = compare(*files).causes
    assert (cause.kind, cause.where, cause.a, cause.b) == ("tendon", "t", 0.2, 0.3)
    assert cause.detail == "damping"


REFERENCES = """<mujoco><compiler angle="radian"/><worldbody>
<body name="a"><joint name="x" axis="0 1 0" ref="{x}"/>
<inertial pos="0 0 0.1" mass="1" diaginertia="1e-2 1e-2 1e-2"/>
<body name="b" pos="0 0 0.2"><joint name="y" type="slide" axis="1 0 0" ref="{y}"/>
<inertial pos="0 0 0.1" mass="1" diaginertia="1e-2 1e-2 1e-2"/></body></body></worldbody>
<equality><joint joint1="y" joint2="x" polycoef="{polycoef}"/></equality></mujoco>"""


@pytest.mark.parametrize(
    "polycoef", ["0.1 -0.7 0 0 0", "0.1 -0.7 0.4 0.3 -0.2"], ids=["linear", "of 4th power"]
)
@pytest.mark.parametrize(("x", "y"), [(0.3, -0.2), (-0.5, 0), (0, 0.4)])
def test_an_equality_of_joints_with_references(tmp_path, polycoef, x, y):
    """MuJoCo's own residual at random states; it takes the polynomial about the references."""
    path = tmp_path / "ref.xml"
    path.write_text(REFERENCES.format(x=x, y=y, polycoef=polycoef))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    robot = from_mjcf(path, model)
    if robot.couplings:
        (tie,) = robot.couplings
        row = [tie.offset, tie.multiplier]
    else:
        (tie,) = robot.equalities
        row = tie.data
    for q in np.random.default_rng(0).uniform(-1, 1, (5, 2)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        assert q[1] - np.polynomial.polynomial.polyval(q[0], row) == pytest.approx(data.efc_pos[0])
