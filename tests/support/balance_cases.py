"""Robots whose balance of forces has every kind of term, and points at which to evaluate it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import softdyn
from softdyn import SoftModel
from softdyn.actuation import Winches
from softdyn.dynamics.balance import Disturbance
from tests.support import robots
from tests.support.arms import PROJECTIONS
from tests.support.rigs import slackened

BALANCED = ("finger", "spirob", "slack", "winched", "mimic")


def balanced(name: str, folder: Path) -> SoftModel:
    """The robot of one of these names."""
    if name == "mimic":
        return PROJECTIONS["mimic"](folder)
    if name == "winched":
        return robots.load(folder, robots.WINCHED)
    return slackened(softdyn.load("spirob")) if name == "slack" else softdyn.load(name)


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
