"""Random chains with springs whose cables rub, for loops in the model and in the twin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import softdyn
from softdyn import Robot, SoftModel
from softdyn.description.rig import Actuator
from softdyn.description.robot import JointTerm, Site, Tendon
from softdyn.description.urdf_writer import write
from tests.support import robots


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
    parts = [robots.link("l0")]
    for k, axis in enumerate(axes, 1):
        at = f"{piece if k > 1 else piece / 2} 0 0"
        parts += [
            robots.link(f"l{k}", 5e-4, f"{piece / 2} 0 0", 2e-7),
            robots.joint(
                f"j{k}", f"l{k - 1}", f"l{k}", " ".join(map(str, axis)), at=at, limit=(-3, 3),
                effort=1, damping=stiffness * lag, stiffness=stiffness,
            ),
        ]  # fmt: skip
    parts += [robots.link("tip"), robots.weld(f"l{len(axes)}", "tip", f"{piece / 2} 0 0")]
    robot = robots.build(robots.robot("chain", *parts)).robot
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
    return softdyn.load(robots.write(folder, write(pulled(robot, *cables)), f"arm_{seed}.urdf"))
