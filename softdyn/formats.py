"""Versions of the files that softdyn reads, and the one rule for all of them.

A file that states no format is of version 1 of its kind. One that states another version than
today's code reads is refused by a line that names it. `docs/files.md` describes each version, and
`tests/formats/` has a file of each.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from softdyn.exceptions import FormatError

KEY = "format"  # of a TOML table, of a log's settings; the title of a CSV file's column
OURS = "softdyn-"  # how the formats begin; other values of the key mean something else
TOML, CSV, RECORD = f"{OURS}toml-1", f"{OURS}csv-1", f"{OURS}record-1"
POLICY = f"{OURS}policy-1"  # of a learned policy, as NPZ
ZEROS = f"{OURS}zeros-1"  # of a rig, as far as they were found


def is_format(said: object) -> bool:
    """Whether a value of `KEY` states a format of softdyn."""
    return isinstance(said, str) and said.startswith(OURS)


def check_format(said: object, known: str, where: str, kind: str) -> None:
    """Refuse a file of another version.

    Parameters
    ----------
    said : object
        The format that the file states.
    known : str
        The format that is read.
    where : str
        The file.
    kind : str
        The kind of the file in words, e.g. ``a log``.

    Raises
    ------
    FormatError
        The format is another one; the error names both.
    """
    if said != known:
        got = f"{said}, of another version of softdyn" if is_format(said) else "another format"
        raise FormatError(where, f"{kind} of format {known}", got)


def without_format(table: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """A TOML table without the key that states its format.

    Raises
    ------
    FormatError
        As `check_format` does.
    """
    if not is_format(said := table.get(KEY)):
        return table
    check_format(said, TOML, where, "a table")
    return {key: value for key, value in table.items() if key != KEY}
