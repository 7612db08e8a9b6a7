"""Find inputs that hold the tip at a given point, from many starts.

The unknowns are q and u: r(q, u) = 0 between the joint limits, u within its bounds, y(q) = y*. Two
solvers work together. `explore` solves one bounded least-squares problem from an arbitrary start.
It may pass through shapes that are no equilibria, so it finds buckled and unstable branches that a
slowly raised input never reaches. `approach` then follows the branch of exact equilibria, with
∂y/∂u = J (∂r/∂q)⁻¹ B, until the tip is as close as the bounds allow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from softdyn.checks import array, instance, instances, length, number, whole
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError
from softdyn.statics.branch import REACHED, approach
from softdyn.statics.equilibria import balance, move, rest, settle
from softdyn.statics.equilibrium import Equilibrium, RankedEquilibria, StaticsError
from softdyn.statics.samples import random_shapes
from softdyn.statics.unknown_inputs import explore

SECONDS = 60.0  # the usual limit of a search
SAME = 1e-3  # equilibria whose joints are this close count as one (rad, m)
SADDLES = 4  # unstable equilibria, the closest, from which stable ones are sought downhill
ASIDE = 0.1  # of a joint, out of an unstable equilibrium (rad, m)
EXPLORED = 4  # number of the given starts that `explore` uses


@dataclass(frozen=True, eq=False)
class TipSearch(RankedEquilibria):
    """Equilibria that hold the tip at or near a target, the closest first.

    Equilibria within `REACHED` of the target count as equally close; of these the one with the
    least input ‖u‖ comes first.

    Attributes
    ----------
    target : ndarray, (3,)
        The target in the world (m).
    found : tuple of Equilibrium
        Distinct equilibria, stable or not; at least one.
    timed_out : bool
        Whether the limit of time ended the search before all starts were tried.
    """

    target: np.ndarray
    found: tuple[Equilibrium, ...]
    timed_out: bool = False

    @property
    def most_stable(self) -> Equilibrium | None:
        """The stable equilibrium whose smallest eigenvalue is largest; None if none was found.

        Only those as close to the target as the closest stable one are compared.
        """
        nearest = self.nearest_stable
        if nearest is None:
            return None
        within = max(self.distance(nearest), REACHED)
        close = [one for one in self.found if one.stable and self.distance(one) <= within]
        return max(close, key=lambda one: one.eigenvalues[0] if one.eigenvalues.size else np.inf)

    def distance(self, equilibrium: Equilibrium) -> float:
        """Distance of an equilibrium's tip from the target (m)."""
        one = instance("equilibrium", equilibrium, Equilibrium, "an Equilibrium")
        return float(np.linalg.norm(one.y - self.target))


def inputs_for_tip(
    model: SoftModel,
    target: np.ndarray,
    starts: Iterable[Equilibrium] = (),
    *,
    guesses: Iterable[tuple[np.ndarray, np.ndarray]] = (),
    shapes: int = 16,
    seed: int = 0,
    seconds: float = SECONDS,
) -> TipSearch:
    """Inputs within their bounds that hold the tip at `target`, or as near as was found.

    It is a local search from many starts. Every equilibrium that it returns exists, but it may miss
    some.

    Parameters
    ----------
    target : ndarray, (3,)
        The target in the world (m).
    starts : iterable of Equilibrium
        Equilibria to start from besides `rest`, for example from `sample_rests`, the nearest first.
        `approach` starts from each of them, `explore` from the first few.
    guesses : iterable of (ndarray, ndarray)
        Further starts (q, u), (nq,) and (nu,), which need not be equilibria.
    shapes : int
        Number of random shapes to start from.
    seed : int
        Seed of the shapes.
    seconds : float
        Time (s) after which no further start is tried; `timed_out` says whether that happened. With
        ``math.inf`` the result depends on the arguments alone.

    Raises
    ------
    StaticsError
        If the robot has no equilibrium under the least input.
    InputError
        For a target of the wrong shape or not finite, and for a robot without inputs.
    """
    latest = perf_counter() + number("seconds", seconds, lower=0.0, finite=False)
    target, shapes = array("target", target, (3,)), whole("shapes", shapes)
    whole("seed", seed)
    if check_model(model).nu == 0:
        raise InputError(str(model.robot.path), "a robot with an <actuator>", "one without inputs")
    known = (rest(model), *instances("starts", starts, Equilibrium, "an Equilibrium"))
    pairs: tuple[Any, ...] = instances("guesses", guesses, object, "a pair (q, u)")
    for pair in pairs:
        if length("guesses", pair) != 2:
            raise InputError("guesses", "pairs (q, u)", repr(pair))
    ends = [approach(known[0], target)]
    timed_out = False
    for attempt in _attempts(model, target, known, pairs, shapes, seed):
        timed_out = perf_counter() > latest
        if timed_out:
            break
        with suppress(StaticsError):
            ends.append(attempt())
    found = _distinct(ends, target)
    sides = list[Equilibrium]()
    for one in [one for one in found if not one.stable][:SADDLES]:
        for side in _downhill(one):
            timed_out = timed_out or perf_counter() > latest
            if not timed_out and not any(_same(side, other) for other in sides):
                sides.append(side)
                ends.append(approach(side, target, stay_stable=True))
    return TipSearch(target, tuple(_distinct(ends, target) if sides else found), timed_out)


def _attempts(
    model: SoftModel,
    target: np.ndarray,
    known: Sequence[Equilibrium],
    guesses: Sequence[tuple[np.ndarray, np.ndarray]],
    shapes: int,
    seed: int,
) -> Iterator[Callable[[], Equilibrium]]:
    """The attempts of a search, one for each start and solver; they may raise a StaticsError."""
    for one in known[1:]:
        yield partial(approach, one, target)
    for one in known:
        if one.stable:
            yield partial(approach, one, target, stay_stable=True)
    for q, u in guesses:
        yield lambda q=q, u=u: approach(balance(model, u, q), target)  # type: ignore[misc]
        yield partial(explore, model, target, q, u)
    explored = [(one.q, one.u) for one in known[: 1 + EXPLORED]]
    for q, u in (*explored, *random_shapes(model, shapes, seed)):
        yield partial(explore, model, target, q, u)


def _order(one: Equilibrium, target: np.ndarray) -> tuple[float, float]:
    distance = float(np.linalg.norm(one.y - target))
    return max(distance, REACHED), float(np.linalg.norm(one.u))


def _same(one: Equilibrium, other: Equilibrium) -> bool:
    coordinates = one.model.coordinates
    return bool(np.abs(coordinates(one.q) - coordinates(other.q)).max() < SAME)


def _distinct(ends: Iterable[Equilibrium], target: np.ndarray) -> list[Equilibrium]:
    """Each equilibrium once, the closest first."""
    found: list[Equilibrium] = []
    for one in sorted(ends, key=lambda one: _order(one, target)):
        if not any(_same(one, other) for other in found):
            found.append(one)
    return found


def _downhill(saddle: Equilibrium) -> Iterator[Equilibrium]:
    """Stable equilibria under the same input, on both sides of each unstable direction."""
    model, free = saddle.model, ~saddle.held
    values, vectors = np.linalg.eigh(saddle.stiffness[np.ix_(free, free)])
    for direction in vectors.T[values < 0]:
        step = np.zeros(model.nv)
        step[free] = ASIDE * direction / np.abs(direction).max()
        for aside in (step, -step):
            with suppress(StaticsError):
                yield settle(model, saddle.u, move(model, saddle.q, aside))
