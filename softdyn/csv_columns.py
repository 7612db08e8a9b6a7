"""Columns of numbers from a CSV file whose header names them, with units as in a log's CSV."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softdyn.exceptions import InputError
from softdyn.files import as_path, read_bytes

MAX_BYTES, MAX_ROWS = 256_000_000, 1_000_000
UNIT = re.compile(r"\s*\(([^()]*)\)$")  # the unit after a column's name, as in a log's CSV
UNITS = {
    "t": ("s",), "q": ("rad", "m"), "tip": ("m",), "length": ("m",), "point": ("m",),
    "pose": ("m", "rad"),
}  # fmt: skip


def columns(path: str | Path) -> tuple[list[str], list[str], list[list[str]]]:
    """The titles of a CSV file, the columns' names without units, and the rows of cells.

    Raises
    ------
    InputError
        A file that cannot be read or has too many rows, a row of another length than the header, a
        unit in which the numbers are not read.
    """
    try:
        lines = read_bytes(as_path("path", path), MAX_BYTES).decode("utf-8-sig").splitlines()
        rows = [row for _, row in zip(range(MAX_ROWS + 2), csv.reader(lines), strict=False)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), "a CSV file", error) from None
    rows = [row for row in rows if row]
    if len(rows) > MAX_ROWS + 1:
        raise InputError(str(path), f"at most {MAX_ROWS} rows", "more")
    titles = [title.strip() for title in rows[0]] if rows else []
    header = [_without_unit(path, title) for title in titles]
    for line, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise InputError(f"{path}:{line}", f"{len(header)} cells", f"{len(row)}")
    return titles, header, rows[1:]


def once(path: str | Path, header: Sequence[str], names: Sequence[str]) -> None:
    """Refuse a header that does not have each of `names` exactly once."""
    for name in names:
        if (count := list(header).count(name)) != 1:
            raise InputError(str(path), f"one column {name}", f"{count} of them")


def numbers(
    path: str | Path,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    gaps: tuple[str, ...] = (),
) -> np.ndarray:
    """The rows' cells as finite numbers (rows, columns).

    Cells of columns whose names begin with one of `gaps` may be empty; they become NaN.

    Raises
    ------
    InputError
        A cell that is no finite number; the error names its line and column.
    """
    return np.array([_numbers(path, header, line, row, gaps) for line, row in enumerate(rows, 2)])


def _without_unit(path: str | Path, title: str) -> str:
    """A column's name; a unit in its title has to be the one that the numbers are read in."""
    name, found = UNIT.sub("", title), UNIT.search(title)
    units = UNITS.get(name.partition(".")[0])
    if found and units and found[1] not in units:
        raise InputError(f"{path}: header", f"{name} in {' or '.join(units)}", repr(title))
    return name


def _numbers(
    path: str | Path,
    header: Sequence[str],
    line: int,
    row: Sequence[str],
    gaps: tuple[str, ...],
) -> list[float]:
    values = []
    for name, text in zip(header, row, strict=True):
        if name.startswith(gaps) and not text.strip():
            values.append(np.nan)
            continue
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(f"{path}:{line}: column {name}", "a finite number", repr(text))
        values.append(value)
    return values
