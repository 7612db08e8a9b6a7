"""The obstacle study, called from Python."""

import numpy as np

import softdyn
from softdyn.validation.studies import obstacle


def test_the_ball_stands_in_the_way_and_the_barriers_go_round_it():
    met = obstacle.meet(softdyn.load("finger"), duration=0.3, random=1)
    assert list(met.logs) == ["published", "over the hold", "with barriers"]
    rows = met.report["runs"]
    assert [row["name"] for row in rows] == [*met.logs, "random 0"]
    assert rows[0]["clearance_mm"] < 0 < rows[0]["violation"]
    assert rows[2]["clearance_mm"] > rows[0]["clearance_mm"]
    assert met.report["worst_violation"] == max(row["violation"] for row in rows[2:])
    centre = met.ball.centre
    clearance = np.linalg.norm(met.logs["published"].y - centre, axis=1).min() - met.ball.radius
    assert rows[0]["clearance_mm"] == 1e3 * clearance
    lines = str(met).splitlines()
    assert len(lines) == 5
    assert lines[-1].startswith("1 random runs: worst violation")
