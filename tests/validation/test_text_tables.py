"""Tables of text, cell by cell."""

from __future__ import annotations

from softdyn.validation.tables import columns, pipes


def test_columns_are_aligned_and_numbers_end_on_the_right() -> None:
    lines = [["robot", "µs"], ["finger", "9.5"], ["helix", "120.0"]]
    assert columns(lines, [1]).splitlines() == ["robot      µs", "finger    9.5", "helix   120.0"]
    assert columns(lines).splitlines() == ["robot   µs", "finger  9.5", "helix   120.0"]


def test_markdown_shows_a_cell_as_it_is() -> None:
    lines = pipes([["a", "b"], ["x|y\nz", "<robot>"]])
    assert lines == ["| a | b |", "| --- | --- |", r"| x\|y z | &lt;robot> |"]
