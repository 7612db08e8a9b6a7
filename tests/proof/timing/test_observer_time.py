"""Times of an observer's step: the steps that are timed, and the command. No time is judged."""

from __future__ import annotations

import json

from tests.support.command import proof

OWN = """
class Slow:
    def __init__(self, model):
        self.model = model

class Observer(Slow):
    def step(self, t, measurements, u):
        return None
"""


def test_the_command(tmp_path):
    asked = ["--robots", "finger", "--rounds", "1", "--json", "-"]
    (tmp_path / "own.py").write_text(OWN)
    own, joints = f"{tmp_path}/own.py:Observer", ["--sensors", "joints=0.001"]
    done = proof("observer-time", *asked, "--observer", own, *joints)
    (row,) = json.loads(done.out)["rows"]
    assert (row["readings"], row["late_samples"], row["late_median_us"]) == (4, 0, None)
    for words, expected in (
        (["--observer", f"{tmp_path}/own.py:Slow"], "observer: expected an object with step"),
        (["--observer", "wind"], "disturbances: expected tip_force"),
        (["--sensors", "file"], "--sensors: expected a list, the file having none"),
    ):
        done = proof("observer-time", *asked, *words)
        assert done.code == 2
        assert expected in done.err
