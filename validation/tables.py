"""Tables of text: Markdown for documents, aligned columns for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def columns(lines: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """Lines of as many cells each, as columns of text; those in `numbers` end on the right."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = [">" if k in numbers else "<" for k in range(len(widths))]
    return "\n".join(
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(line, sides, widths, strict=True)
        ).rstrip()
        for line in lines
    )


Column = tuple[str, str, str]
"""Title, key of the rows, format; one without a format is words."""


def cells(shown: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The titles, then a line for each of the rows; what is None there is a dash."""

    def cell(value: Any, form: str) -> str:
        return "-" if value is None else format(value, form)

    return [
        [title for title, _, _ in shown],
        *([cell(row[key], form) for _, key, form in shown] for row in rows),
    ]


def aligned(shown: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> str:
    """The same as columns of text, numbers on the right."""
    return columns(cells(shown, rows), [k for k, (_, _, form) in enumerate(shown) if form])


def pipes(lines: Sequence[Sequence[Any]]) -> list[str]:
    """The lines of a Markdown table, the first its titles; each cell on one line, as it is."""
    made = ["| " + " | ".join(inline(cell).replace("|", r"\|") for cell in line) + " |"
            for line in lines]  # fmt: skip
    return [made[0], "|" + " --- |" * len(lines[0]), *made[1:]]


def inline(text: Any) -> str:
    """Text on one line that Markdown shows as it is."""
    return " ".join(str(text).split()).replace("<", "&lt;")
