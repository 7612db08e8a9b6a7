"""The committed rows of a table, of which one program run at a time measures a part anew."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from softdyn.validation.files import read_json, write_json


def replace_rows(
    path: Path,
    key: str,
    values: Collection[str],
    found: Iterable[dict[str, Any]],
    order: Sequence[str] = (),
) -> None:
    """Put `found` in the place of the file's rows that have one of `values` at `key`.

    The rows then stand in the order that `order` has of the values at `key`; others are last.
    """
    rows = read_json(path, "rows of a table")["rows"] if path.is_file() else []
    rows = [row for row in rows if row[key] not in values] + list(found)
    places = {value: place for place, value in enumerate(order)}
    rows.sort(key=lambda row: places.get(row[key], len(places)))
    write_json(path, {"rows": rows})
