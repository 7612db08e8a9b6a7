"""Equilibria for given targets of the tip, each held in the twin.

report = rests_at(model, {"here": point})
print(report)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from softdyn.dynamics.model import SoftModel
from softdyn.statics import Equilibrium, TipSearch, inputs_for_tip, sample_between, sample_rests
from softdyn.statics.samples import STATIONS
from softdyn.validation.crosschecks.rests import Drift, hold
from softdyn.validation.crosschecks.result import finite

CM = 100.0  # per metre
STARTS = 24  # sampled equilibria from which the search for each target starts
NUDGE = 1e-3  # rad, or part of a stroke: the displacement that tests stability in the twin


@dataclass(frozen=True, eq=False)
class HeldRest:
    """An equilibrium and the twin's verdict on it, input frozen for `seconds`.

    Attributes
    ----------
    rest : Equilibrium
        The equilibrium that was put into the twin.
    seconds : float
        Length of its run (s).
    drift, nudged : Drift
        Drift of the tip, from the exact equilibrium and with the joints displaced by 1e-3 rad.
    """

    rest: Equilibrium
    seconds: float
    drift: Drift
    nudged: Drift

    @classmethod
    def of(cls, rest: Equilibrium, seconds: float) -> HeldRest:
        """Hold an equilibrium in the twin."""
        return cls(rest, seconds, hold(rest, seconds), hold(rest, seconds, nudge=NUDGE))

    def to_dict(self) -> dict[str, Any]:
        """In numbers."""
        rest = self.rest
        held = zip(rest.model.joint_names, rest.held, strict=True)
        drifts = {"drift_cm": self.drift, "nudged_drift_cm": self.nudged}
        return {
            **{key: getattr(rest, key).tolist() for key in ("y", "u", "q", "tip_compliance")},
            "residual": rest.residual,
            "stable": rest.stable,
            "neutral": rest.neutral,
            "smallest_eigenvalue": float(rest.eigenvalues[0]) if rest.eigenvalues.size else None,
            "rightmost_pole": float(rest.poles[0].real) if rest.poles.size else None,
            "joints_at_limits": [name for name, at_limit in held if at_limit],
            "hold_s": self.seconds,
            **{key: {"largest": CM * drift.largest, "final": CM * drift.final}
               for key, drift in drifts.items()},
        }  # fmt: skip

    def __str__(self) -> str:
        rest = self.rest
        firm = "nothing free"
        if rest.eigenvalues.size:
            firm = f"eigenvalue {rest.eigenvalues[0]:.4g}, pole {rest.poles[0].real:.3g} /s"
        stops = f", {rest.held.sum()} joints at limits" if rest.held.any() else ""
        inputs = " ".join(f"{x:.3f}" for x in rest.u) or "none"
        return (
            f"{rest.firmness} ({firm}){stops}, "
            f"drift {CM * self.drift.final:.2g} cm in {self.seconds:g} s, "
            f"nudged {CM * self.nudged.final:.2g} cm, u = {inputs}"
        )


@dataclass(frozen=True, eq=False)
class TargetReport:
    """The equilibria that were found for one target.

    Attributes
    ----------
    name : str
        Name of the target.
    search : TipSearch
        All equilibria found.
    closest, closest_stable, most_stable : HeldRest, or None where no stable one was found
        The equilibria of the search, each held in the twin.
    closest_sample : float
        Distance of the closest sampled equilibrium (m), NaN without samples (None in numbers).
    """

    name: str
    search: TipSearch
    closest: HeldRest
    closest_stable: HeldRest | None
    most_stable: HeldRest | None
    closest_sample: float

    def to_dict(self) -> dict[str, Any]:
        """In numbers."""
        kinds = ("closest", "closest_stable", "most_stable")
        return {
            "target": self.search.target.tolist(),
            **{kind: self._numbers(getattr(self, kind)) for kind in kinds},
            "closest_sample_cm": finite(CM * self.closest_sample),
            "equilibria": len(self.search.found),
        }

    def _numbers(self, one: HeldRest | None) -> dict[str, Any] | None:
        if one is None:
            return None
        return {"distance_cm": CM * self.search.distance(one.rest), **one.to_dict()}

    def __str__(self) -> str:
        place = " ".join(f"{x:.4f}" for x in self.search.target)
        lines = [f"{self.name} ({place} m), {len(self.search.found)} equilibria found"]
        shown = {"closest": self.closest, "stable": self.closest_stable}
        if self.most_stable is not self.closest_stable:
            shown["most stable"] = self.most_stable
        if self.closest_stable is self.closest:
            del shown["stable"]
        for kind, one in shown.items():
            text = "none found"
            if one is not None:
                text = f"{CM * self.search.distance(one.rest):.3f} cm away, {one}"
            lines.append(f"  {kind:<14} {text}")
        if math.isfinite(self.closest_sample):
            lines.append(f"  closest sample {CM * self.closest_sample:.3f} cm away")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class RestReport:
    """The stable and neutral equilibria that were sampled, and a report for each target."""

    robot: str
    samples: tuple[Equilibrium, ...]
    targets: tuple[TargetReport, ...]

    def to_dict(self) -> dict[str, Any]:
        """In numbers."""
        targets = [one.to_dict() for one in self.targets]
        return {"robot": self.robot, "samples": len(self.samples), "targets": targets}

    def __str__(self) -> str:
        neutral = sum(one.neutral for one in self.samples)
        head = f"{self.robot}: {len(self.samples) - neutral} stable equilibria sampled"
        if neutral:
            head += f", {neutral} neutral ones"
        return "\n".join([head, *map(str, self.targets)])


def rests_at(
    model: SoftModel,
    targets: Mapping[str, np.ndarray],
    *,
    rays: int = 40,
    more: int = 100,
    shapes: int = 12,
    seed: int = 0,
    seconds: float = 10.0,
    guesses: Iterable[tuple[np.ndarray, np.ndarray]] = (),
) -> RestReport:
    """Sample equilibria, search inputs for each target, hold the equilibria found in the twin.

    Parameters
    ----------
    model : SoftModel
        The robot.
    targets : mapping of str to ndarray, (3,)
        Points for the tip (m), by name.
    rays : int
        Random inputs to raise, see `statics.sample_rests`.
    more : int
        Number of further stable equilibria sought where samples are sparse, see
        `statics.sample_between`.
    shapes : int
        Number of random shapes from which the search for each target starts.
    seed : int
        Seed of all random numbers.
    seconds : float
        Length of the twin's runs (s).
    guesses : iterable of (ndarray, ndarray)
        Further starting points (q, u), (nq,) and (nu,), for each target.

    Raises
    ------
    StaticsError
        The robot does not settle under zero input.
    InputError
        A target of the wrong shape or not finite.
    """

    @cache  # one equilibrium may be the closest, the closest stable and the most stable
    def judged(rest: Equilibrium | None) -> Any:
        return rest and HeldRest.of(rest, seconds)

    guesses = tuple(guesses)
    samples = list(_shown(sample_rests(model, rays, seed), rays * STATIONS, "rests"))
    samples += list(_shown(sample_between(samples, more, seed), more, "between them"))
    found = []
    for name, target in _shown(targets.items(), len(targets), "targets"):
        nearest = sorted(samples, key=lambda one: _distance(one, target))
        search = inputs_for_tip(
            model, target, nearest[:STARTS], guesses=guesses, shapes=shapes, rays=0,
            seed=seed, seconds=math.inf,
        )  # fmt: skip
        best = (search.nearest, search.nearest_stable, search.most_stable)
        closest, stable, firmest = map(judged, best)
        closest_sample = _distance(nearest[0], target) if nearest else np.nan
        found.append(TargetReport(name, search, closest, stable, firmest, closest_sample))
    return RestReport(model.bundled or model.name, tuple(samples), tuple(found))


def _distance(one: Equilibrium, target: np.ndarray) -> float:
    return float(np.linalg.norm(one.y - target))


def _shown(items: Iterable[Any], total: int, what: str) -> Iterable[Any]:
    """`items` with a bar, on a terminal or in a notebook only."""
    return tqdm(items, total=total, desc=what, disable=None, leave=False)
