"""Targets of a study: the paper's for its robots, sampled equilibria for any other."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, statics
from softdyn.validation.crosschecks.rest_report import rests_at
from softdyn.validation.loop import setups
from softdyn.validation.loop.experiment import DEFAULT_PERIOD, SET_POINT_DURATION, Experiment

SPREAD = 8  # equilibria at least from which targets are chosen: fewer are all at the edge
HELD = 0.01  # s, run of the twin at each equilibrium, which only `softdyn statics` judges
Target = tuple[str, Any]
"""Kind and value of a case."""


def study_targets(model: SoftModel, published: Sequence[Target]) -> list[Target]:
    """`published` for a robot of the paper; as many equilibria for any other.

    Raises
    ------
    InputError
        Inputs that move the tip nowhere.
    """
    if model.bundled in setups.ROBOTS:
        return list(published)
    return [("point", point) for point in points(model, len(published))]


def points(model: SoftModel, count: int, seed: int = 0) -> list[tuple[float, ...]]:
    """Tip positions (m) of stable equilibria, rounded to 0.1 mm, moderate ones first.

    They lie at even ranks between the nearest and the farthest from `statics.rest` of a spread of
    twice as many, and of `SPREAD` at least. So even a single one is not at the edge of the reach.

    Raises
    ------
    InputError
        Inputs that move the tip nowhere.
    """
    start = statics.rest(model).y
    rests = statics.spread_rests(model, max(2 * count, SPREAD), seed)
    ranked = sorted(rests, key=lambda one: float(np.linalg.norm(one.y - start)))
    ranks = dict.fromkeys(np.linspace(0, len(ranked) - 1, count).round().astype(int).tolist())
    return [tuple(round(x, 4) + 0.0 for x in ranked[k].y.tolist()) for k in ranks]


def nearest_stable(model: SoftModel, targets: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Distance (m) from each target (3,) to the tip of the nearest stable equilibrium.

    It is the one that ``softdyn statics`` finds, infinite if it finds none.
    """
    found = rests_at(model, targets, seconds=HELD).targets
    stable = {one.name: (one.search, one.search.nearest_stable) for one in found}
    return {
        name: math.inf if rest is None else search.distance(rest)
        for name, (search, rest) in stable.items()
    }


def study_experiments(model: SoftModel, count: int) -> list[Experiment]:
    """Runs to at most `count` stable equilibria, and along a path around the last possible one.

    The robot can hold each of these targets. It may not reach the paper's ellipse scaled to its
    size.

    Raises
    ------
    InputError
        Inputs that move the tip nowhere.
    """
    rests = statics.spread_rests(model, count)
    loops = (loop for loop in map(statics.loop_around, reversed(rests)) if loop is not None)
    found: list[tuple[str, Callable[[float], Reference], float]] = [
        ("set_point", SetPoint(one.y), SET_POINT_DURATION) for one in rests
    ]
    found += [("tracking", loop, setups.CYCLES * loop.period) for loop in islice(loops, 1)]
    return [
        Experiment(model.name, kind, None, None, reference, duration, DEFAULT_PERIOD,
                   model.robot.length)
        for kind, reference, duration in found
    ]  # fmt: skip
