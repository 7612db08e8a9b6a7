"""Charts of the pages: what their slots keep of many rows, and what is drawn of it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from softdyn.view.page import asset
from tests.support.browser import Browser, required

pytestmark = required()
PAGE = """<!DOCTYPE html><title>chart</title>
<canvas style="width: 300px; height: 80px; display: block"></canvas>
<script>{script}
const canvas = document.querySelector("canvas");
const filled = (rows, span, count) => {{
  const slots = new Slots(["y"], span, count);
  for (const [t, y] of rows) slots.push(t, {{y}});
  return slots;
}};
const shown = ({{t, least, most}}) =>
  [t, least, most].map(values => Array.from(values, x => Number.isNaN(x) ? null : x));
</script>"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory):
    file = tmp_path_factory.mktemp("chart") / "chart.html"
    file.write_text(PAGE.format(script=asset("chart.js")), encoding="utf-8")
    with Browser() as found:
        found.open(file.as_uri(), 400, 200)
        yield found
        assert found.console == []


def slots(browser: Browser, t: np.ndarray, y: np.ndarray, span: float, count: int) -> np.ndarray:
    """Times, least and largest values (3, slots) of rows; NaN where a slot has no value."""
    rows = json.dumps(np.column_stack((t, y)).tolist()).replace("NaN", "null")
    found = browser.run(f"shown(filled({rows}, {span}, {count}).column('y'))")
    return np.array(found, float)


@pytest.mark.parametrize(("low", "high"), [(49990, 50010), (0.5, 0.50002), (-3, 1e5), (0, 1e-6)])
def test_numbers_of_an_axis_are_in_few_characters_and_all_different(browser, low, high):
    texts = browser.run(
        f"(ticks => ticks.map(x => short(x, ticks[1] - ticks[0])))(roundNumbers({low}, {high}, 4))"
    )
    assert len(texts) == len(set(texts)) > 2
    step = np.diff([float(text) for text in texts])
    np.testing.assert_allclose(step, step[0], rtol=1e-6)


def test_powers_of_ten_have_no_zeros_behind(browser):
    """The number of a long wait stood half outside the strip, as 1.000e6."""
    ticks = "powersOfTen(1000, 2e6)"
    texts = browser.run(f"{ticks}.map(x => short(x, 9000))")
    assert [float(text) for text in texts] == browser.run(ticks)
    assert max(map(len, texts)) <= 4
    assert browser.run("short(12500, 500)") == "1.25e4"


def test_a_slot_keeps_the_extremes_of_its_rows_and_the_oldest_slots_go(browser):
    rng = np.random.default_rng(0)
    t = 0.5 + np.cumsum(rng.exponential(1 / 60, 5000))
    y = rng.normal(size=t.size)
    y[rng.random(t.size) < 0.5] = np.nan
    y[1000:1300] = np.nan  # longer than a slot
    span, count = 50.0, 101
    times, least, most = slots(browser, t, y, span, count)
    number = np.floor(t / 0.5)
    kept = np.unique(number)[-count:]
    assert len(times) == count
    assert times[-1] - times[0] >= span - 0.5
    for k, slot in enumerate(kept):
        inside = y[number == slot]
        assert times[k] == pytest.approx(t[number == slot][0], rel=1e-6)
        expected = np.fmin.reduce(inside), np.fmax.reduce(inside)
        np.testing.assert_allclose((least[k], most[k]), expected, rtol=1e-6)
    assert not np.isnan(most).all()


def test_a_value_that_is_not_finite_is_a_gap(browser):
    found = browser.run("""shown(filled([[0, 1], [1, Infinity], [2, NaN], [3, 2]], 10, 11)
      .column("y"))""")
    assert found[1:] == [[1, None, None, 2]] * 2
    # nor does it change the scale, or join what it parts
    browser.run("""(() => {
      const made = new Chart(canvas, new Linear(1));
      const slots = filled([[0, 1], [1, Infinity], [3, 2]], 10, 11);
      made.draw([{...slots.column("y"), colour: "#000"}], 0, 3);
      window.ends = [made.low, made.high];
    })()""")
    assert browser.run("ends") == [1, 2]


def dark(browser: Browser) -> np.ndarray:
    """Which pixels of the canvas are drawn (80, 300)."""
    data = browser.run("Array.from(canvas.getContext('2d').getImageData(0, 0, 300, 80).data)")
    return np.reshape(data, (80, 300, 4))[:, :, 3] > 100


def draw(browser: Browser, rows: str, span: float) -> None:
    browser.run(f"""(() => {{
      const slots = filled({rows}, {span}, 300);
      const curves = [{{...slots.column("y"), colour: "#000"}}];
      new Chart(canvas, new Linear(1)).draw(curves, ...slots.shown);
    }})()""")


def test_one_outlier_among_18000_rows_is_drawn(browser):
    draw(browser, "Array.from({length: 18000}, (_, k) => [k / 60, k == 9000 ? 100 : 0])", 300)
    found = dark(browser)
    columns = np.flatnonzero(found[:60].any(axis=0))
    assert found[5:70, columns].all(axis=0).any()  # from the bottom to the top
    np.testing.assert_allclose(columns, 150, atol=2)
    assert found[70:, :-1].any(axis=0).all()  # and the rest without a gap, to the newest slot


def test_a_drawing_of_5_minutes_needs_no_more_strokes_than_one_of_12_seconds(browser):
    counted = """(() => {
      let count = 0;
      const pen = CanvasRenderingContext2D.prototype, own = {};
      for (const name of ["lineTo", "moveTo", "fillRect"]) {
        own[name] = pen[name];
        pen[name] = function(...words) { count++; own[name].apply(this, words); };
      }
      const slots = filled(Array.from({length: ROWS}, (_, k) => [k / 60, Math.sin(k)]), SPAN, 300);
      const curves = [{...slots.column("y"), colour: "#000"}];
      new Chart(canvas, new Linear(1)).draw(curves, ...slots.shown);
      Object.assign(pen, own);
      return count; })()"""
    short = browser.run(counted.replace("ROWS", "720").replace("SPAN", "12"))
    long = browser.run(counted.replace("ROWS", "18000").replace("SPAN", "300"))
    assert 300 < long <= 600 + 10
    assert abs(long - short) <= 10


def test_what_is_shown_begins_with_the_rows_and_then_moves(browser):
    shown = "filled(Array.from({length: %d}, (_, k) => [2 + k, 0]), 10).shown"
    assert browser.run(shown % 4) == [2, 5]
    assert browser.run(shown % 31) == [22, 32]


def test_curves_that_move_to_the_left_keep_their_shape(browser):
    rng = np.random.default_rng(1)
    t, y = np.arange(2000) / 60, rng.normal(size=2000)
    before, after = (slots(browser, t[:end], y[:end], 20.0, 201) for end in (1900, 2000))
    shared = np.intersect1d(before[0][:-1], after[0])
    assert len(shared) > 150
    rows = [found[:, np.isin(found[0], shared)] for found in (before, after)]
    np.testing.assert_array_equal(*rows)


@pytest.mark.parametrize(
    ("scale", "low", "high"),
    [("Linear(1)", 3.0, 3.0), ("Linear(1e-9, 0)", 0.2, 0.7), ("Logarithmic(1e-4)", 0.0, 0.03),
     ("Logarithmic(1e-4)", 20.0, 20.0), ("Symmetric(0.01)", -1.0, 1.0), ("Symmetric(1)", 5.0, 5.0)],
)  # fmt: skip
def test_a_scale_has_its_values_between_its_ends_and_ticks_between_them(browser, scale, low, high):
    found = browser.run(f"""(scale => {{
      const ends = scale.ends({low}, {high}), values = scale.ticks(...ends, 4);
      return [...[ends, [{low}, {high}], values].map(all => all.map(y => scale.place(y))), values];
    }})(new {scale})""")
    (bottom, top), inside, ticks, values = found
    assert bottom < top
    assert bottom - 1e-9 <= inside[0] <= inside[1] <= top + 1e-9
    assert ticks == sorted(ticks)
    assert all(bottom - 1e-9 <= tick <= top + 1e-9 for tick in ticks)
    assert len(set(values)) == len(values) >= 1
