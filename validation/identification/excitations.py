"""Which excitation tells the parameters best: several on the twin, by Cramér and Rao's bound.

What a robot needs cannot be read off its file: slow inputs tell stiffness, fast ones damping, wide
ones both, until joints are at their stops and tell nothing. So each is tried on the twin with the
file's parameters, and the fit's derivatives say what it would tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.exceptions import SoftdynError
from softdyn.identification.fit import least_deviations
from softdyn.identification.parameters import Parameter
from softdyn.validation.identification.trials import (
    ABOUT_ZERO,
    Excitation,
    deviations,
    twin_data,
)
from softdyn.validation.processes import in_order
from softdyn.validation.tables import Table

REACHES = (0.02, 0.06, 0.2, 0.6)  # of the inputs' ranges
KNOTS = (0.1, 0.3, 1.0)  # s


@dataclass(frozen=True, eq=False)
class Candidate:
    """An excitation, and the least relative deviations (P,) that data of it allow; inf: not told.

    `refused` says why there are none.
    """

    excitation: Excitation
    relative: np.ndarray
    refused: str = ""

    @property
    def told(self) -> np.ndarray:
        """Which parameters (P,) these data tell."""
        return np.isfinite(self.relative)

    @property
    def worst(self) -> float:
        """The largest relative deviation of what is told."""
        return float(np.max(self.relative[self.told], initial=0.0))


def compared(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    outputs: Sequence[str],
    excitation: Excitation,
    noise: float,
    seed: int = 0,
    jobs: int = -1,
) -> list[Candidate]:
    """Every reach with every distance of knots: what tells most first, then what tells it best.

    Parameters
    ----------
    model, unknowns, outputs, excitation, noise, seed
        As for `trial`; the excitation's own reach and knots do not count, nor its spread.
    jobs : int
        Processes, -1 for one per core.

    Raises
    ------
    InputError
        No noise, which leaves nothing to compare.
    """
    if not noise > 0:
        raise InputError("noise", "more than 0: it is what deviations come from", noise)
    several = [
        replace(excitation, reach=reach, knots=knots, spread=0.0)
        for reach, knots in product(REACHES, KNOTS)
    ]
    calls = [(model, tuple(unknowns), tuple(outputs), one, noise, seed) for one in several]
    return sorted(in_order(_tried, calls, jobs), key=lambda one: (-one.told.sum(), one.worst))


def _tried(
    model: SoftModel, unknowns: Sequence[Parameter], outputs: Sequence[str],
    excitation: Excitation, noise: float, seed: int,
) -> Candidate:  # fmt: skip
    try:
        data, theta = twin_data(model, unknowns, outputs, excitation, noise, seed)
        found = least_deviations(model, data, unknowns, theta, noise * deviations(model, outputs))
    except SoftdynError as error:  # all at the stops, say: another may do
        return Candidate(excitation, np.full(len(unknowns), np.inf), str(error))
    return Candidate(excitation, found / np.where(theta, np.abs(theta), ABOUT_ZERO))


def comparison(unknowns: Sequence[Parameter], candidates: Sequence[Candidate]) -> str:
    """A table, best first, and the options that give the best."""
    kinds = list(dict.fromkeys(one.kind.name for one in unknowns))
    rows = []
    for one in candidates:
        worst = []
        for kind in kinds:
            use = one.told & [unknown.kind.name == kind for unknown in unknowns]
            worst.append(one.relative[use].max() if use.any() else None)
        told = "none" if one.refused else f"{one.told.sum()} of {len(unknowns)}"
        rows.append([one.excitation.reach, one.excitation.knots, told, *worst])
    best = candidates[0]
    titles = ["reach", "knots (s)", "told", *(f"worst {kind}" for kind in kinds)]
    table = Table(titles, rows, ["g", "g", ">", *[".2%"] * len(kinds)]).text()
    if not best.told.any():
        return f"{table}\nnone of them tells anything: {best.refused}"
    untold = [one.label for one, yes in zip(unknowns, best.told, strict=True) if not yes]
    lines = [f"best: --reach {best.excitation.reach:g} --knots {best.excitation.knots:g}"]
    if untold:
        lines.append(f"not told by it: {', '.join(untold)}")
    return "\n".join((table, *lines))
