"""The one reader of TOML tables: each value is checked, and a key that nobody reads is refused.

Every message names the file, the table and the key, what was expected and what was got. Where a key
has a unit at its end, such as ``length_mm``, the value is converted to SI units.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

from softdyn.checks import did_you_mean, number
from softdyn.exceptions import InputError, errors_in
from softdyn.files import as_path, read_toml
from softdyn.formats import without_format

UNITS: dict[str, dict[str, float]] = {
    "length": {"mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "curvature": {"per_m": 1.0, "per_mm": 1e3},
    "angle": {"deg": math.pi / 180, "rad": 1.0},
    "mass": {"g": 1e-3, "kg": 1.0},
    "density": {"kg_m3": 1.0, "g_cm3": 1e3},
    "modulus": {"MPa": 1e6, "kPa": 1e3, "GPa": 1e9, "Pa": 1.0},
    "pressure": {"kPa": 1e3, "bar": 1e5, "Pa": 1.0, "MPa": 1e6, "psi": 6894.757293168361},
    "pressure rate": {"kPa_s": 1e3, "bar_s": 1e5, "Pa_s": 1.0},
    "area": {"mm2": 1e-6, "cm2": 1e-4, "m2": 1.0},
    "viscosity": {"Pa_s": 1.0, "kPa_s": 1e3},
    "rigidity": {"Nm2": 1.0, "Nmm2": 1e-6},
    "force": {"N": 1.0, "mN": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3},
    "stiffness": {"Nm_rad": 1.0, "Nmm_rad": 1e-3},
    "damping": {"Nms_rad": 1.0, "Nmms_rad": 1e-3},
    "inertia": {"kgm2": 1.0, "gmm2": 1e-9, "gcm2": 1e-7},
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
Kind = TypeVar("Kind")


class TomlTable:
    """A table of a TOML file, or any mapping that has its form.

    A reader takes the keys that it knows and calls `rest` or `make` at the end. Both refuse the
    keys that nobody took. Each method raises an `InputError` about a missing or bad value.

    Parameters
    ----------
    values : mapping
        The table.
    where : str
        File and table, for messages.

    Raises
    ------
    InputError
        For anything but a mapping, and for a table that states another format than softdyn reads.
    """

    def __init__(self, values: Any, where: str) -> None:
        if not isinstance(values, Mapping):
            raise InputError(where, "a table", repr(values))
        self.values, self.where = without_format(values, where), where
        self._known: list[str] = []  # keys that were asked for
        self._usual: list[str] = []  # the same, each with its commonest unit alone

    @classmethod
    def read(cls, path: str | Path) -> TomlTable:
        """The table in a TOML file; see `read_toml`."""
        return cls(read_toml(as_path("path", path)), str(path))

    # -- values ------------------------------------------------------------------------------------

    def number(self, name: str, kind: str = "none", default: Any = REQUIRED, **bounds: Any) -> Any:
        """A number in SI units; its key is `name` followed by a unit of `kind`.

        `bounds` are those of `softdyn.checks.number`, in SI units.
        """
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        key, factor = found
        return self._number(key, self.values[key], factor, **bounds)

    def profile(self, name: str, kind: str, default: Any = REQUIRED) -> Any:
        """A number, or a tuple of numbers from end to end, in SI units."""
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        key, factor = found
        value = self.values[key]
        if not isinstance(value, list):
            return self._number(key, value, factor)
        return self._numbers(key, factor, "one number, or two and more from end to end", least=2)

    def vector(self, name: str, kind: str = "none", default: Any = REQUIRED) -> Any:
        """Three numbers in SI units, as a tuple."""
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        return self._numbers(*found, "three numbers", least=3, most=3)

    def numbers(self, name: str, kind: str = "none", default: Any = REQUIRED) -> Any:
        """A list of at least one number, in SI units, as a tuple."""
        found = self._find(name, kind)
        if found is None:
            return self._default(name, kind, default)
        return self._numbers(*found, "a list of numbers")

    def rows(self, name: str, kind: str, width: int) -> list[tuple[float, ...]] | None:
        """A list of lists of `width` numbers, the last in SI units; None if the key is missing."""
        found = self._find(name, kind)
        if found is None:
            return None
        key, factor = found
        expected, value = f"a list of lists of {width} numbers", self.values[key]
        fits = isinstance(value, list) and value
        if not fits or any(not isinstance(row, list) or len(row) != width for row in value):
            raise self.error(key, expected, repr(value))
        factors = [*[1.0] * (width - 1), factor]
        return [
            tuple(self._number(key, x, by) for x, by in zip(row, factors, strict=True))
            for row in value
        ]

    def count(self, name: str, default: Any = REQUIRED, least: int = 1, most: int = 1000) -> Any:
        """A whole number."""
        expected = f"a whole number from {least} to {most}"
        value = self._typed(name, int, expected, default)
        if name in self.values and (isinstance(value, bool) or not least <= value <= most):
            raise self.error(name, expected, value)
        return value

    def flag(self, name: str) -> bool:
        """True or false; false if the key is missing."""
        return bool(self._typed(name, bool, "true or false", False))

    def text(self, name: str, default: Any = REQUIRED) -> Any:
        """A text."""
        return self._typed(name, str, "a text", default)

    def choice(self, name: str, choices: Mapping[str, Any], default: Any = REQUIRED) -> Any:
        """The value in `choices` of the key's word."""
        word = self._typed(name, str, " or ".join(choices), default)
        if word not in choices:
            raise self.error(name, " or ".join(choices), did_you_mean(word, choices))
        return choices[word]

    def words(self, name: str, choices: Mapping[str, Any], default: Any = REQUIRED) -> Any:
        """A list of words, none twice, as a tuple."""
        value = self._typed(name, list, "a list of words", default)
        for word in value:
            if not isinstance(word, str) or word not in choices:
                raise self.error(name, " or ".join(choices), did_you_mean(str(word), choices))
        if len(set(value)) < len(value) or not value:
            raise self.error(name, "a list of at least one word, none twice", value)
        return tuple(value)

    def names(
        self, name: str, default: Any = REQUIRED, choices: Collection[str] = ()
    ) -> tuple[str, ...]:
        """A text, or a list of distinct texts, as a tuple; only `choices`, if there are any."""
        expected = "a text, or a list of distinct texts"
        value = self._typed(name, (str, list), expected, default)
        found = [value] if isinstance(value, str) else value
        fits = all(isinstance(one, str) and one for one in found)
        if not fits or len(set(found)) < len(found) or (name in self.values and not found):
            raise self.error(name, expected, repr(value))
        for one in found if choices else ():
            if one not in choices:
                raise self.error(name, f"any of {', '.join(choices)}", did_you_mean(one, choices))
        return tuple(found)

    # -- tables ------------------------------------------------------------------------------------

    def table(self, name: str) -> TomlTable | None:
        """A table below this one; None if it is missing."""
        self._ask([name])
        if name not in self.values:
            return None
        return TomlTable(self.values[name], f"{self.where}: [{name}]")

    def needed(self, name: str) -> TomlTable:
        """A table below this one that must be there."""
        found = self.table(name)
        return self._default(f"[{name}]", "none", REQUIRED) if found is None else found

    def tables(self, name: str) -> list[TomlTable]:
        """The tables of an array of tables; none if it is missing."""
        self._ask([name])
        value = self.values.get(name, [])
        if not isinstance(value, list):
            got = f"[{name}]" if isinstance(value, Mapping) else repr(value)
            raise self.error(name, f"[[{name}]]", got)
        return [TomlTable(item, f"{self.where}: [[{name}]] {k}") for k, item in enumerate(value, 1)]

    # -- all that is left --------------------------------------------------------------------------

    def rest(self, names: Collection[str] = ()) -> dict[str, Any]:
        """The values that nobody took, in the file's order; only `names` may be among them."""
        left = {key: value for key, value in self.values.items() if key not in self._known}
        for key in left:
            if key not in names:
                known = list(dict.fromkeys([*self._usual, *names]))
                got = did_you_mean(str(key), dict.fromkeys([*self._known, *names]))
                listed = f"one of {', '.join(known)}" if known else "no key"
                raise self.error(key, self._with_unit(key) or listed, got)
        return left

    def make(self, kind: type[Kind], **given: Any) -> Kind:
        """An object of a dataclass whose other fields than `given` are the keys that are left."""
        parts = [part for part in fields(kind) if part.name not in given]  # type: ignore[arg-type]
        values = self.rest([part.name for part in parts])
        for part in parts:
            optional = part.default is not MISSING or part.default_factory is not MISSING
            if not optional and part.name not in values:
                raise InputError(self.where, part.name, "none")
        with errors_in(self.where):
            return kind(**values, **given)

    def error(self, key: str, expected: str, got: object) -> InputError:
        """The error to raise about a key."""
        return InputError(f"{self.where}: {key}", expected, got)

    # -- keys --------------------------------------------------------------------------------------

    def _ask(self, keys: list[str]) -> None:
        self._known += keys
        self._usual += keys[:1]

    def _typed(self, name: str, kind: Any, expected: str, default: Any) -> Any:
        self._ask([name])
        if name not in self.values:
            return self._default(name, "none", default)
        value = self.values[name]
        if not isinstance(value, kind):
            raise self.error(name, expected, repr(value))
        return value

    def _find(self, name: str, kind: str) -> tuple[str, float] | None:
        keys = {f"{name}_{unit}" if unit else name: f for unit, f in UNITS[kind].items()}
        self._ask(list(keys))
        given = [key for key in keys if key in self.values]
        if len(given) > 1:
            raise self.error(given[1], "one unit", f"{given[0]} too")
        return (given[0], keys[given[0]]) if given else None

    def _number(self, key: str, value: Any, factor: float, **bounds: Any) -> float:
        try:
            return number(key, number(key, value) * factor, **bounds)
        except InputError as error:
            raise self.error(key, error.expected, error.got) from None

    def _numbers(
        self, key: str, factor: float, expected: str, least: int = 1, most: float = math.inf
    ) -> tuple[float, ...]:
        value = self.values[key]
        if not isinstance(value, list) or not least <= len(value) <= most:
            raise self.error(key, expected, repr(value))
        return tuple(self._number(key, item, factor) for item in value)

    def _with_unit(self, key: str) -> str:
        """The keys that a key without its unit may mean."""
        meant = (f"{key}_{unit}" for units in UNITS.values() for unit in units)
        return " or ".join(dict.fromkeys(one for one in meant if one in self._known))

    def _default(self, name: str, kind: str, default: Any) -> Any:
        if default is not REQUIRED:
            return default
        keys = [f"{name}_{unit}" if unit else name for unit in UNITS[kind]]
        for key in self.values:  # a misspelt key or a missing unit is more likely than no key
            near = difflib.get_close_matches(key, keys, 1, 0.75)
            if key not in self._known and (near or key == name):
                got = did_you_mean(key, near) if near else f"{key!r}, without a unit"
                raise self.error(key, " or ".join(keys), got)
        raise InputError(self.where, " or ".join(keys), "none")
