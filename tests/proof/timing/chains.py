"""Serial chains of any number of joints and inputs: robots for scaling, not for looking at."""

from __future__ import annotations

import math

from softdyn.design.urdf_text import ORIGIN, Input, Joint, Robot, inertial, over

LENGTH, MASS = 0.5, 0.3  # m, kg of the whole chain
RADIUS = 0.02  # m, the tendons' arms
STIFFNESS, DAMPING = 0.04, 0.01  # N·m/rad and N·m·s/rad of a joint, each times their number
ARMATURE = 1e-3  # kg·m²
GOLDEN = math.pi * (3 - math.sqrt(5))  # rad between tendons: no two in one direction


def chain_urdf(joints: int, tendons: int = 3) -> str:
    """A hanging chain of `joints` hinges, about x and y in turn, with springs and dampers.

    Joint stiffness and damping grow with the number of joints, so that all chains bend alike. The
    tendons are fixed ones with constant arms, `tendons` of them in directions a golden angle
    apart; tendon k of m ends (k + 1) m-ths of the way down, so that B has rank m where n ≥ 2 m.
    """
    robot = Robot(f"chain{joints}", " A chain for measuring step times. ", {}, ())
    offset, mass = LENGTH / joints, MASS / joints
    moment = mass * (offset**2 / 12 + RADIUS**2 / 4)
    tensor = ((moment, 0.0, 0.0), (0.0, moment, 0.0), (0.0, 0.0, mass * RADIUS**2 / 2))
    for i in range(joints):
        joint = Joint(
            f"joint{i}", (i % 2, 1 - i % 2, 0), STIFFNESS * joints, DAMPING * joints,
            limits=(-2, 2), armature=ARMATURE / joints,
        )  # fmt: skip
        part = inertial(mass, (0, 0, -offset / 2), tensor)
        robot.add(f"link{i}", [part], [joint], (0, 0, -offset if i else 0))
    over_joints = {}
    for k in range(tendons):
        reach = min(max(2, math.ceil(joints * (k + 1) / tendons)), joints)
        arms = (RADIUS * math.cos(k * GOLDEN), RADIUS * math.sin(k * GOLDEN))
        parts = [over(f"joint{i}", arms[i % 2]) for i in range(reach) if arms[i % 2]]
        over_joints[f"tendon{k}"] = parts
    inputs = [Input(-1.0, (-20, 20))] * tendons
    return robot.finish((0, 0, -offset), ORIGIN, over_joints, *inputs)
