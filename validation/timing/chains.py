"""Serial chains of any number of joints and inputs: robots for scaling, not for looking at."""

from __future__ import annotations

import math

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
    offset, mass = LENGTH / joints, MASS / joints
    moment = mass * (offset**2 / 12 + RADIUS**2 / 4)
    parts = [f'<robot name="chain{joints}"><link name="world"/>']
    for i in range(joints):
        parent = "world" if i == 0 else f"link{i - 1}"
        axis = "1 0 0" if i % 2 else "0 1 0"
        parts.append(
            f'<link name="link{i}"><inertial><origin xyz="0 0 {-offset / 2:.9g}"/>'
            f'<mass value="{mass:.9g}"/><inertia ixx="{moment:.9g}" ixy="0" ixz="0" '
            f'iyy="{moment:.9g}" iyz="0" izz="{mass * RADIUS**2 / 2:.9g}"/></inertial></link>'
            f'<joint name="joint{i}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link{i}"/><origin xyz="0 0 {-offset * (i > 0):.9g}"/>'
            f'<axis xyz="{axis}"/><limit lower="-2" upper="2" effort="100" velocity="100"/>'
            f'<dynamics damping="{DAMPING * joints:.9g}"/></joint><gazebo reference="joint{i}">'
            f"<springStiffness>{STIFFNESS * joints:.9g}</springStiffness></gazebo>"
        )
    parts.append(
        f'<link name="tip"/><joint name="end" type="fixed"><parent link="link{joints - 1}"/>'
        f'<child link="tip"/><origin xyz="0 0 {-offset:.9g}"/></joint><softdyn version="1">'
    )
    parts += [f'<joint name="joint{i}" armature="{ARMATURE / joints:.9g}"/>' for i in range(joints)]
    for k in range(tendons):
        last = max(2, math.ceil(joints * (k + 1) / tendons))
        arms = (RADIUS * math.cos(k * GOLDEN), RADIUS * math.sin(k * GOLDEN))
        terms = "".join(
            f'<joint name="joint{i}" coef="{arms[i % 2]:.9g}"/>'
            for i in range(min(last, joints))
            if arms[i % 2]
        )
        parts.append(f'<tendon name="tendon{k}">{terms}</tendon>')
    parts += [
        f'<actuator name="u{k}" tendon="tendon{k}" gear="-1" lower="-20" upper="20"/>'
        for k in range(tendons)
    ]
    return "".join(parts) + '<task frame="tip"/></softdyn></robot>'
