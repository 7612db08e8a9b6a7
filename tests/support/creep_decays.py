"""Angles of one joint with a creeping spring, measured under a step of torque and after it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softdyn import SoftModel
from softdyn.dynamics.mimic import build
from softdyn.identification import Measurements, choose_unknowns, identify
from softdyn.validation import Twin
from tests.support import robots

SHARE, TIME = 0.2, 0.8  # of the instantaneous stiffness; s
TORQUE, HELD, LONG = 3.0, 2.0, 4.0  # N m; s under the torque, and in all
PERIOD, NOISE, WRONG = 0.08, 5e-3, 1.3  # s, rad, factor of the first guess
ROTOR, DAMPING = 0.2, 0.4  # kg m², N m s/rad; a joint that swings at 3 rad/s
UNKNOWNS = ("relaxation_share", "relaxation_time", "stiffness", "damping")


def spring_hinge() -> SoftModel:
    """A joint about the vertical on a spring, with a unit gear on its angle."""
    return robots.build(robots.hinge(
        1, None, "1 1 0.01", axis="0 0 1", limit=(-3, 3), stiffness=2.0, pull=(-9, 9)
    ))  # fmt: skip


def creeping(model: SoftModel, share: float = SHARE, time: float = TIME) -> SoftModel:
    """The robot with one branch beside each spring."""
    joints = tuple(
        replace(
            one,
            armature=ROTOR,
            damping=DAMPING,
            relaxation=((share / (1 - share) * one.stiffness, time),),
        )
        for one in model.robot.moving_joints
    )
    fixed = tuple(one for one in model.robot.joints if not one.moves)
    return build(replace(model.robot, joints=fixed + joints))


def decay(model: SoftModel, seed: int) -> Measurements:
    """The angle of a robot of one joint, measured under a step of torque and after it."""
    model = creeping(model)
    twin, steps = Twin(model, timestep=PERIOD / 20, integrator="rk4"), round(LONG / PERIOD)
    t = PERIOD * np.arange(steps)
    u = np.where(t < HELD, TORQUE, 0.0)[:, None]
    q = np.empty((steps, 1))
    for k in range(steps):
        q[k] = twin.qpos
        twin.advance(u[k], 20)
    noise = NOISE * np.random.default_rng(seed).normal(size=q.shape)
    return Measurements(t, u, (f"q.{model.joint_names[0]}",), q + noise)


def fitted(model: SoftModel, data: Measurements) -> dict[str, bool]:
    """Whether the interval of each kind of unknown holds the truth, from a wrong first guess."""
    truth = dict(zip(UNKNOWNS, (SHARE, TIME, model.stiffness[0], DAMPING), strict=True))
    guess = creeping(model, SHARE * WRONG, TIME * WRONG)
    found = identify(guess, data, choose_unknowns(guess, UNKNOWNS), hold_out=0.0)
    return {
        one.parameter.kind.name: bool(
            one.identified and abs(one.value - truth[one.parameter.kind.name]) <= one.half
        )
        for one in found.estimates
    }
