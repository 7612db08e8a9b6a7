"""Tables of text: Markdown for documents, aligned columns for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
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


def pipes(lines: Sequence[Sequence[Any]]) -> list[str]:
    """The lines of a Markdown table, the first its titles; each cell on one line, as it is."""
    made = ["| " + " | ".join(inline(cell).replace("|", r"\|") for cell in line) + " |"
            for line in lines]  # fmt: skip
    return [made[0], "|" + " --- |" * len(lines[0]), *made[1:]]


def inline(text: Any) -> str:
    """Text on one line that Markdown shows as it is."""
    return " ".join(str(text).split()).replace("<", "&lt;")
