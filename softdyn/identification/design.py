"""Identify the numbers of a design: those in the TOML file from which `softdyn new` makes an arm.

Any number in the file may be unknown. Its kind is its key without the unit, its member is the place
in the file: ``offset cable left [2]`` is the second entry of ``offset_mm`` in the ``[[cable]]``
called left. Values are in SI units.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.checks import did_you_mean, number
from softdyn.description.robot import Robot
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.design import arm_file
from softdyn.design.arm_table import read_arm
from softdyn.design.layout import Layout, lay_out
from softdyn.design.source import make_arm, read
from softdyn.dynamics.forces import copied_forces
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError, errors_in
from softdyn.files import MAX_TOML, as_path, read_bytes, read_toml
from softdyn.identification.markers.points import marked, markers_of, read_points
from softdyn.identification.parameters import Parameter, distinct, parameters
from softdyn.identification.unknowns.kinds import INPUT_LOSS, Kind
from softdyn.toml_table import UNITS, TomlTable

KEPT = 64  # models
KEYS = {"cable_friction": "friction", "sensor_bias": "bias", "sensor_latency": "latency"}
MARKERS = ("point", "pose")  # tables of the markers' file
COUNTS = ("segments", "discs", "disc", "count")  # whole numbers, not to be identified
SUFFIX = {
    suffix: (next(one for one, factor in units.items() if factor == 1.0), units[suffix])
    for units in UNITS.values()
    for suffix in units
    if suffix
}


@dataclass(frozen=True)
class Entry:
    """One number of the file.

    Attributes
    ----------
    path : tuple
        Keys and indices that lead to it.
    label : str
        Kind and member.
    words : frozenset of str
        Words that choose it: its key without the unit, names of its tables, its place in a list.
    unit : str
        SI unit.
    factor : float
        SI value of the file's unit.
    """

    path: tuple[str | int, ...]
    label: str
    words: frozenset[str]
    unit: str
    factor: float

    def chosen_by(self, parts: Sequence[str]) -> bool:
        """Whether the words choose it; a marker's place needs the word point or pose."""
        asked = self.path[0] not in MARKERS or self.path[0] in parts
        return asked and parts[0] == self.kind and set(parts) <= self.words

    @property
    def kind(self) -> str:
        """Its key without the unit."""
        return self.label.partition(" ")[0]


class DesignFile:
    """An arm's TOML file with numbers to identify, and the markers on the arm.

    The places of the markers may be unknown, too.

    Parameters
    ----------
    path : str or Path
    points : str or Path, optional
        The file of the markers.
    forces : sequence of Force
        Forces of one's own that act on the arm.

    Raises
    ------
    InputError
        For a file from which no robot can be made.
    """

    def __init__(
        self, path: str | Path, points: str | Path | None = None, *, forces: Sequence[Any] = ()
    ) -> None:
        self.forces = copied_forces(forces)
        self.path = as_path("path", path)
        self.points = None if points is None else as_path("points", points)
        self.table = read_toml(self.path)
        if "section" in self.table:
            make_arm(self.table, str(self.path))  # refuses numbers that no soft arm has
        if self.points is not None:
            read_points(self.points)
            self.table |= read_toml(self.points)
        self.entries = {one.label: one for one in _entries(self.table, (), ())}
        self._made: dict[tuple[tuple[str, float], ...], tuple[SoftModel, Layout | None]] = {}
        self.model: SoftModel = self.model_of({})
        names = tuple(self.entries)
        nominal = np.array([self._value(one) for one in self.entries.values()])
        self.kind = Kind(
            "design", "", lambda model: names, lambda model: nominal,
            lambda sample: np.zeros((len(sample.a), len(names))), lambda robot, values: robot,
            maker=self,
        )  # fmt: skip

    def unknowns(
        self, free: Sequence[str] = (), shared: Sequence[str] = ()
    ) -> tuple[Parameter, ...]:
        """Unknown numbers; a word is a key without its unit, with more words after dots.

        ``offset`` means all offsets, ``offset.2`` second entries, ``offset.left`` those of the
        table called left, ``s.point`` the places of all markers,
        ``force.drag.size`` a number of a force of one's own.

        Parameters
        ----------
        free, shared : sequence of str
            Words with one unknown for each number, and words with one factor for all.

        Raises
        ------
        InputError
            For words that no number of the file has, no words, and a number in two unknowns.
        """
        found: list[Parameter] = []
        labels, nominal = list(self.entries), self.kind.nominal(self.model)
        for word, common in [(word, False) for word in free] + [(word, True) for word in shared]:
            if word.partition(".")[0] in (INPUT_LOSS.name, "force"):
                found += parameters(self.model, word, shared=common)
                continue
            parts = [KEYS.get(part, part) for part in word.split(".")]
            own = np.array([one.chosen_by(parts) for one in self.entries.values()])
            if not own.any():
                known = {one.kind for one in self.entries.values()}
                raise InputError(word, f"a number in {self.path}", did_you_mean(word, known))
            if parts[0] == "friction" and not nominal[own].all():
                raise InputError(word, "a first guess above 0 in the file", "0")
            if common:
                found.append(Parameter(self.kind, f"{word}, all", np.where(own, nominal, 0), 1.0))
            else:
                found += [
                    Parameter(self.kind, labels[k], np.eye(len(labels))[k], float(nominal[k]))
                    for k in np.flatnonzero(own)
                ]
        if not found:
            raise InputError("--free", "numbers of the design, such as youngs_modulus", "none")
        distinct(found)
        return tuple(found)

    def unit(self, label: str) -> str:
        """SI unit of a number."""
        return self.entries[label].unit if label in self.entries else ""

    def robot(self, values: Mapping[str, float]) -> Robot:
        """The robot with other values (SI), by label, and its markers."""
        return self.model_of(values).robot

    def model_of(self, values: Mapping[str, float]) -> SoftModel:
        """The model with other values (SI), by label; see `Maker`.

        The last models are kept. Those that differ in the places of markers share their engine.
        """
        places = {one for one in values if self.entries[one].path[0] in MARKERS}
        key = tuple(sorted((one, value) for one, value in values.items() if one not in places))
        if key not in self._made:
            for old in list(self._made)[: 1 - KEPT]:
                del self._made[old]
            self._made[key] = self._build(self.changed(dict(key)))
        bare, layout = self._made[key]
        if self.points is None:
            return bare
        table = self.changed({one: values[one] for one in places})
        markers = markers_of({one: table[one] for one in MARKERS if one in table}, str(self.points))
        marks = copy.copy(bare)
        vars(marks).pop("_sensors", None)
        vars(marks)["robot"] = marked(bare.robot, markers, layout)
        return marks

    def _build(self, table: dict[str, Any]) -> tuple[SoftModel, Layout | None]:
        """The model of a table without its markers, and the layout of an arm of sections."""
        table = {key: value for key, value in table.items() if key not in MARKERS}
        with errors_in(where := str(self.path)):
            layout = lay_out(read_arm(TomlTable(table, where))) if "section" in table else None
            text = read(table, where).text if layout is None else write(arm_file.robot(layout))
            robot = parse_text(text, path=self.path.with_suffix(".urdf"))
            return build(replace(robot, forces=self.forces)), layout

    def changed(self, values: Mapping[str, float]) -> dict[str, Any]:
        """The file's table with other values (SI), by label."""
        table = copy.deepcopy(self.table)
        self._set(table, values)
        return table

    def rewrite(self, values: Mapping[str, float]) -> str:
        """The file's text with other values (SI), by label; comments and the layout stay.

        Places of markers are left out.
        """
        import tomlkit  # only this needs it

        own = {k: v for k, v in values.items() if self.entries[k].path[0] not in MARKERS}
        document = tomlkit.parse(read_bytes(self.path, MAX_TOML).decode())
        self._set(document, own)
        return tomlkit.dumps(document)

    def _set(self, table: Any, values: Mapping[str, float]) -> None:
        """Change numbers of a table of the file's form in place."""
        for label, value in values.items():
            entry = self.entries[label]
            *tables, last = entry.path
            _at(table, tables)[last] = float(f"{number(label, value) / entry.factor:.12g}")

    def _value(self, entry: Entry) -> float:
        return float(_at(self.table, entry.path)) * entry.factor


def _at(table: Any, path: Iterable[str | int]) -> Any:
    """The value in a table to which a path leads."""
    for key in path:
        table = table[key]
    return table


def _entries(part: Any, path: tuple[str | int, ...], words: tuple[str, ...]) -> Iterator[Entry]:
    """The numbers below a table."""
    for key, value in part.items():
        if isinstance(value, Mapping):
            yield from _entries(value, (*path, key), (*words, key))
        elif isinstance(value, list) and value and all(isinstance(one, Mapping) for one in value):
            for k, one in enumerate(value):
                name = str(one.get("name", f"{key}_{k + 1}"))
                yield from _entries(one, (*path, key, k), (*words, key, name))
        elif key not in COUNTS:
            several = value if isinstance(value, list) else [value]
            for k, one in enumerate(several):
                if isinstance(one, bool) or not isinstance(one, int | float):
                    continue
                stem, unit, factor = _without_unit(key)
                place = (*words, f"[{k + 1}]") if isinstance(value, list) else words
                own = (*path, key, k) if isinstance(value, list) else (*path, key)
                label = " ".join((stem, *place)) if place else f"{stem} arm"
                chosen = frozenset((stem, *words, str(k + 1)))
                yield Entry(own, label, chosen, unit, factor)


def _without_unit(key: str) -> tuple[str, str, float]:
    """A key without its unit, the SI unit, and the SI value of the key's unit."""
    for k in (i for i, letter in enumerate(key) if letter == "_"):
        if key[k + 1 :] in SUFFIX:
            return key[:k], *SUFFIX[key[k + 1 :]]
    return key, "", 1.0
