"""A table of numbers whose keys end in their units: ``length_mm``, ``youngs_modulus_MPa``."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from typing import Any

from softdyn.checks import number
from softdyn.exceptions import InputError

UNITS: dict[str, dict[str, float]] = {
    "length": {"mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "curvature": {"per_m": 1.0, "per_mm": 1e3},
    "angle": {"deg": math.pi / 180, "rad": 1.0},
    "mass": {"g": 1e-3, "kg": 1.0},
    "density": {"kg_m3": 1.0, "g_cm3": 1e3},
    "modulus": {"MPa": 1e6, "kPa": 1e3, "GPa": 1e9, "Pa": 1.0},
    "viscosity": {"Pa_s": 1.0, "kPa_s": 1e3},
    "rigidity": {"Nm2": 1.0, "Nmm2": 1e-6},
    "force": {"N": 1.0, "mN": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3},
    "stiffness": {"Nm_rad": 1.0, "Nmm_rad": 1e-3},
    "damping": {"Nms_rad": 1.0, "Nmms_rad": 1e-3},
    "inertia": {"kgm2": 1.0, "gmm2": 1e-9},
    "cable stiffness": {"N_m": 1.0, "N_mm": 1e3},
    "cable damping": {"Ns_m": 1.0, "Ns_mm": 1e3},
    "speed": {"mm_s": 1e-3, "m_s": 1.0},
    "acceleration": {"m_s2": 1.0, "mm_s2": 1e-3},
    "angular speed": {"deg_s": math.pi / 180, "rad_s": 1.0},
    "force rate": {"N_s": 1.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
    "none": {"": 1.0},
}
"""SI value of each unit, by physical quantity; the commonest unit first."""
REQUIRED: Any = object()


class TomlTable:
    """A table of a TOML file; `finish` refuses every key that was not read.

    Parameters
    ----------
    values : mapping
        The table.
    where : str
        File and place, for messages.
    """

    def __init__(self, values: Any, where: str) -> None:
        if not isinstance(values, Mapping):
            raise InputError(where, "a table", repr(values))
        self.values, self.where = values, where
        self._known: list[str] = []

    def quantity(self, name: str, kind: str, default: Any = REQUIRED) -> Any:
        """A number in SI units; its key is `name` followed by a unit of `kind`."""
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        key, factor = found
        return self._number(key, self.values[key]) * factor

    def profile(self, name: str, kind: str, default: Any = REQUIRED) -> Any:
        """A number, or a tuple of numbers from end to end, in SI units."""
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        key, factor = found
        value = self.values[key]
        if not isinstance(value, list):
            return self._number(key, value) * factor
        if len(value) < 2:
            raise self.error(key, "one number, or two and more from end to end", value)
        return tuple(self._number(key, item) * factor for item in value)

    def vector(self, name: str, kind: str, default: Any = REQUIRED) -> Any:
        """Three numbers in SI units."""
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        key, factor = found
        value = self.values[key]
        if not isinstance(value, list) or len(value) != 3:
            raise self.error(key, "three numbers", value)
        return tuple(self._number(key, item) * factor for item in value)

    def numbers(self, name: str, kind: str, default: Any = REQUIRED) -> Any:
        """A list of at least one number, in SI units, as a tuple."""
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        key, factor = found
        value = self.values[key]
        if not isinstance(value, list) or not value:
            raise self.error(key, "a list of numbers", value)
        return tuple(self._number(key, item) * factor for item in value)

    def count(self, name: str, default: Any = REQUIRED, least: int = 1, most: int = 1000) -> Any:
        """A whole number."""
        self._known.append(name)
        if name not in self.values:
            return self._default(name, "none", default)
        value = self.values[name]
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            raise self.error(name, f"a whole number from {least} to {most}", value)
        return value

    def flag(self, name: str) -> bool:
        """True or false; false if the key is missing."""
        return self._typed(name, bool, "true or false", False)

    def text(self, name: str, default: Any = REQUIRED) -> Any:
        """A text."""
        return self._typed(name, str, "a text", default)

    def choice(self, name: str, among: Mapping[str, Any], default: Any = REQUIRED) -> Any:
        """The value in `among` of the key's word."""
        word = self._typed(name, str, " or ".join(among), default)
        if word not in among:
            raise self.error(name, " or ".join(among), repr(word))
        return among[word]

    def words(self, name: str, among: Mapping[str, Any], default: Any = REQUIRED) -> Any:
        """A list of words, none twice, as a tuple."""
        value = self._typed(name, list, "a list of words", default)
        for word in value:
            if not isinstance(word, str) or word not in among:
                raise self.error(name, " or ".join(among), repr(word))
        if len(set(value)) < len(value) or not value:
            raise self.error(name, "a list of at least one word, none twice", value)
        return tuple(value)

    def table(self, name: str) -> TomlTable | None:
        """A table below this one."""
        self._known.append(name)
        return (
            TomlTable(self.values[name], f"{self.where}: [{name}]") if name in self.values else None
        )

    def tables(self, name: str) -> list[TomlTable]:
        """The tables of an array of tables; none if it is missing."""
        self._known.append(name)
        value = self.values.get(name, [])
        if not isinstance(value, list):
            raise self.error(name, f"[[{name}]]", f"[{name}]")
        return [TomlTable(item, f"{self.where}: [[{name}]] {k}") for k, item in enumerate(value, 1)]

    def finish(self) -> None:
        """Refuse keys that were not read, and name the nearest known key."""
        for key in self.values:
            if key in self._known:
                continue
            with_unit = [one for one in self._known if one.startswith(f"{key}_")]
            near = difflib.get_close_matches(key, self._known, 1, 0.5)
            expected = f"{near[0]}?" if near else f"one of {', '.join(self._known)}"
            raise self.error(key, " or ".join(with_unit) or expected, "an unknown key")

    def error(self, key: str, expected: str, got: object) -> InputError:
        """The error to raise about a key."""
        return InputError(f"{self.where}: {key}", expected, got)

    def _typed(self, name: str, kind: type, expected: str, default: Any) -> Any:
        self._known.append(name)
        if name not in self.values:
            return self._default(name, "none", default)
        value = self.values[name]
        if not isinstance(value, kind):
            raise self.error(name, expected, repr(value))
        return value

    def _find(self, name: str, kind: str) -> tuple[str, float] | None:
        keys = {f"{name}_{unit}" if unit else name: f for unit, f in UNITS[kind].items()}
        self._known += keys
        given = [key for key in keys if key in self.values]
        if len(given) > 1:
            raise self.error(given[1], "one unit", f"{given[0]} too")
        return (given[0], keys[given[0]]) if given else None

    def _number(self, key: str, value: Any) -> float:
        try:
            return number(key, value)
        except InputError as error:
            raise self.error(key, error.expected, error.got) from None

    def _default(self, name: str, kind: str, default: Any) -> Any:
        if default is not REQUIRED:
            return default
        keys = " or ".join(f"{name}_{unit}" if unit else name for unit in UNITS[kind])
        for key in self.values:  # a misspelt key or a missing unit is more likely than no key
            near = difflib.get_close_matches(key, keys.split(" or "), 1, 0.75)
            if key not in self._known and (near or key == name):
                expected = keys if key == name else f"{near[0]}?"
                raise self.error(key, expected, "an unknown key")
        raise InputError(self.where, keys, "none")
