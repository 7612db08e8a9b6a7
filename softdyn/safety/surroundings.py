"""Obstacles around a robot, as a TOML file states them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from softdyn.checks import instances
from softdyn.description.visuals import BoxShape, SphereShape, Visual
from softdyn.dynamics.model import State
from softdyn.exceptions import InputError, errors_in
from softdyn.safety.obstacles import (
    EVERY,
    Barrier,
    HalfSpace,
    KeepOutBox,
    KeepOutSphere,
    LinkPairs,
    Obstacle,
)
from softdyn.toml_table import TomlTable

KINDS: dict[str, type[Barrier]] = {
    "half_space": HalfSpace, "sphere": KeepOutSphere, "box": KeepOutBox, "pairs": LinkPairs,
}  # fmt: skip
TIP_ALONE = "tip"
COLOUR = (0.87, 0.45, 0.2, 0.6)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Barriers of one robot, each with a name of its own.

    Attributes
    ----------
    barriers : tuple of Barrier
        Obstacles and pairs of links.
    names : tuple of str
        Their names; by default the kind and a number.
    """

    barriers: Sequence[Barrier]
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        found = instances("barriers", self.barriers, Barrier, "a Barrier")
        kinds = {kind: word for word, kind in KINDS.items()}
        usual = [kinds.get(type(one), type(one).__name__) for one in found]
        names = [one.name or f"{usual[k]}_{usual[: k + 1].count(usual[k])}"
                 for k, one in enumerate(found)]  # fmt: skip
        for name in names:
            if names.count(name) > 1:
                raise InputError("name", "a name for each obstacle", f"{name!r} twice")
        object.__setattr__(self, "barriers", found)
        object.__setattr__(self, "names", tuple(names))

    @classmethod
    def of(cls, table: Mapping[str, Any], where: str = "obstacles") -> Surroundings:
        """Obstacles of a TOML file's table: lists of tables `half_space`, `sphere`, `box`, `pairs`.

        The keys are the fields of their classes. An obstacle guards all links that move, unless
        `link` or `links` say otherwise; ``links = "tip"`` is the tip alone.

        Parameters
        ----------
        table : mapping
            The file's content.
        where : str
            The file, for messages.

        Raises
        ------
        InputError
            For an unknown key, and for all that the fields refuse.
        """
        made: list[Barrier] = []
        read = TomlTable(table, where)
        for word in read.rest(KINDS):
            kind = KINDS[word]
            for entry in read.tables(word):
                values = dict(entry.values)
                if issubclass(kind, Obstacle) and "link" not in values:
                    values.setdefault("links", EVERY)
                if values.get("links") == TIP_ALONE:
                    del values["links"]
                made.append(TomlTable(values, entry.where).make(kind))
        with errors_in(where):
            return cls(made)

    @property
    def table(self) -> dict[str, Any]:
        """Plain data from which `of` makes the same obstacles."""
        words = {kind: word for word, kind in KINDS.items()}
        found: dict[str, Any] = {}
        for barrier, name in zip(self.barriers, self.names, strict=True):
            values = {part.name: getattr(barrier, part.name) for part in fields(barrier)}
            if isinstance(barrier, Obstacle) and barrier.link is None and barrier.links is None:
                values["links"] = TIP_ALONE
            values["name"] = name
            entry = {key: value if isinstance(value, str) else np.asarray(value).tolist()
                     for key, value in values.items() if value is not None}  # fmt: skip
            found.setdefault(words[type(barrier)], []).append(entry)
        return found

    @property
    def obstacle_names(self) -> tuple[str, ...]:
        """The names of `obstacles`."""
        pairs = zip(self.names, self.barriers, strict=True)
        return tuple(name for name, one in pairs if isinstance(one, Obstacle))

    @property
    def solid_names(self) -> tuple[str, ...]:
        """The names of the obstacles that are solid in the twin."""
        pairs = zip(self.names, self.barriers, strict=True)
        return tuple(name for name, one in pairs if isinstance(one, Obstacle) and one.contact)

    def depths(self, reserve: np.ndarray, tip: np.ndarray) -> dict[str, float]:
        """How deep (m) the robot is inside each barrier at the worst of k states, if it is.

        It is so with the part that keeps clear of it. Where these are all links, the tip counts
        too, because it may lie beyond the last link's shape.

        Parameters
        ----------
        reserve : ndarray, (k, barriers)
            The values of `reserve`.
        tip : ndarray, (k, 3)
            The tip's positions (m).
        """
        found = {}
        for name, barrier, values in zip(
            self.names, self.barriers, np.transpose(reserve), strict=True
        ):
            depth = -float(values.min() + barrier.margin)
            if isinstance(barrier, Obstacle) and barrier.links == EVERY:
                depth = max(depth, -float(barrier.solid.signed(tip).min()))
            if depth > 0:
                found[name] = depth
        return found

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The barriers that are bodies of the world."""
        return tuple(one for one in self.barriers if isinstance(one, Obstacle))

    def reserve(self, state: State) -> np.ndarray:
        """The smallest value of every barrier (m), in the order of `names`."""
        return np.array([barrier.reserve(state) for barrier in self.barriers])

    def visuals(self, size: float) -> tuple[Visual, ...]:
        """The obstacles as shapes of the world; a half-space is a slab, 1.2 `size` (m) wide."""
        found = []
        for obstacle in self.obstacles:
            solid, pose = obstacle.solid, np.eye(4)
            pose[:3, :3], pose[:3, 3] = solid.rotation, solid.centre
            shape: Any = SphereShape(solid.swept)
            if isinstance(obstacle, HalfSpace):
                shape = BoxShape((1.2 * size, 1.2 * size, thick := 0.01 * size))
                pose[:3, 3] -= thick / 2 * solid.rotation[:, 2]
            elif solid.half.any():
                x, y, z = (2 * solid.half).tolist()
                shape = BoxShape((x, y, z))
            found.append(Visual("", pose, shape, COLOUR))
        return tuple(found)
