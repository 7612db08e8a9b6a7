"""Rows at rest out of data over time: the plateaus of a staircase, against their closed form."""

import numpy as np
import pytest

from softdyn import InputError
from softdyn.identification import Measurements, rest_rows

STEP, HOLD, RATE = 0.01, 2.0, 8.0  # s, s, 1/s: a first-order arm that follows u


def staircase(levels=(0.0, 1.0, 2.0, 0.5), noise=0.0, rate=RATE, gaps=False):
    """The exact answer of ẏ = rate (u - y) to steps, sampled."""
    t = np.arange(0.0, HOLD * len(levels), STEP)
    part = np.minimum((t / HOLD).astype(int), len(levels) - 1)
    u, y, before = np.array(levels)[part], np.empty_like(t), 0.0
    for k, level in enumerate(levels):
        inside = part == k
        y[inside] = level + (before - level) * np.exp(-rate * (t[inside] - k * HOLD))
        before = level + (before - level) * np.exp(-rate * HOLD)
    y += noise * np.random.default_rng(0).normal(size=len(t))
    if gaps:
        y[::3] = np.nan
    return Measurements(t, u[:, None], ("tip.x",), y[:, None])


@pytest.mark.parametrize(("noise", "gaps"), [(0.0, False), (0.05, False), (0.05, True)])
def test_each_plateau_is_one_row(noise, gaps):
    rows, moving = rest_rows(staircase(noise=noise, gaps=gaps))
    assert moving == 0
    np.testing.assert_array_equal(rows.u[:, 0], [0.0, 1.0, 2.0, 0.5])
    np.testing.assert_allclose(rows.outputs[:, 0], rows.u[:, 0], atol=2e-3 + 0.3 * noise)


def test_a_plateau_that_still_moves_is_left_out_and_counted():
    data = staircase((0.0, 0.01, 0.0, 0.01, 2.0), rate=1.5)
    rows, moving = rest_rows(data)
    assert (len(rows.t), moving) == (4, 1)
    assert rows.u.max() == pytest.approx(0.01)


@pytest.mark.parametrize("hold", [3.0, 0.0, np.nan])
def test_too_few_rows_and_a_bad_time_are_one_line(hold):
    with pytest.raises(InputError):
        rest_rows(staircase(), hold)
