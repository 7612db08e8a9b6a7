"""Serial chains with any number of joints and inputs, for measurements of scaling."""

from __future__ import annotations

import math

import numpy as np

from softdyn.description.inertia import Inertia
from softdyn.description.robot import Joint, JointTerm, Tendon
from softdyn.description.urdf_writer import write
from softdyn.design.chain import Chain, Input

LENGTH, MASS = 0.5, 0.3  # m, kg of the whole chain
RADIUS = 0.02  # m, moment arms of the tendons
STIFFNESS, DAMPING = 0.04, 0.01  # N·m/rad and N·m·s/rad of a joint, each times their number
ARMATURE = 1e-3  # kg·m²
GOLDEN = math.pi * (3 - math.sqrt(5))  # rad between tendons, so that no two have the same direction


def chain_urdf(joints: int, tendons: int = 3) -> str:
    """A hanging chain of `joints` hinges, about x and y in turn, with springs and dampers.

    Joint stiffness and damping grow with the number of joints, so that all chains bend alike. There
    are `tendons` fixed tendons with constant moment arms, in directions a golden angle apart.
    Tendon k of m ends at (k + 1)/m of the length, so that B has rank m for n ≥ 2 m.
    """
    chain = Chain(f"chain{joints}", " A chain for measuring step times. ", {})
    offset, mass = LENGTH / joints, MASS / joints
    moment = mass * (offset**2 / 12 + RADIUS**2 / 4)
    tensor = np.diag([moment, moment, mass * RADIUS**2 / 2])
    body = Inertia(mass, np.array([0.0, 0.0, -offset / 2]), tensor)
    for i in range(joints):
        joint = Joint(
            f"joint{i}", "revolute", direction=(i % 2, 1 - i % 2, 0), lower=-2, upper=2,
            stiffness=STIFFNESS * joints, damping=DAMPING * joints, armature=ARMATURE / joints,
        )  # fmt: skip
        chain.add(f"link{i}", body, (), [joint], (0, 0, -offset if i else 0))
    for k in range(tendons):
        reach = min(max(2, math.ceil(joints * (k + 1) / tendons)), joints)
        arms = (RADIUS * math.cos(k * GOLDEN), RADIUS * math.sin(k * GOLDEN))
        terms = [JointTerm(f"joint{i}", arms[i % 2]) for i in range(reach) if arms[i % 2]]
        chain.pull(Tendon(f"tendon{k}", tuple(terms)), Input(-1.0, (-20, 20)))
    return write(chain.finish((0, 0, -offset)))
