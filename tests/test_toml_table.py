"""`TomlTable`: numbers with units, and one style of message for all that is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from softdyn import InputError
from softdyn.toml_table import UNITS, TomlTable

ONE = {  # number of units in one SI unit
    "length": {"m": 1, "cm": 100, "mm": 1000},
    "curvature": {"per_m": 1, "per_mm": 1e-3},
    "angle": {"rad": 1, "deg": 57.29577951308232},
    "mass": {"kg": 1, "g": 1000},
    "density": {"kg_m3": 1, "g_cm3": 1e-3},
    "modulus": {"Pa": 1, "kPa": 1e-3, "MPa": 1e-6, "GPa": 1e-9},
    "viscosity": {"Pa_s": 1, "kPa_s": 1e-3},
    "rigidity": {"Nm2": 1, "Nmm2": 1e6},
    "force": {"N": 1, "mN": 1000},
    "time": {"s": 1, "ms": 1000},
    "stiffness": {"Nm_rad": 1, "Nmm_rad": 1000},
    "damping": {"Nms_rad": 1, "Nmms_rad": 1000},
    "inertia": {"kgm2": 1, "gmm2": 1e9, "gcm2": 1e7},
    "cable stiffness": {"N_m": 1, "N_mm": 1e-3},
    "cable damping": {"Ns_m": 1, "Ns_mm": 1e-3},
    "speed": {"m_s": 1, "mm_s": 1000},
    "acceleration": {"m_s2": 1, "mm_s2": 1000},
    "angular speed": {"rad_s": 1, "deg_s": 57.29577951308232},
    "force rate": {"N_s": 1},
    "pressure": {"Pa": 1, "kPa": 1e-3, "bar": 1e-5, "MPa": 1e-6, "psi": 1.450377377302092e-4},
    "pressure rate": {"Pa_s": 1, "kPa_s": 1e-3, "bar_s": 1e-5},
    "area": {"m2": 1, "cm2": 1e4, "mm2": 1e6},
    "frequency": {"Hz": 1, "kHz": 1e-3},
    "none": {"": 1},
}


def test_every_unit_in_si():
    assert {kind: set(units) for kind, units in UNITS.items()} == {
        k: set(v) for k, v in ONE.items()
    }
    for kind, units in ONE.items():
        for unit, value in units.items():
            key = f"x_{unit}" if unit else "x"
            assert TomlTable({key: value}, "t").number("x", kind) == pytest.approx(1, rel=1e-14)


@dataclass(frozen=True)
class Spring:
    """A dataclass to make from a table."""

    stiffness: float
    rest: float = 0.0
    owner: str = ""

    def __post_init__(self) -> None:
        if self.stiffness < 0:
            raise InputError("stiffness", "a number >= 0", self.stiffness)


def test_a_dataclass_from_the_keys_that_are_left(tmp_path: Path) -> None:
    file = tmp_path / "spring.toml"
    file.write_text("length_mm = 3\nstiffness = 2\n")
    table = TomlTable.read(file)
    assert table.number("length", "length", lower=0.0) == 0.003
    assert table.make(Spring, owner="me") == Spring(2, owner="me")
    assert TomlTable({"a": 1, "b": 2, "c": 3}, "t").rest(["c", "b", "a"]) == {
        "a": 1,
        "b": 2,
        "c": 3,
    }


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, "f: expected length_mm or length_cm or length_m, got none"),
        ({"length": 1}, "f: length: expected length_mm or length_cm or length_m, got 'len"),
        ({"lenght_mm": 1}, "got 'lenght_mm'; did you mean 'length_mm'?"),
        ({"length_mm": "1"}, "f: length_mm: expected a finite number, got '1'"),
        ({"length_mm": True}, "f: length_mm: expected a finite number, got True"),
        ({"length_m": 3}, "f: length_m: expected a finite number >= 0 and <= 2, got 3"),
        ({"length_m": 1e308, "stiffness": 1}, "length_m: expected a finite number >= 0 and <= 2"),
        ({"length_m": 1, "length_cm": 1}, "f: length_m: expected one unit, got length_cm too"),
        ({"length_m": 1}, "f: expected stiffness, got none"),
        ({"length_m": 1, "stiffness": 1, "rset": 1},
         "f: rset: expected one of length_mm, stiffness, rest, got 'rset'; did you mean 'rest'?"),
        ({"length_m": 1, "stiffness": 1, "owner": 1}, "f: owner: expected one of length_mm, "),
        ({"length_m": 1, "stiffness": -1}, "f: stiffness: expected a number >= 0, got -1"),
        ([1], "f: expected a table, got [1]"),
    ],
)  # fmt: skip
def test_a_misuse_is_one_line(values: object, said: str) -> None:
    def read() -> None:
        table = TomlTable(values, "f")
        table.number("length", "length", lower=0.0, upper=2.0)
        table.make(Spring, owner="me")

    with pytest.raises(InputError) as caught:
        read()
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"n": 3.0}, "n: expected a whole number from 1 to 9, got 3.0"),
        ({"n": True}, "n: expected a whole number from 1 to 9, got True"),
        ({"n": 10}, "n: expected a whole number from 1 to 9, got 10"),
        ({"on": 1}, "on: expected true or false, got 1"),
        ({"v": [1, 2]}, "v: expected three numbers, got [1, 2]"),
        ({"word": "rad"}, "word: expected red or blue, got 'rad'; did you mean 'red'?"),
        ({"words": ["red", "red"]}, "words: expected a list of at least one word, none twice"),
        ({"inner": 1}, "f: [inner]: expected a table, got 1"),
        ({"items": {}}, "f: items: expected [[items]], got [items]"),
        ({"items": 3}, "f: items: expected [[items]], got 3"),
        ({"items": [{"x": 1}]}, "f: [[items]] 1: x: expected no key, got 'x'"),
    ],
)
def test_other_kinds_of_values(values: dict[str, object], said: str) -> None:
    colours = {"red": 1, "blue": 2}

    def read() -> None:
        table = TomlTable(values, "f")
        table.count("n", 3, most=9)
        table.flag("on")
        table.vector("v", default=None)
        table.choice("word", colours, "red")
        table.words("words", colours, ["red"])
        table.table("inner")
        for item in table.tables("items"):
            item.rest()

    with pytest.raises(InputError) as caught:
        read()
    assert said in str(caught.value)
