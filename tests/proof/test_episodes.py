"""The speed of the environment: the program's row, and the page's bound."""

from softdyn.validation.files import read_json
from tests.proof import episodes
from tests.proof.documents.settings import MEASURED


def test_a_row_counts_its_steps():
    row = episodes.measure("finger", rounds=1, steps=300)
    assert row["steps"] == 400  # whole rounds
    assert 0 < row["bare_us"] < row["us"] * 2
    assert 0 < row["before_mb"] <= row["after_mb"]


def test_the_page_has_an_overhead_of_less_than_a_third():
    rows = read_json(MEASURED / "episodes.json", "rows of a table")["rows"]
    assert tuple(row["robot"] for row in rows) == episodes.ROBOTS
    assert max(row["more"] for row in rows) <= 30
    assert max(row["after_mb"] - row["before_mb"] for row in rows) < 20
