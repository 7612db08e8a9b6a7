"""What a study asks of a robot: the paper's experiments of its robots, rests of anyone's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from softdyn import SoftModel, statics
from softdyn.validation.studies import paper

Goal = tuple[str, Any]
"""Kind and value of a case."""


def goals(model: SoftModel, published: Sequence[Goal]) -> list[Goal]:
    """`published` for a robot of the paper; as many points that any other can rest at.

    Raises
    ------
    InputError
        Inputs that move the tip nowhere.
    """
    if model.bundled in paper.ROBOTS:
        return list(published)
    return [("point", point) for point in points(model, len(published))]


def points(model: SoftModel, count: int, seed: int = 0) -> list[tuple[float, ...]]:
    """Points that a robot can rest at with its tip (m), rounded to 0.1 mm, the outermost first.

    Raises
    ------
    InputError
        Inputs that move the tip nowhere.
    """
    rests = statics.spread_rests(model, count, seed)
    return [tuple(round(x, 4) + 0.0 for x in one.y.tolist()) for one in rests]
