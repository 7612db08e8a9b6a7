"""Comparison of excitations on the twin, by the Cramér-Rao bound of the parameters.

A robot's file does not show the best excitation. Slow inputs identify stiffness, fast inputs
damping, and wide inputs both, until joints reach their stops, where they identify nothing. So each
excitation runs on the twin with the file's parameters, and the derivatives of the fit give the
bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.exceptions import SoftdynError
from softdyn.identification import Parameter, least_deviations
from softdyn.validation.identification.trials import (
    ABOUT_ZERO,
    Excitation,
    deviations,
    twin_data,
)
from softdyn.validation.processes import in_order
from softdyn.validation.tables import Table

AMPLITUDES = (0.02, 0.06, 0.2, 0.6)  # of the inputs' ranges
KNOTS = (0.1, 0.3, 1.0)  # s


@dataclass(frozen=True, eq=False)
class Candidate:
    """An excitation, and the least possible relative deviations (P,) of its data; inf if unknown.

    If there are none, `refused` gives the reason.
    """

    excitation: Excitation
    relative: np.ndarray
    refused: str = ""

    @property
    def identifiable(self) -> np.ndarray:
        """Whether these data identify each parameter (P,)."""
        return np.isfinite(self.relative)

    @property
    def worst(self) -> float:
        """The largest relative deviation of the identifiable ones."""
        return float(np.max(self.relative[self.identifiable], initial=0.0))


def compared(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    outputs: Sequence[str],
    excitation: Excitation,
    noise: float,
    seed: int = 0,
    jobs: int = -1,
) -> list[Candidate]:
    """Compare every amplitude with every distance of knots, the best first.

    More identifiable parameters are better, then smaller deviations.

    Parameters
    ----------
    model, unknowns, outputs, excitation, noise, seed
        As for `trial`; the excitation's own amplitude, knots and spread are ignored.
    jobs : int
        Processes, -1 for one per core.

    Raises
    ------
    InputError
        The noise is zero, so that there is nothing to compare.
    """
    if not noise > 0:
        raise InputError("noise", "more than 0, because deviations come from noise", noise)
    several = [
        replace(excitation, amplitude=amplitude, knots=knots, spread=0.0)
        for amplitude, knots in product(AMPLITUDES, KNOTS)
    ]
    calls = [(model, tuple(unknowns), tuple(outputs), one, noise, seed) for one in several]
    tried = in_order(_tried, calls, jobs)
    return sorted(tried, key=lambda one: (-one.identifiable.sum(), one.worst))


def _tried(
    model: SoftModel, unknowns: Sequence[Parameter], outputs: Sequence[str],
    excitation: Excitation, noise: float, seed: int,
) -> Candidate:  # fmt: skip
    try:
        data, theta = twin_data(model, unknowns, outputs, excitation, noise, seed)
        found = least_deviations(model, data, unknowns, theta, noise * deviations(model, outputs))
    # for example all joints are at stops; another excitation may succeed
    except SoftdynError as error:
        return Candidate(excitation, np.full(len(unknowns), np.inf), str(error))
    return Candidate(excitation, found / np.where(theta, np.abs(theta), ABOUT_ZERO))


def comparison(unknowns: Sequence[Parameter], candidates: Sequence[Candidate]) -> str:
    """A table, best first, and the options of the best excitation."""
    kinds = list(dict.fromkeys(one.kind.name for one in unknowns))
    rows = []
    for one in candidates:
        worst = []
        for kind in kinds:
            use = one.identifiable & [unknown.kind.name == kind for unknown in unknowns]
            worst.append(one.relative[use].max() if use.any() else None)
        count = "none" if one.refused else f"{one.identifiable.sum()} of {len(unknowns)}"
        rows.append([one.excitation.amplitude, one.excitation.knots, count, *worst])
    best = candidates[0]
    titles = ["amplitude", "knots (s)", "identifiable", *(f"worst {kind}" for kind in kinds)]
    table = Table(titles, rows, ["g", "g", ">", *[".2%"] * len(kinds)]).text()
    if not best.identifiable.any():
        return f"{table}\nnone of them identifies a parameter: {best.refused}"
    others = [one.label for one, yes in zip(unknowns, best.identifiable, strict=True) if not yes]
    lines = [f"best: --amplitude {best.excitation.amplitude:g} --knots {best.excitation.knots:g}"]
    if others:
        lines.append(f"not identifiable with it: {', '.join(others)}")
    return "\n".join((table, *lines))
