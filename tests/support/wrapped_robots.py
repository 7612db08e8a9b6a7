"""Random robots with cables around round bodies: cylinders and spheres, outside and inside."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from softdyn.description.rig import Actuator
from softdyn.description.robot import Robot, Site, Tendon, Wrap, poses
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.exceptions import UrdfError
from tests.support.random_robots import random_urdf


def wrapped_robot(seed: int, bodies: int = 4, *, inside: bool = True) -> Robot:
    """A random robot whose cables run around round bodies; the same for the same arguments.

    Parameters
    ----------
    seed : int
        Any non-negative integer.
    bodies : int
        Number of moving links with mass, at most.
    inside : bool
        Whether some cables run inside their bodies.
    """
    rng = np.random.default_rng((seed, 50))
    path = Path(f"wrapped_{seed}.urdf")
    while True:
        base = parse_text(random_urdf(int(rng.integers(1 << 30)), bodies), path=path)
        tendons = tuple(_tendon(base, k, rng, inside) for k in range(int(rng.integers(1, 4))))
        inputs = tuple(
            Actuator(f"pull_{k}", tendon.name, -1.0, 0.0, 2.0) for k, tendon in enumerate(tendons)
        )
        names = [tendon.name for tendon in base.tendons]
        robot = replace(
            base,
            name=f"wrapped_{seed}",
            tendons=base.tendons + tendons,
            actuators=tuple(a for a in base.actuators if a.tendon in names) + inputs,
        )
        try:
            return parse_text(write(robot), path=path)
        except UrdfError:
            continue  # sites on one line with a centre, or too near


def _tendon(robot: Robot, number: int, rng: np.random.Generator, inside: bool) -> Tendon:
    """A cable over a few random sites, with round bodies between most of them."""
    placed, links = poses(robot), [link.name for link in robot.links]
    sites = tuple(
        Site(str(rng.choice(links)), tuple(rng.normal(scale=0.15, size=3).tolist()))
        for _ in range(int(rng.integers(2, 5)))
    )
    points = [placed[site.link][0] @ site.xyz + placed[site.link][1] for site in sites]
    wraps = []
    for k, (a, b) in enumerate(pairwise(points)):
        if rng.random() < 0.2 and len(sites) > 2:
            continue
        link = str(rng.choice(links))
        rotation, translation = placed[link]
        centre = a + rng.uniform(0.2, 0.8) * (b - a) + rng.normal(scale=0.06, size=3)
        axis = rng.normal(size=3) if rng.random() < 0.5 else None
        draft = Wrap(
            link,
            tuple((rotation.T @ (centre - translation)).tolist()),
            1.0,
            k,
            None if axis is None else tuple(axis.tolist()),
        )
        room = min(
            float(np.linalg.norm(draft.across(rotation.T @ (end - translation)))) for end in (a, b)
        )
        radius = float(rng.uniform(0.2, 0.9)) * room
        kind, side = rng.random(), None
        if kind > 0.4:
            reach = rng.uniform(0.0, 0.5) if inside and kind > 0.7 else rng.uniform(1.2, 3.0)
            off = rng.normal(size=3)
            off = draft.across(np.array(draft.xyz) + off)
            side = tuple((draft.xyz + off * (reach * radius / np.linalg.norm(off))).tolist())
        wraps.append(replace(draft, radius=radius, side=side))
    return Tendon(
        f"around_{number}", sites=sites, wraps=tuple(wraps),
        stiffness=float(rng.choice([0.0, 5.0])), damping=float(rng.choice([0.0, 0.05])),
    )  # fmt: skip
