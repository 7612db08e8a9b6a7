"""The documents' tables: written from the committed figures, and what the ticks mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from softdyn import InputError
from softdyn.commands import benchmark
from softdyn.validation.files import read_json
from softdyn.validation.studies.engine.distribution import Distribution
from tests.proof import rests, tables
from tests.proof.documents import tables as documents
from tests.proof.documents.measured_rows import replace_rows
from tests.support import ROOT

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
    with pytest.raises(InputError, match="table"):
        documents.write([page])
    assert tables.main([str(tmp_path / "none.md")]) == 2


def test_set_points_and_changes_have_rows_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    held = Distribution(0.5, input_change=Distribution(0.1))
    moving = Distribution(3.0, {"1": (4.0, 5.0)}, second_cycle=Distribution(1.0))
    cells = {
        "spirob/best/1 ms/θ = 0.1π": held, "spirob/best/1 ms/θ = 0.2π": Distribution(2.0),
        "spirob/best/2 ms/θ = 0.1π": held, "spirob/best/2 ms/θ = 0.2π": Distribution(0.1),
        # of a run before, when θ = 0.1π was missed, too
        "spirob/stable equilibrium/-/θ = 0.1π": Distribution(9.0),
        "spirob/stable equilibrium/-/θ = 0.2π": Distribution(1.5),
    }  # fmt: skip
    monkeypatch.setattr(documents, "_cells", lambda _: cells)
    lines = documents.TABLES["set-points"]().splitlines()
    assert lines[0] == "| SpiRob | 1 ms | 2 ms | nearest stable equilibrium | Δu (%) |"
    assert lines[2:4] == [
        "| θ = 0.1π | 0.50 | 0.50 | - | 0.10 |", "| θ = 0.2π | 2.00 | 0.10 | 1.50 | - |",
    ]  # fmt: skip
    cells = {"finger/best/late/θ = 1π": held, "helix/best/late/ω = 1π": moving}
    lines = documents.TABLES["robustness"]().splitlines()
    assert lines[0] == "| change | finger θ = 1π | helix ω = 1π | Δu (%) |"
    assert lines[2] == "| late | 0.50 | ~4.00 [3.00, 5.00] / 1.00 | 0.10 |"
    assert "second cycle" in lines[-1]
    cells = {f"arm_urdf-12/mpc/{change}/({x}, 0, 0) m": held for change in "ab" for x in (1, 2)}
    lines = documents.TABLES["unseen"]().splitlines()
    assert lines[2:4] == [f"| arm | mpc | {change} | 0.50 | 0.50 | 0.10 |" for change in "ab"]


@pytest.mark.parametrize(
    ("logs", "runs", "said"),
    [
        ([10.0, 0.001], [Distribution(10.09), Distribution(0.01)], "✓"),
        ([10.0], [Distribution(10.5)], "0 of 1, others within 5 %"),
        ([10.0, 2.0], [Distribution(10.5), None], "0 of 2, others within 5 %"),
        ([10.0, 2.0], [Distribution(10.0), None], "1 of 2"),
        ([0.1, 1.0], [Distribution(5.0), Distribution(1.5)], "0 of 2, others within 4.90"),
        ([10.0], [Distribution(4.0, {"1": (3.0, 11.0)})], "✓"),  # a chaotic one's
        ([10.0], [Distribution(4.0, {"1": (3.0, 9.0)})], "0 of 1, others within 60 %"),
        (None, [Distribution(4.0), Distribution(6.0)], "✓, no log"),
        (None, [Distribution(3.0), Distribution(9.0)], "no log, 2.00 apart"),
        (None, [Distribution(4.0), None], "no log, not run"),
    ],
)
def test_a_tick_is_a_comparison_of_every_run(logs: Any, runs: Any, said: str) -> None:
    assert documents.verdict("5.00 ± 1.00", logs, runs) == said


def test_a_published_failure_is_held_against_failures() -> None:
    lost, held = Distribution(40.0, {}, {"nominal": 1}), Distribution(0.1)
    assert documents.verdict("failed", None, [lost, lost]) == "✓"
    assert documents.verdict("failed", None, [lost, held]) == "1 of 2 fail"
    assert documents.verdict("failed", None, [lost, None]) == "not run"


def test_a_set_point_s_row_has_its_nearest_equilibrium_and_another_stable_one() -> None:
    def held(far: float, stable: bool) -> dict[str, Any]:
        return {
            "distance_cm": far, "stable": stable, "smallest_eigenvalue": 0.1, "u": [0.2],
            "rightmost_pole": -1.0, "nudged_drift_cm": {"largest": 9.0, "final": 0.3},
        }  # fmt: skip

    stable = {"theta": 0.5, "closest": held(0.0, True), "closest_stable": held(0.0, True)}
    row = rests.row_of(stable)
    assert row["closest_stable"] is None
    assert (row["theta"], row["closest"]["drift_cm"]) == (0.5, 0.3)
    row = rests.row_of(stable | {"closest": held(0.0, False), "closest_stable": held(2.0, True)})
    assert row["closest_stable"]["distance_cm"] == 2.0
    assert rests.row_of(stable | {"closest_stable": None})["closest_stable"] is None
