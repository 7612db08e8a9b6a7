"""The number of joints n that an arm needs: its sag, frequencies and shape under a cable by n."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softdyn import design
from softdyn.validation.rods.arms import counts_for, frequencies, model_of, refined, tip
from softdyn.validation.rods.ladder import Ladder
from softdyn.validation.tables import Table

BEND = math.pi / 2
"""Angle (rad) to which the shape under a cable is taken, where the cable can pull so hard."""


@dataclass(frozen=True, eq=False)
class Convergence:
    """The result of `converge`.

    Attributes
    ----------
    ladders : tuple of Ladder
        A ladder per figure; tip errors are relative to the arm's length.
    tolerance : float
        Relative.
    """

    ladders: tuple[Ladder, ...]
    tolerance: float

    @property
    def needed(self) -> int | None:
        """Joints in each section that keep every figure within the tolerance."""
        found = [ladder.needed(self.tolerance) for ladder in self.ladders]
        return None if None in found else max(n for n in found if n is not None)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "tolerance": self.tolerance,
            "joints_needed": self.needed,
            "quantities": [ladder.to_dict(self.tolerance) for ladder in self.ladders],
        }

    def __str__(self) -> str:
        counts = self.ladders[0].counts
        titles = ["error of", *(f"n = {n}" for n in counts), "order", f"n for {self.tolerance:g}"]
        rows = [
            [one.name, *one.errors, one.order, one.needed(self.tolerance)] for one in self.ladders
        ]
        table = Table(titles, rows, ["", *[".1e"] * len(counts), ".1f", "d"]).text()
        verdict = f"joints in each section for {self.tolerance:g}: {self.needed or 'unknown'}"
        return f"{table}\nerrors against the extrapolated limit\n{verdict}"


def converge(arm: design.Arm, counts: Sequence[int], tolerance: float) -> Convergence:
    """Measure an arm at several numbers of joints in each section.

    It takes three kinds of figures: the tip's equilibrium, as mounted and with the arm horizontal;
    the first three natural frequencies; and the tip under one cable for each pair of sections where
    cables begin and end. The cable gets the tension that would bend the arm by 90°, or its largest.

    Parameters
    ----------
    arm : Arm
    counts : sequence of int
        Numbers beyond the limit of a file are left out.
    tolerance : float
        Relative tolerance; for the tip relative to the arm's length.
    """
    counts = counts_for(arm, counts)
    level = replace(arm, mount=design.Mount(direction=(1.0, 0.0, 0.0)))
    measured: dict[str, list[np.ndarray]] = {}

    def note(name: str, value: np.ndarray) -> None:
        measured.setdefault(name, []).append(np.atleast_1d(value))

    pulls = _pulls(arm)
    for n in counts:
        model = model_of(refined(arm, n))
        note("tip at rest", tip(model))
        note("tip held level", tip(model_of(refined(level, n))))
        for k, frequency in enumerate(frequencies(model, 3), 1):
            note(f"frequency {k}", frequency)
        for index, tension in pulls:
            u = np.zeros(model.nu)
            u[index] = tension
            path = arm.paths[index]
            unit = "Pa" if isinstance(path, design.Chamber) else "N"
            note(f"tip, {path.name} at {tension:.3g} {unit}", tip(model, u.tolist()))
    ladders = []
    for name, values in measured.items():
        if len(values) < len(counts):  # a mode that the coarsest arm does not have
            continue
        scale = float(values[-1][0]) if name.startswith("frequency") else arm.length
        ladders.append(Ladder(name, counts, np.array(values), scale))
    return Convergence(tuple(ladders), tolerance)


def _pulls(arm: design.Arm) -> list[tuple[int, float]]:
    """Cables and chambers to load, one of each start and end, and their inputs (N, Pa)."""
    layout = design.lay_out(arm)
    found: dict[tuple[int, int], tuple[int, float]] = {}
    for index, cable in enumerate(arm.paths):
        bend = float(
            np.abs(
                [
                    c / spring.stiffness
                    for spring, c in zip(
                        layout.all_springs, layout.coefficients(cable), strict=True
                    )
                    if spring.strain.startswith("bend")
                ]
            ).sum()
        )
        if bend > 0:
            tension = min(cable.largest_force, BEND / bend)
            if isinstance(cable, design.Chamber):
                sign = 1 if cable.max_pressure > -cable.min_pressure else -1
                tension *= sign / cable.section_area
            found.setdefault((cable.start, cable.end % len(arm.sections)), (index, tension))
    return list(found.values())
