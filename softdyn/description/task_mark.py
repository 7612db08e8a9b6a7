"""A task of a link's frame as pages and logs know it, without any engine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn.checks import array
from softdyn.description.stated_task import TaskKind
from softdyn.exceptions import InputError


@dataclass(frozen=True)
class TaskMark:
    """A task of a link's frame, as far as a picture of it and its target needs.

    Its target is a row of numbers: a point x y z (m), a rotation vector rx ry rz (rad), both, or a
    direction dx dy dz, all in the world.

    Attributes
    ----------
    name, link : str
        The task's name, and its link.
    kind : TaskKind
        The quantity.
    vector : tuple of float
        In the link's frame: the direction of an axis, else the origin of the frame (m).
    """

    name: str
    link: str
    kind: TaskKind
    vector: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, table: Any) -> TaskMark:
        """A mark from its `table`.

        Raises
        ------
        InputError
            For anything that is no such table.
        """
        kinds = [kind.value for kind in TaskKind]
        if not isinstance(table, Mapping) or set(table) != {"name", "link", "kind", "vector"}:
            raise InputError("mark", "name, link, kind and vector", repr(table))
        name, link, kind = (table[key] for key in ("name", "link", "kind"))
        if not (isinstance(name, str) and isinstance(link, str) and kind in kinds):
            raise InputError("mark", f"texts, and a kind of {', '.join(kinds)}", repr(table))
        x, y, z = array("mark: vector", table["vector"], (3,)).tolist()
        return cls(name, link, TaskKind(kind), (x, y, z))

    @property
    def table(self) -> dict[str, Any]:
        """The mark as plain data."""
        return vars(self) | {"kind": self.kind.value, "vector": list(self.vector)}

    @property
    def placed(self) -> bool:
        """Whether its target begins with a point."""
        return self.kind in (TaskKind.POSITION, TaskKind.POSE)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its target's numbers, as those of `read_paths`."""
        parts = ("dx", "dy", "dz") if self.kind is TaskKind.AXIS else self.kind.rows
        return tuple(f"{self.name}.{part}" for part in parts)

    def check(self, values: np.ndarray, reach: float) -> None:
        """Refuse numbers that no mouse drags to.

        Raises
        ------
        InputError
            For a coordinate beyond `reach` (m), a turn of more than π, or no unit vector.
        """
        at = f"target of {self.name!r}"
        if self.placed and np.abs(values[:3]).max() > reach:
            raise InputError(at, f"a point within {reach:g} m", values[:3].tolist())
        size = math.hypot(*values[-3:].tolist())
        if self.kind in (TaskKind.ORIENTATION, TaskKind.POSE) and size > math.pi + 1e-6:
            raise InputError(at, "a turn of at most pi", values[-3:].tolist())
        if self.kind is TaskKind.AXIS and not abs(size - 1) < 1e-6:
            raise InputError(at, "a unit vector", values.tolist())
