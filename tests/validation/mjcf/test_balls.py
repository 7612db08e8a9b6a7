"""Chains of ball joints on hinges, against MuJoCo's own ball joints in the source file."""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import UrdfError, design, statics
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.dynamics import ForceBalance
from softdyn.dynamics.mimic import build
from softdyn.validation import compare, crosscheck
from softdyn.validation.mjcf.export import write_mjcf, write_urdf
from softdyn.validation.mjcf.scene import Scene
from softdyn.validation.twin.twin import Twin
from tests.support.command import command
from tests.support.refused import refused

COUNT = 20
STENCIL = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])  # of an 8th-order central difference
PULLS = np.array([3.0, 1.5])


def tentacle(count: int, more: str = "") -> str:
    """A hanging chain of bodies that are turned at zero, with two cables beside its axis."""
    bodies, sites = "", [[f"c{k}_0" for k in range(2)]]
    world = "".join(
        f'<site name="c{k}_0" pos="{0.02 * (k == 0)} {0.02 * (k == 1)} 0"/>' for k in range(2)
    )
    for n in range(1, count + 1):
        size = 0.8 + 0.4 * n / count
        bodies += (
            f'<body name="s{n}" pos="{0.001 * (n > 1)} 0 {-0.03 * (n > 1)}" euler="0.05 -0.04 0.2">'
            f'<joint name="b{n}" type="ball" stiffness="{0.25 * size} 0.1 0.2" damping="0.02"'
            f'{more}/><inertial pos="0.003 -0.002 -0.015" mass="{0.01 * size}"'
            ' diaginertia="2e-6 2.5e-6 1.5e-6"/>'
        )
        bodies += "".join(
            f'<site name="c{k}_{n}" pos="{0.018 * (k == 0)} {0.018 * (k == 1)} -0.02"/>'
            for k in range(2)
        )
        sites.append([f"c{k}_{n}" for k in range(2)])
    cables = "".join(
        f'<spatial name="cable{k}">{"".join(f"<site site={row[k]!r}/>" for row in sites)}</spatial>'
        for k in range(2)
    )
    pulls = "".join(
        f'<general name="pull{k}" tendon="cable{k}" gear="-1" ctrllimited="true" ctrlrange="0 5"/>'
        for k in range(2)
    )
    return (
        f'<mujoco><compiler angle="radian"/><worldbody>{world}{bodies}{"</body>" * count}'
        f"</worldbody><tendon>{cables}</tendon><actuator>{pulls}</actuator></mujoco>"
    )


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    folder = tmp_path_factory.mktemp("balls")
    source, target = folder / "chain.xml", folder / "chain.urdf"
    source.write_text(tentacle(COUNT))
    comparison, _ = write_urdf(source, target)
    assert comparison.passed, str(comparison)
    return mujoco.MjModel.from_xml_path(str(source)), softdyn.load(target), source, target


class Balls:
    """MuJoCo's own ball joints in the states of the model with hinges."""

    def __init__(self, native: mujoco.MjModel, model: softdyn.SoftModel) -> None:
        self.native, self.model, self.data = native, model, mujoco.MjData(native)
        mujoco.mj_kinematics(native, self.data)
        # bodies of the exported file have the axes of the root at zero
        self.zeros = {native.body(k).name: self.data.xmat[k].reshape(3, 3).copy()
                      for k in range(1, native.nbody)}  # fmt: skip

    def turns(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Orientations of MuJoCo's bodies."""
        poses = self.model.link_poses(q)
        return {name: poses[name][:3, :3] @ zero for name, zero in self.zeros.items()}

    def qpos(self, q: np.ndarray) -> np.ndarray:
        found, turns, above = [], self.turns(q), np.eye(3)
        for k in range(1, self.native.nbody):
            own = np.zeros(9)
            mujoco.mju_quat2Mat(own, self.native.body_quat[k])
            quaternion, turn = np.zeros(4), turns[self.native.body(k).name]
            mujoco.mju_mat2Quat(quaternion, ((above @ own.reshape(3, 3)).T @ turn).ravel())
            found.append(quaternion)
            above = turn
        return np.concatenate(found)

    def rates(self, q: np.ndarray) -> np.ndarray:
        """The map of q̇ to MuJoCo's q̇: relative angular velocities in the bodies' axes."""
        rows, above = [], np.zeros((3, self.model.nv))
        for name, turn in self.turns(q).items():
            own = self.model.link_jacobian(q, name)[3:]
            rows.append(turn.T @ (own - above))
            above = own
        return np.vstack(rows)


def test_a_chain_of_balls_accelerates_as_mujoco_s_own(chain) -> None:
    native, model, _, _ = chain
    balls, rng, data = Balls(native, model), np.random.default_rng(1), mujoco.MjData(native)
    for _ in range(3):
        coordinates, v = rng.uniform(-0.6, 0.6, model.nv), rng.normal(size=model.nv)
        q, step = model.configuration(coordinates), 1e-2
        W = balls.rates(q)
        turning = sum(
            c * (balls.rates(model.integrate(q, k * step * v)) @ v
                 - balls.rates(model.integrate(q, -k * step * v)) @ v) / step
            for k, c in enumerate(STENCIL, 1)
        )  # fmt: skip
        data.qpos[:], data.qvel[:], data.ctrl[:] = balls.qpos(q), W @ v, PULLS
        mujoco.mj_forward(native, data)
        ours = W @ model.forward_dynamics(q, v, PULLS) + turning
        assert np.abs(ours - data.qacc).max() < 1e-10 * np.abs(data.qacc).max()


def test_a_chain_of_balls_rests_where_mujoco_s_own_does(chain) -> None:
    native, model, _, _ = chain
    found = statics.settle(model, PULLS)
    data = mujoco.MjData(native)
    native = copy.copy(native)
    native.opt.timestep = 5e-3
    native.dof_damping[:] = 0.2  # which no rest depends on
    native.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data.ctrl[:] = PULLS
    mujoco.mj_step(native, data, 5000)
    assert np.abs(data.qvel).max() < 1e-9
    places = data.xpos[1:] - data.xpos[1:].mean(axis=0)
    assert np.linalg.svd(places, compute_uv=False).min() > 0.05  # bent in space, m
    for name, turn in Balls(native, model).turns(found.q).items():
        gap = turn.T @ data.body(name).xmat.reshape(3, 3)
        assert np.abs(gap - np.eye(3)).max() < 1e-6


def test_both_engines_and_both_formats_agree(tmp_path) -> None:
    source, target, back = (tmp_path / name for name in ("a.xml", "a.urdf", "b.xml"))
    source.write_text(tentacle(3))
    write_urdf(source, target)
    model = softdyn.load(target)
    assert parse_text(write(model.robot), path=target) == model.robot
    found = crosscheck(model, samples=3, trajectories=False)
    assert found.passed, str(found)
    (check,) = [check for check in found.checks if check.quantity == "F"]
    assert check.tolerance <= 1e-10
    comparison, lost = write_mjcf(target, back)
    assert comparison.passed
    assert not lost
    assert compare(source, back).passed
    assert command("compare", source, target, "--engines", "--samples", 1).code == 0
    with refused("a.xml", "b1, b2, b3"):
        Scene(model, source)
    assert (mujoco.MjModel.from_xml_path(str(back)).jnt_type == mujoco.mjtJoint.mjJNT_BALL).all()


def test_the_twin_moves_as_mujoco_s_own(tmp_path) -> None:
    source, target = tmp_path / "a.xml", tmp_path / "a.urdf"
    light = tentacle(3).replace('damping="0.02"', 'damping="0.001"')
    source.write_text(light.replace("<mujoco>", '<mujoco><option integrator="RK4"/>'))
    write_urdf(source, target)
    native, step = mujoco.MjModel.from_xml_path(str(source)), 1e-4
    native.opt.timestep = step
    data = mujoco.MjData(native)
    data.ctrl[:] = PULLS
    mujoco.mj_step(native, data, 300)
    for integrator, most in (("rk4", 1e-9), ("implicitfast", 1e-3)):
        twin = Twin(target, timestep=step, integrator=integrator)
        twin.advance(PULLS, 300)
        moved = data.body("s3").xpos - twin.data.body("s3").xpos
        assert np.abs(moved).max() < most


def test_its_derivatives_and_energy_are_those_of_the_force(chain) -> None:
    _, model, _, _ = chain
    rng, n, step = np.random.default_rng(3), model.nv, 1e-6
    coordinates, v = rng.uniform(-1.0, 1.0, n), rng.normal(size=n)
    coordinates[:3] *= 1e-3  # where the formulas are series
    q, moves = model.configuration(coordinates), step * np.eye(n)
    sides = [[model.integrate(q, s * dq) for s in (1, -1)] for dq in moves]
    by_q = [np.subtract(*(model.forces_at(x, v) for x in side)) / (2 * step) for side in sides]
    by_v = [(model.forces_at(q, v + dv) - model.forces_at(q, v - dv)) / (2 * step) for dv in moves]
    rate = [np.subtract(*(model.forces_energy(x) for x in side)) / (2 * step) for side in sides]
    exact = model.force_derivatives(q, v)
    for found, right in zip((by_q, by_v), exact, strict=True):
        assert np.abs(np.array(found).T - right).max() < 1e-8 * np.abs(right).max()
    a, u, state = rng.normal(size=n), PULLS, model.state(q, v)
    balance = ForceBalance(model)(q, v, a, u).residual
    assert balance == pytest.approx(state.M @ a + state.h - state.B @ u, abs=1e-12)
    assert -model.forces_at(q, 0 * v) == pytest.approx(np.array(rate), abs=1e-8)


def test_an_armature_of_a_ball_is_refused(tmp_path) -> None:
    source = tmp_path / "a.xml"
    source.write_text(tentacle(2, ' armature="1e-5"'))
    with refused("<joint name='b1'>", by=UrdfError):
        write_urdf(source, tmp_path / "a.urdf")
    assert not (tmp_path / "a.urdf").exists()


def test_other_laws_of_a_ball_make_the_files_differ(tmp_path) -> None:
    for more in (' range="0 0.5" limited="true"', ' frictionloss="0.1"'):
        source = tmp_path / "a.xml"
        source.write_text(tentacle(2, more))
        comparison, lost = write_urdf(source, tmp_path / "a.urdf")
        assert not comparison.passed
        assert len(lost) >= 4


def test_balls_survive_attach_and_free_balls_turn_on(tmp_path) -> None:
    source, target = tmp_path / "a.xml", tmp_path / "a.urdf"
    source.write_text(tentacle(2))
    write_urdf(source, target)
    robot = softdyn.load(target).robot
    free = build(replace(robot, balls=()))
    assert not free.forced
    assert free.nv == 6
    both = parse_text(design.attach(robot, robot, "s2", prefix="on_").text, path=target)
    assert [ball.joints[0] for ball in both.balls[2:]] == [
        f"on_{ball.joints[0]}" for ball in robot.balls
    ]
    source.write_text(tentacle(2).replace('stiffness="0.25 0.1 0.2"', ""))
    write_urdf(source, target)
    assert {joint.kind for joint in softdyn.load(target).robot.moving_joints} == {
        "continuous", "revolute",
    }  # fmt: skip
