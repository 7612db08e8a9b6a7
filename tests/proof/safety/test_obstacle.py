"""The obstacle study, called from Python."""

import numpy as np

import softdyn
from tests.proof.safety import obstacle


def test_the_ball_stands_in_the_way_and_the_barriers_go_round_it():
    met = obstacle.meet(softdyn.load("finger"), duration=0.3, random=1)
    assert list(met.logs) == ["published", "with a horizon", "with barriers"]
    rows = met.report["runs"]
    assert [row["name"] for row in rows] == [*met.logs, "random 0"]
    assert rows[0]["clearance_mm"] < 0 < rows[0]["violation"]
    assert rows[2]["clearance_mm"] > rows[0]["clearance_mm"]
    assert met.report["worst_violation"] == max(row["violation"] for row in rows[2:])
    centre = met.ball.centre
    clearance = np.linalg.norm(met.logs["published"].y - centre, axis=1).min() - met.ball.radius
    assert rows[0]["clearance_mm"] == 1e3 * clearance
    assert rows[2]["clearance_mm"] > 0
    lines = str(met).splitlines()
    assert len(lines) == 5
    assert lines[-1].startswith("1 random runs: worst violation")


def test_the_ball_stands_where_it_stands_whatever_the_last_bit():
    share = np.linspace(0.0, 1.0, 200)
    path = np.stack((0.2 - 0.05 * share, 0 * share, -0.1 * share), axis=1)
    rng = np.random.default_rng(0)
    centres = [
        obstacle.in_the_way(
            [y * (1 + 1e-15 * rng.normal(size=y.shape)) for y in (path, path)], 0.02
        )
        for _ in range(10)
    ]
    assert np.ptp([ball.centre for ball in centres], axis=0).max() < 1e-9


def test_the_command_warns_of_rows_that_gave_way_and_of_a_violation():
    ball = obstacle.KeepOutSphere([0.0, 0.0, 0.0], 0.1)
    row = {"name": "a", "final_error_cm": 1.0, "clearance_mm": -2.0, "violation": 2.0,
           "relaxed": 3, "outside": 4, "fallbacks": 0, "failed": False, "step_us": 9.0}  # fmt: skip
    report = {"runs": [row] * 3, "passed": False, "worst_violation": 2.0}
    lines = str(obstacle.Encounters(ball, {}, report)).splitlines()[-2:]
    assert lines[0].startswith("rows gave way at 3 steps: ")
    assert lines[1].startswith("a barrier was violated by 2.00 mm")
    assert "4 states" in lines[1]
