"""`check` names the joint angles where a site enters a round body or a cable flips."""

from __future__ import annotations

import math
import re

import pytest

from softdyn.statics.cable_edges import cable_edges
from tests.support.robots import build, cable, hinge

# a cable from the base over a pin at the hinge to a crank
PIN = '<cylinder link="base" xyz="0 0 0" axis="0 1 0" radius="0.03"/>'
PATH = "base -0.1 0 0.02", PIN, "arm 0.1 0 0.02"
CRANK = hinge(1, None, 0.01, limit=(-2, 2), block=cable("cable", *PATH))


def edges(text: str) -> list[tuple[str, float]]:
    found = cable_edges(build(text))
    lines = [line for line in found if line.startswith("tendon 'cable'")]
    return [(line.split("the")[0], float(re.findall(r"= ([-.\d]+)", line)[0])) for line in lines]


def test_a_cable_without_a_side_flips() -> None:
    """It flips when both sites and the axis are in one line: half a turn less both elevations."""
    (found,) = edges(CRANK)
    assert "flips" in found[0]
    assert found[1] == pytest.approx(
        2 * math.atan2(0.02, 0.1), abs=6e-3
    )  # the line has three digits


def test_a_site_enters_the_body() -> None:
    """The cylinder is 0.12 m above the hinge; the crank carries its site into it."""
    near = CRANK.replace('xyz="0 0 0" axis', 'xyz="0 0 0.1" axis')
    lines = edges(near.replace("-0.1 0 0.02", "-0.1 0 0.1"))
    (found,) = [line for line in lines if "site inside" in line[0]]
    # |R(q) (0.1, 0.02) - (0, 0.1)| = 0.03
    reach, rises = math.hypot(0.1, 0.02), math.atan2(0.02, 0.1)
    cosine = (reach**2 + 0.01 - 0.03**2) / (2 * 0.1 * reach)
    assert found[1] == pytest.approx(
        -(math.pi / 2 - rises - math.acos(cosine)), abs=6e-3
    )  # the line has three digits


def test_smooth_cables_have_no_line() -> None:
    assert not edges(
        CRANK.replace('radius="0.03"', 'radius="0.03" side="0 0 0.05"').replace(
            'lower="-2" upper="2"', 'lower="-1" upper="1"'
        )
    )
