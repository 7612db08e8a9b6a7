"""Half-spaces, balls, boxes and pairs of links as barriers of the tip, a point or whole links.

A barrier's value is a distance less a margin. `softdyn.safety.clearance` says where it is smooth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial
from itertools import combinations
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from softdyn.checks import array, did_you_mean, flag, instance, number, unit
from softdyn.copies import Frozen
from softdyn.description.inertia import rotation_rpy
from softdyn.description.robot import Robot, moving_link_of
from softdyn.dynamics.model import SoftModel, State
from softdyn.exceptions import InputError
from softdyn.safety.clearance import TIP, Bodies, Clearance, Values
from softdyn.safety.solids import Solid, ball, box, half_space, link_solids

RATE = 10.0  # α (1/s)
RECOVERY = 5.0  # β / α
EVERY = "all"
REACH = 0.1  # of the robot's length: rows of nearer bodies are in the QP
LINKS = f'"{EVERY}" or a list of names of links'

_known: WeakKeyDictionary[Barrier, tuple[SoftModel, Clearance, float]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Barrier(Frozen):
    """A distance that stays at least `margin`.

    Attributes
    ----------
    rate : float
        α (1/s), the rate at which a controller may approach the barrier.
    margin : float
        Distance to keep (m).
    reach : float, optional
        A row enters the QP if the distance is at most this (m). By default every point has a row,
        and a link within a tenth of the robot's length.
    name : str
        Name in logs.
    """

    _: KW_ONLY
    margin: float = 0.0
    reach: float | None = None
    name: str = ""

    rate = RATE

    @property
    def recovery(self) -> float:
        """β (1/s), the rate at which ḃ + α b recovers: 5 α for links, whose ḃ may jump."""
        return RECOVERY * self.rate

    def __call__(self, state: State) -> Values:
        """Its distances at this state.

        Raises
        ------
        InputError
            For a link that the robot does not have, or a link without a shape.
        """
        clearance, reach = self._on(state.model)
        found, _ = clearance(state, np.array([reach + self.margin]), np.array([self.rate]))
        return found._replace(b=found.b - self.margin)

    def reserve(self, state: State) -> float:
        """The smallest distance less the margin (m): the least of all values."""
        return self._on(state.model)[0].smallest(state) - self.margin

    def sampled_margin(self, model: SoftModel, period: float) -> float:
        """The distance α T ρ (m) that rows keep because they act once in a period T (s).

        ρ is the reach. A body in it may approach at α ρ. If a period's change of velocity is not
        foreseen at all, it moves by α T ρ before the next row acts. A point has no such distance.
        """
        reach = self._on(model)[1]
        return self.rate * period * reach if np.isfinite(reach) else 0.0

    def _check(self) -> None:
        object.__setattr__(self, "rate", number("rate", self.rate, above=0.0))
        object.__setattr__(self, "margin", number("margin", self.margin, lower=0.0))
        if self.reach is not None:
            object.__setattr__(self, "reach", number("reach", self.reach, lower=0.0))
        instance("name", self.name, str, "text")

    def _reach(self, model: SoftModel) -> float:
        return REACH * model.robot.length

    def _on(self, model: SoftModel) -> tuple[Clearance, float]:
        """The distances on a robot, and the reach (m)."""
        known = _known.get(self)
        if known is None or known[0] is not model:
            reach = self._reach(model) if self.reach is None else self.reach
            known = _known[self] = model, self._clearance(model), reach
        return known[1:]

    def _clearance(self, model: SoftModel) -> Clearance:
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Obstacle(Barrier):
    """An obstacle, and the part of the robot that keeps clear of it.

    Attributes
    ----------
    link : str, optional
        The link of a point; by default the point is the tip.
    point : array_like, (3,)
        The point in the link's frame (m).
    links : "all" or sequence of str, optional
        Whole links instead of a point; "all" are those that move.
    contact : bool
        Whether the obstacle is solid in the twin, as by default. All links touch it then, those
        too that need not keep clear of it. Otherwise it is a region to keep out of.
    """

    _: KW_ONLY
    link: str | None = None
    point: Any = (0.0, 0.0, 0.0)
    links: Any = None
    contact: bool = True

    @property
    def solid(self) -> Solid:
        """The obstacle as a body of the world."""
        raise NotImplementedError

    def _check(self) -> None:
        super()._check()
        if self.link is not None and not isinstance(self.link, str):
            raise InputError("link", "the name of a link", repr(self.link))
        point = tuple(array("point", self.point, (3,)).tolist())
        object.__setattr__(self, "point", point)
        if self.link is None and any(point):
            raise InputError("point", "a link too, for a point other than the tip", repr(point))
        flag("contact", self.contact)
        if self.links is not None:
            if self.link is not None:
                raise InputError("links", "none beside link", repr(self.links))
            object.__setattr__(self, "links", _names(self.links))

    @property
    def recovery(self) -> float:
        """β (1/s), equal to α for a point."""
        return self.rate if self.links is None else super().recovery

    def _reach(self, model: SoftModel) -> float:
        return np.inf if self.links is None else super()._reach(model)

    def _clearance(self, model: SoftModel) -> Clearance:
        if self.links is not None:
            return Clearance(_bodies(model, self.links), [self.solid])
        point = ball(np.array(self.point), 0.0, TIP if self.link is None else self.link)
        return Clearance(Bodies(model, [point]), [self.solid])


@dataclass(frozen=True, eq=False)
class HalfSpace(Obstacle):
    """Keeps the tip, a point or links in the half-space normal · y ≥ offset.

    Attributes
    ----------
    normal : ndarray, (3,)
        Direction into the allowed side; it is made a unit vector.
    offset : float
        Offset of the plane along the unit normal (m).
    rate : float
        α (1/s).
    """

    normal: np.ndarray
    offset: float
    rate: float = RATE

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", unit("normal", self.normal))
        object.__setattr__(self, "offset", number("offset", self.offset))
        self._check()

    @property
    def solid(self) -> Solid:
        """The forbidden half-space."""
        return half_space(self.normal, self.offset)


@dataclass(frozen=True, eq=False)
class KeepOutSphere(Obstacle):
    """Keeps the tip, a point or links out of a ball.

    Attributes
    ----------
    centre : ndarray, (3,)
        Centre of the ball (m).
    radius : float
        Radius of the ball (m).
    rate : float
        α (1/s).
    """

    centre: np.ndarray
    radius: float
    rate: float = RATE

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", array("centre", self.centre, (3,)))
        object.__setattr__(self, "radius", number("radius", self.radius, above=0.0))
        self._check()

    @property
    def solid(self) -> Solid:
        """The ball."""
        return ball(self.centre, self.radius)


@dataclass(frozen=True, eq=False)
class KeepOutBox(Obstacle):
    """Keeps the tip, a point or links out of a box.

    Attributes
    ----------
    centre, size : ndarray, (3,)
        Centre and lengths of the edges (m).
    rate : float
        α (1/s).
    rpy : ndarray, (3,)
        Roll, pitch and yaw of the box, as in a URDF (rad).
    """

    centre: np.ndarray
    size: np.ndarray
    rate: float = RATE
    rpy: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("centre", "size", "rpy"):
            object.__setattr__(self, name, array(name, getattr(self, name), (3,)))
        if not (self.size > 0).all():
            raise InputError("size", "three lengths > 0", self.size)
        self._check()

    @property
    def solid(self) -> Solid:
        """The box."""
        return box(rotation_rpy(tuple(self.rpy)), self.centre, self.size / 2)


@dataclass(frozen=True, eq=False)
class LinkPairs(Barrier):
    """Keeps links apart from each other.

    Attributes
    ----------
    pairs : "all" or sequence of (str, str)
        Pairs of links. "all" are those of moving links with at least one other body between them.
    rate : float
        α (1/s).

    Raises
    ------
    InputError
        At the first state, if two links of a pair overlap at q = 0.
    """

    pairs: Any = EVERY
    rate: float = RATE

    def __post_init__(self) -> None:
        if not (isinstance(self.pairs, str) and self.pairs == EVERY):
            wanted = f'"{EVERY}" or pairs of names of links'
            listed = isinstance(self.pairs, Sequence) and not isinstance(self.pairs, str)
            if not (listed and self.pairs):
                raise InputError("pairs", wanted, repr(self.pairs))
            pairs = tuple(map(tuple, self.pairs))
            for pair in pairs:
                if len(pair) != 2 or not all(isinstance(x, str) for x in pair):
                    raise InputError("pairs", wanted, repr(pair))
            object.__setattr__(self, "pairs", pairs)
        self._check()

    def _clearance(self, model: SoftModel) -> Clearance:
        robot = model.robot
        if self.pairs == EVERY:
            bodies = _bodies(model, EVERY)
            pairs = [(i, j) for (i, a), (j, b) in combinations(enumerate(bodies.solids), 2)
                     if _apart(robot, str(a.link), str(b.link))]  # fmt: skip
        else:
            bodies = _bodies(model, tuple(dict.fromkeys(name for p in self.pairs for name in p)))
            every = [solid.link for solid in bodies.solids]
            pairs = [(i, j) for pair in self.pairs for i, one in enumerate(every)
                     for j, two in enumerate(every) if (one, two) == pair]  # fmt: skip
        found = Clearance(bodies, np.array(pairs, int).reshape(-1, 2))
        start = found.smallest(model.state(model.q0, np.zeros(model.nv)))
        if start <= 0:
            got = f"two that overlap by {-1e3 * start:.3g} mm"
            raise InputError("pairs", "pairs of links that are apart at q = 0", got)
        return found


class BarrierSet:
    """Barriers of one robot, evaluated together: obstacles of the same links share their work.

    Parameters
    ----------
    model : SoftModel
        The robot.
    barriers : sequence of Callable[[State], Values]
        Barriers of this module, or others.
    """

    def __init__(self, model: SoftModel, barriers: Sequence[Callable[[State], Values]]) -> None:
        self._model, self._barriers = model, tuple(barriers)
        self._parts: list[Callable[[State], tuple[Values, np.ndarray]]] = []

    def __reduce__(self) -> tuple[Any, ...]:
        return BarrierSet, (self._model, self._barriers)

    def __call__(self, state: State) -> tuple[Values, np.ndarray]:
        """The values of all barriers, and the number of the barrier (rows,) that each is from.

        Raises
        ------
        InputError
            For a link that the robot does not have, or a link without a shape.
        """
        if not self._parts:
            self._parts = self._parted()
        found = [part(state) for part in self._parts]
        if len(found) == 1:
            return found[0]
        parts, whose = zip(*found, strict=True)
        joined = Values(*(np.concatenate(same) for same in zip(*parts, strict=True)))
        return joined, np.concatenate(whose)

    def _parted(self) -> list[Callable[[State], tuple[Values, np.ndarray]]]:
        """A function for the obstacles of the same links, and one for any other barrier."""
        shared: dict[Any, list[tuple[int, Obstacle]]] = {}
        parts: list[Callable[[State], tuple[Values, np.ndarray]]] = []
        for k, one in enumerate(self._barriers):
            if isinstance(one, Obstacle) and one.links is not None:
                shared.setdefault(one.links, []).append((k, one))
            else:
                parts.append(partial(_alone, one, k))
        for links, found in shared.items():
            which, obstacles = zip(*found, strict=True)
            clearance = Clearance(_bodies(self._model, links), [one.solid for one in obstacles])
            margin = np.array([one.margin for one in obstacles])
            reach = np.array([one._on(self._model)[1] for one in obstacles]) + margin
            rate = np.array([one.rate for one in obstacles])
            parts.append(partial(_shared, clearance, reach, rate, margin, np.array(which)))
        return parts


def _alone(barrier: Callable[[State], Values], k: int, state: State) -> tuple[Values, np.ndarray]:
    """The values of barrier k."""
    values = barrier(state)
    return values, np.full(len(values.b), k)


def _shared(
    clearance: Clearance, reach: np.ndarray, rate: np.ndarray, margin: np.ndarray,
    which: np.ndarray, state: State,
) -> tuple[Values, np.ndarray]:  # fmt: skip
    """The values of several obstacles, whose numbers are `which` (w,)."""
    values, of = clearance(state, reach, rate)
    return values._replace(b=values.b - margin[of]), which[of]


def _names(links: Any) -> Any:
    if isinstance(links, str) and links == EVERY:
        return EVERY
    if isinstance(links, str) or not isinstance(links, Sequence) or not links:
        raise InputError("links", LINKS, repr(links))
    return tuple(instance("links", name, str, LINKS) for name in links)


def _bodies(model: SoftModel, links: Any) -> Bodies:
    """The bodies of these links; barriers of the same links share them."""
    known: dict[Any, Bodies] = vars(model).setdefault("_bodies_of_links", {})
    if links not in known:
        names = [link.name for link in model.robot.links]
        for link in () if links == EVERY else links:
            if link not in names:
                expected = f"links of {model.robot.name!r}"
                raise InputError("links", expected, did_you_mean(link, names))
        wanted = None if links == EVERY else links
        known[links] = Bodies(model, link_solids(model.robot, wanted))
    return known[links]


def _apart(robot: Robot, one: str, two: str) -> bool:
    """Whether another body with mass lies between two links, so that no joint makes them touch."""
    carrier, above = moving_link_of(robot), {joint.child: joint.parent for joint in robot.joints}
    heavy = {carrier[link.name] for link in robot.links if link.mass > 0}

    def parents(link: str) -> list[str]:
        found = [carrier[link]]
        while (link := above.get(found[-1], "")) and len(found) < len(robot.links):
            found.append(carrier[link])
        return [name for name in found if name in heavy or name == found[0]]

    first, second = parents(one), parents(two)
    if first[0] == second[0]:
        return False
    return second[0] not in first[:2] and first[0] not in second[:2]
