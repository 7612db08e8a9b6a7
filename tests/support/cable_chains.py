"""Random chains with springs whose cables rub, for loops in the model and in the twin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import softdyn
from softdyn import Robot, SoftModel
from softdyn.description.rig import Actuator
from softdyn.description.robot import JointTerm, Site, Tendon
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write

BODY = (
    '<inertial><origin xyz="{} 0 0"/><mass value="5e-4"/>'
    '<inertia ixx="2e-7" ixy="0" ixz="0" iyy="2e-7" iyz="0" izz="2e-7"/></inertial>'
)


def chain(axes: np.ndarray, piece: float, *, stiffness: float = 0.0, lag: float = 0.0) -> Robot:
    """A chain along x with a joint in the middle of each of its equal pieces.

    Parameters
    ----------
    axes : ndarray, (joints, 3)
        The joints' axes.
    piece : float
        Length of a piece (m).
    stiffness, lag : float
        Stiffness of each joint (N m/rad), and its damping over the stiffness (s).
    """
    links, joints = '<link name="l0"/>', ""
    for k, axis in enumerate(axes, 1):
        links += f'<link name="l{k}">{BODY.format(piece / 2)}</link>'
        joints += (
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="{piece if k > 1 else piece / 2} 0 0"/>'
            f'<axis xyz="{" ".join(map(str, axis))}"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
            f'<dynamics damping="{stiffness * lag}" stiffness="{stiffness}"/></joint>'
        )
    tip = f'<link name="tip"/><joint name="end" type="fixed"><parent link="l{len(axes)}"/>'
    tip += f'<child link="tip"/><origin xyz="{piece / 2} 0 0"/></joint>'
    robot = parse_text(f'<robot name="chain">{links}{tip}{joints}</robot>', path=Path("chain.urdf"))
    return replace(robot, task="tip")


def rubbing(name: str, mu: float = 0.1) -> SoftModel:
    """A bundled robot all of whose cables rub."""
    robot = softdyn.load(name).robot
    tendons = tuple(replace(tendon, friction=mu) for tendon in robot.tendons)
    return softdyn.build(replace(robot, tendons=tendons))


def pulled(robot: Robot, *tendons: Tendon) -> Robot:
    """The robot with tendons that one input each pulls; the force along it is u."""
    inputs = tuple(Actuator(f"u{k}", t.name, 1.0, -9.0, 9.0) for k, t in enumerate(tendons))
    return replace(robot, tendons=tendons, actuators=inputs)


def random_arm(seed: int, folder: Path) -> SoftModel:
    """An arm of 2 to 6 joints with one or two cables, fixed or over sites, read from its file.

    Only the first cable rubs. If more guides stick than there are joints, their friction is not
    determined, and neither is the motion that follows.
    """
    rng = np.random.default_rng(seed)
    n, piece = int(rng.integers(2, 7)), 0.04
    axes = np.array([[0.0, 1.0, 0.0] if rng.random() < 0.6 else [0, 0.6, 0.8] for _ in range(n)])
    robot = chain(axes, piece, stiffness=float(rng.uniform(0.4, 1.0)), lag=0.005)
    cables = []
    for c in range(int(rng.integers(1, 3))):
        mu = 0.0 if c else float(rng.uniform(0.05, 0.3))
        side = rng.choice([-1.0, 1.0])
        if rng.random() < 0.5:
            arms = side * rng.uniform(0.008, 0.015, n)
            terms = tuple(JointTerm(f"j{k + 1}", float(arm)) for k, arm in enumerate(arms))
            cables.append(Tendon(f"c{c}", terms, friction=mu))
            continue
        heights = side * rng.uniform(0.008, 0.015, n + 1)
        sites = tuple(
            Site(f"l{k}", (piece * share, 0.002 * side, float(heights[k])))
            for k in range(n + 1)
            for share in ((0.1,) if k == 0 else (0.2, 0.45))
        )
        cables.append(Tendon(f"c{c}", sites=sites, friction=mu))
    path = folder / f"arm_{seed}.urdf"
    path.write_text(write(pulled(robot, *cables)), encoding="utf-8")
    return softdyn.load(path)
