"""The documents' tables: written from the committed figures, and what the ticks mean."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import benchmark
from softdyn.validation.files import read_json
from tests.proof import tables
from tests.proof.documents import tables as documents
from tests.proof.documents.measured_rows import replace_rows
from tests.support import ROOT
from tests.support.refused import refused

PAGES = sorted((ROOT / "docs").glob("*.md"))


def test_every_table_is_what_the_committed_figures_give() -> None:
    assert sum(len(documents.MARKED.findall(page.read_text("utf-8"))) for page in PAGES) >= 8
    assert documents.write(PAGES, check=True) == []


def test_the_robots_of_the_documents_are_the_benchmark_s() -> None:
    assert documents.PAPER_ROBOTS == benchmark.ROBOTS


def test_rows_are_replaced_in_the_order_of_the_document(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    for robot, value in (("spirob", 1), ("own", 2), ("finger", 3), ("spirob", 4)):
        found = [{"robot": robot, "value": value}, {"robot": robot, "value": -value}]
        replace_rows(path, "robot", [robot], found, ("finger", "spirob"))
    rows = [(row["robot"], row["value"]) for row in read_json(path, "rows of a table")["rows"]]
    assert rows == [
        ("finger", 3), ("finger", -3), ("spirob", 4), ("spirob", -4), ("own", 2), ("own", -2),
    ]  # fmt: skip


def test_a_stale_table_is_found_and_written(tmp_path: Path) -> None:
    page, begin = tmp_path / "page.md", "<!-- table gains: written by tests/proof/tables.py -->"
    page.write_text(f"before\n\n{begin}\n| edited |\n<!-- end of gains -->\n\nafter\n", "utf-8")
    assert tables.main([str(page), "--check"]) == 1
    assert "edited" in page.read_text("utf-8")
    assert tables.main([str(page)]) == 0
    text = page.read_text("utf-8")
    assert "| finger | IC-QP | 1500 | 0.03 |" in text
    assert text.startswith("before\n\n<!-- table")
    assert text.endswith("<!-- end of gains -->\n\nafter\n")
    assert tables.main([str(page), "--check"]) == 0
    page.write_text(f"{begin}\n<!-- end of gains -->\n".replace("gains", "nothing"))
    with refused("table"):
        documents.write([page])
    assert tables.main([str(tmp_path / "none.md")]) == 2
