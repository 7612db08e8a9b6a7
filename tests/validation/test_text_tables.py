"""Tables of text, cell by cell."""

from __future__ import annotations

from softdyn.validation.tables import Table, document

COLUMNS = (("robot", "name", ""), ("µs", "time_us", ".1f"))
ROWS = ({"name": "finger", "time_us": 9.54}, {"name": "helix", "time_us": None})


def test_columns_are_aligned_and_numbers_end_on_the_right() -> None:
    rows = [["finger", "9.5"], ["helix", "120.0"]]
    right = ["robot      µs", "finger    9.5", "helix   120.0"]
    left = ["robot   µs", "finger  9.5", "helix   120.0"]
    assert Table(["robot", "µs"], rows, ["", ".1f"]).text().splitlines() == right
    assert Table(["robot", "µs"], rows).text().splitlines() == left
    assert Table((), rows).text().splitlines() == ["finger  9.5", "helix   120.0"]


def test_a_cell_is_its_value_in_the_column_s_format_and_nothing_is_a_dash() -> None:
    assert Table.of(COLUMNS, ROWS).lines == [["robot", "µs"], ["finger", "9.5"], ["helix", "-"]]


def test_markdown_shows_a_cell_as_it_is() -> None:
    lines = Table(["a", "b"], [["x|y\nz", "<robot>"]]).markdown().splitlines()
    assert lines == ["| a | b |", "| --- | --- |", r"| x\|y z | &lt;robot> |"]


def test_csv_holds_the_values_themselves() -> None:
    table = Table(["a", "b", "c", "d"], [[0.1 + 0.2, None, True, "x,y"]], [".1f", "", "", ""])
    assert table.csv() == 'a,b,c,d\n0.30000000000000004,,true,"x,y"\n'


def test_html_escapes_and_marks_cells_and_new_first_cells() -> None:
    table = Table(["<a>", "b"], [["x", "1"], ["x", "2"], ["y", "3"]])
    assert table.html([{1}, set(), set()]).splitlines() == [
        "<table><tr><th>&lt;a&gt;</th><th>b</th></tr>",
        '<tr class="first"><td>x</td><td class="bad">1</td></tr>',
        "<tr><td>x</td><td>2</td></tr>",
        '<tr class="first"><td>y</td><td>3</td></tr>',
        "</table>",
    ]


def test_a_document_leaves_empty_blocks_out() -> None:
    assert document("# Title", "", "text") == "# Title\n\ntext\n"
