"""`CsvTable`: columns by their names, and errors that name the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softdyn import InputError
from softdyn.csv_table import CsvTable
from tests.support.refused import refused


def table(folder: Path, text: str) -> CsvTable:
    file = folder / "data.csv"
    file.write_text(text)
    return CsvTable(file)


def test_columns_in_any_order_with_gaps(tmp_path: Path) -> None:
    found = table(tmp_path, "t (s),note,measured.a (m)\n0,first,1\n\n1,second,\n")
    assert (found.names, len(found)) == (["t", "note", "measured.a"], 2)
    assert found.titles[2] == "measured.a (m)"
    values = found.numbers(["measured.a", "t"], ("measured.",))
    np.testing.assert_array_equal(values, [[1, 0], [np.nan, 1]])
    assert table(tmp_path, "t,x\n").numbers(["x", "t"]).shape == (0, 2)
    assert table(tmp_path, "").names == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,x\n0,1\n\n\n1,no\n", "data.csv:5: column x: expected a finite number, got 'no'"),
        ("t,x\n0,1\n\n1\n", "data.csv:4: expected 2 cells, got 1"),
        ("t,x\n0,\n", "data.csv:2: column x: expected a finite number, got ''"),
        ("t,x,x\n0,1,2\n", "data.csv: expected one column x, got 2 of them"),
        ("t (ms),x\n", "data.csv: header: expected t in s, got 't (ms)'"),
        ("t;x\n0.5;1\n", "got semicolons between cells"),
        ("t;x\n0,5;1\n", "got semicolons between cells, and decimal commas"),
        ("t\tx\n0.5\t1\n", "got tabs between cells"),
        ("t\tx\n0,5\t1\n", "got tabs between cells, and decimal commas"),
        ("t x\n0.5 1\n", "got blanks between cells"),
        ("t|x\n0.5|1\n", "got bars between cells"),
        ("sep=;\nt;x\n0;1\n", "got a first line 'sep=;'"),
        ("sep=,\nt,x\n0,1\n", "got a first line 'sep=,'"),
        ("# a rig\nt,x\n0,1\n", "got a comment in the first line"),
        ("t,x\n0,5,1,0\n", "data.csv:2: expected 2 cells, got 4: decimal commas?"),
        (
            't,x\n"0,5","1"\n',
            "data.csv:2: column t: expected a finite number, got '0,5': a decimal",
        ),
    ],
)
def test_a_bad_file_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        table(tmp_path, text).numbers(["t", "x"])
    assert said in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_a_table_in_another_encoding_is_named(tmp_path: Path, encoding: str) -> None:
    """Excel's Unicode text."""
    (tmp_path / "data.csv").write_bytes("t,x\n0,1\n".encode(encoding))
    with refused("data.csv", "UTF-16"):
        CsvTable(tmp_path / "data.csv")


def test_tables_that_differ_in_nothing_that_counts(tmp_path: Path) -> None:
    """Blanks after commas, a comma at the end, Windows' line ends, a mark of UTF-8, one column."""
    for text in ("t, x\n0, 1\n", "t,x,\n0,1,\n", "t,x\r\n0,1\r\n", "\ufefft,x\n0,1\n"):
        (tmp_path / "data.csv").write_text(text, encoding="utf-8", newline="")
        found = CsvTable(tmp_path / "data.csv")
        np.testing.assert_array_equal(found.numbers(["t", "x"]), [[0, 1]])
    assert table(tmp_path, "x\n1\n").names == ["x"]
