"""Models by their names, for tests over many robots, and points at which to evaluate them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import softdyn
from softdyn import SoftModel
from softdyn.actuation import Winches
from softdyn.dynamics.balance import Disturbance
from tests.support import robots
from tests.support.arms import PROJECTIONS
from tests.support.random_robots import write_robot
from tests.support.rigs import slackened, wound
from tests.support.wrapped_robots import wrapped_robot

# whose balance of forces has every kind of term
BALANCED = ("finger", "spirob", "slack", "winched", "mimic")


def named_model(which: int | str, folder: Path) -> SoftModel:
    """A bundled robot, one of `PROJECTIONS`, a random one by its seed, or one of these by its name.

    "winched"; "walker" and "walking gripper", on floating bases; "wrapped" with round bodies;
    "slack"; "slack N" and "wound N", a random one with slack tendons or with winches.
    """
    if isinstance(which, int):
        return softdyn.load(write_robot(which, folder))
    if which in PROJECTIONS:
        return PROJECTIONS[which](folder)
    if which == "winched":
        return robots.load(folder, robots.WINCHED)
    if which in ("walker", "walking gripper"):
        text = robots.WALKER if which == "walker" else robots.GRIPPER
        return robots.load(folder, text, floating=True)
    if which == "wrapped":
        return softdyn.build(wrapped_robot(3, bodies=2))
    kind, _, seed = which.partition(" ")
    if kind in ("slack", "wound"):
        rig = slackened if kind == "slack" else wound
        return rig(named_model(int(seed) if seed else "spirob", folder))
    return softdyn.load(which)


def case(model: SoftModel, disturbances: tuple[Disturbance, ...], seed: int = 1):
    """q, v, a, commands and disturbances at random."""
    rng = np.random.default_rng(seed)
    q = model.configuration(
        rng.uniform(np.maximum(model.lower, -0.4), np.minimum(model.upper, 0.4))
    )
    v, a = rng.normal(size=(2, model.nv))
    u = rng.uniform(np.maximum(model.u_min, -3), np.minimum(model.u_max, 3))
    d = 0.1 * rng.normal(size=sum(one.size(model) for one in disturbances))
    return q, v, a, Winches(model).commands(model.state(q, v), u), d
