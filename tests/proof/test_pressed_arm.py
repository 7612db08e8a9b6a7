"""The published arm under pressure: the page's prediction, and the frame of the measured curves."""

from __future__ import annotations

import numpy as np
import pytest

from tests.proof import pressed_arm
from tests.support import ROOT


def test_the_page_has_the_prediction_of_the_hanging_arm() -> None:
    pressures, seen = pressed_arm.measured()
    model = pressed_arm.arm("hanging")
    error = pressed_arm.size(pressed_arm.curvatures(model, pressures) - seen)
    share = 100 * error / pressed_arm.size(seen)
    page = (ROOT / "docs/chambers.md").read_text("utf-8")
    assert f"| hanging | {error:.2f} ({share:.0f} %) |" in page


def test_the_arcs_end_where_a_weightless_arm_does() -> None:
    model = pressed_arm.arm("without weight")
    u = np.array([[3e4, 1e4, 1.5e4]])
    arcs = pressed_arm.tips(pressed_arm.curvatures(model, u), model)
    there = pressed_arm.statics.settle(model, u[0]).y
    assert arcs[0] == pytest.approx(there, abs=5e-5)
