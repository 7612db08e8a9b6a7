"""The one reader of CSV files: columns of numbers, named by a header, with units as in a log's."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softdyn.exceptions import FormatError, InputError
from softdyn.files import as_path, read_bytes
from softdyn.formats import CSV, KEY, check_format, is_format

FORMAT = "a CSV file in UTF-8, with commas between cells, decimal points and a header"
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
SEPARATORS = {
    ";": "semicolons between cells",
    "\t": "tabs between cells",
    "|": "bars between cells",
}
MAX_BYTES, MAX_ROWS = 256_000_000, 1_000_000
UNIT = re.compile(r"\s*\(([^()]*)\)$")  # the unit after a column's name, as in a log's CSV
UNITS = {
    "t": ("s",), "q": ("rad", "m"), "tip": ("m",), "length": ("m",), "point": ("m",),
    "pose": ("m", "rad"), "x": ("m",), "y": ("m",), "z": ("m",),
}  # fmt: skip


class CsvTable:
    """A CSV file with a header. Rows without any cell are left out, and so is a column ``format``.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    path : str
        The file, for messages.
    titles : list of str
        The titles of the columns.
    names : list of str
        The same without units.

    Raises
    ------
    FormatError
        A file that is no CSV or of another version, a row of another length than the header.
    InputError
        A file that cannot be read or has too many rows, a unit in which the numbers are not read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = str(as_path("path", path))
        data = read_bytes(path, MAX_BYTES)
        if said := other_format(data):
            raise FormatError(self.path, FORMAT, said)
        try:
            reader = csv.reader(data.decode("utf-8-sig").splitlines())
            lines = zip(range(MAX_ROWS + 2), reader, strict=False)
            rows = [(reader.line_num, row) for _, row in lines if row]
        except (UnicodeDecodeError, csv.Error) as error:
            raise FormatError(self.path, FORMAT, error) from None
        if len(rows) > MAX_ROWS + 1:
            raise InputError(self.path, f"at most {MAX_ROWS} rows", "more")
        self.titles = [title.strip() for title in rows[0][1]] if rows else []
        self.names = [self._without_unit(title) for title in self.titles]
        self._rows = rows[1:]
        for line, row in self._rows:
            if len(row) != len(self.names):
                split = len(row) == 2 * len(self.names)
                got = f"{len(row)}{': decimal commas?' if split else ''}"
                raise FormatError(f"{self.path}:{line}", f"{len(self.names)} cells", got)
        self._leave_format_out()

    def __len__(self) -> int:
        """The number of rows below the header."""
        return len(self._rows)

    def once(self, names: Sequence[str]) -> None:
        """Refuse a header that does not have each of `names` exactly once."""
        for name in names:
            if (count := self.names.count(name)) != 1:
                raise InputError(self.path, f"one column {name}", f"{count} of them")

    def numbers(self, names: Sequence[str], gaps: tuple[str, ...] = ()) -> np.ndarray:
        """The columns `names` as finite numbers (rows, columns).

        Cells of columns whose names begin with one of `gaps` may be empty; they become NaN.

        Raises
        ------
        InputError
            A column that is not there exactly once, and a cell that is no finite number; the error
            names its line and column.
        """
        self.once(names)
        columns = [(name, self.names.index(name), name.startswith(gaps)) for name in names]
        found = [
            [self._number(line, name, row[k], gap) for name, k, gap in columns]
            for line, row in self._rows
        ]
        return np.array(found, float).reshape(len(found), len(names))

    def cells(self, title: str) -> list[str]:
        """The cells of the first column of this title, as they are written."""
        k = self.titles.index(title)
        return [row[k] for _, row in self._rows]

    def _leave_format_out(self) -> None:
        """Check and forget the column that states the format in its first row."""
        if KEY not in self.titles or not self._rows:
            return
        k = self.titles.index(KEY)
        if is_format(said := self._rows[0][1][k].strip()):
            check_format(said, CSV, self.path, "a table")
            for row in (self.titles, self.names, *(row for _, row in self._rows)):
                del row[k]

    def _number(self, line: int, name: str, text: str, gap: bool) -> float:
        if gap and not text.strip():
            return np.nan
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            comma = ": a decimal comma?" if DECIMAL_COMMA.fullmatch(text.strip()) else ""
            got = f"{text!r}{comma}"
            raise InputError(f"{self.path}:{line}: column {name}", "a finite number", got)
        return value

    def _without_unit(self, title: str) -> str:
        """A column's name; a unit in its title has to be the one that the numbers are read in."""
        name, found = UNIT.sub("", title), UNIT.search(title)
        units = UNITS.get(name.partition(".")[0])
        if found and units and found[1] not in units:
            raise InputError(f"{self.path}: header", f"{name} in {' or '.join(units)}", repr(title))
        return name


def other_format(data: bytes) -> str:
    """How a table's bytes differ from `FORMAT`, as spreadsheets and loggers write them, or ""."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in data[:200]:
        return "UTF-16"
    first, _, rest = data.decode("utf-8-sig", "replace").partition("\n")
    if first.startswith("#"):
        return "a comment in the first line"
    if first.lower().startswith("sep="):
        return f"a first line {first.strip()!r}"
    if "," in first:
        return ""
    found = next((said for mark, said in SEPARATORS.items() if mark in first), "")
    if not found and len(first.split()) > 1 and len(rest.partition("\n")[0].split()) > 1:
        found = "blanks between cells"
    rows = rest.partition("\n")[0].strip()
    cells = re.split("[;|\t ]", rows)
    if found and any(DECIMAL_COMMA.fullmatch(cell.strip()) for cell in cells):
        found += ", and decimal commas"
    return found
