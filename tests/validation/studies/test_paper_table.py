"""A table and a figure for a paper, against statistics of Python and NumPy."""

import csv
import io
import json
import math
import statistics
from pathlib import Path

import numpy as np
import pytest

from softdyn.validation.report import sweep_figure
from softdyn.validation.studies.paper_table import PaperTable
from tests.support.sweeps import results

TEXT = """
robots = "finger"
controllers = ["ic", "uic"]
rows = ["controller"]
figures = ["final", "rms", "mse", "effort", "step_us"]
{more}
[targets]
theta = [0.5, 1]
[rig]
noise = 0.001
seed = [1, 2, 3, 4]
[run]
duration = 0.05
"""
LABELS = (
    """labels = { ic = "Impedance_1", "θ = 0.5π" = "Near", final = "e(T)", "rig.seed" = "seeds" }"""
)


def made_up(sweep):
    """A result for each case; of uic, one of the far target has no figure."""
    rows = []
    for k, case in enumerate(sweep.cases):
        lost = (case.controller, case.value, case.options["rig"]["seed"]) == ("uic", 1.0, 3)
        value = None if lost else 0.1 + (k * 7919 % 13) / 10
        figures = {"final_error_cm": value, "mse_cm2": value, "input_effort": value}
        rows.append((case, {"outcome": "failed" if lost else "done", "step_us": None, **figures}))
    return rows


def cell_values(rows, controller, theta):
    return [r["final_error_cm"] for c, r in rows if (c.controller, c.value) == (controller, theta)]


def test_a_cell_is_the_mean_and_deviation_over_its_runs(written):
    sweep = written(TEXT.format(more=LABELS))
    rows = made_up(sweep)
    table = PaperTable.of(sweep, rows)
    assert len(sweep.cases) == 2 * 2 * 4
    assert (table.rows, table.columns) == ((("Impedance_1",), ("UIC",)), (("Near",), ("θ = 1π",)))
    near = cell_values(rows, "ic", 0.5)
    mean, std = statistics.fmean(near), statistics.pstdev(near)
    text = table.markdown()
    head, _, first, second = text.splitlines()[:4]
    assert head.startswith("| controller | Near, e(T) (cm) | Near, rms error (cm) | Near, mean sq")
    assert first.startswith(f"| Impedance_1 | {mean:.2f} ± {std:.2f} | ")
    roots = [math.sqrt(value) for value in near]
    assert f" | {statistics.fmean(roots):.2f} ± {statistics.pstdev(roots):.2f} | " in first
    assert "failed (1 of 4 failed)" in second  # no mean without all runs
    assert text.splitlines()[-1].startswith(
        "Mean ± population standard deviation over 4 runs a cell, which differ in seeds; effort: "
    )
    latex = table.latex()
    assert rf"Impedance\_1 & {mean:.2f} $\pm$ {std:.2f} & " in latex
    assert r"\multicolumn{5}{c}{Near} & \multicolumn{5}{c}{$\theta$ = 1$\pi$} \\" in latex
    assert latex.count("&") == 10 + 10 + 10 + 2  # titles, two rows, and the heads above
    assert "Mean $\\pm$ population standard deviation over 4 runs" in latex
    line = next(csv.DictReader(io.StringIO(table.csv())))
    assert (line["controller"], line["target"], line["figure"]) == ("Impedance_1", "Near", "final")
    assert (float(line["mean"]), float(line["std"])) == pytest.approx((mean, std), rel=1e-14)


def test_a_cell_may_be_the_median_and_the_quartiles(written):
    """A run without a figure is worse than any other, so that a median may still exist."""
    sweep = written(TEXT.format(more='spread = "quartiles"'))
    rows = made_up(sweep)
    table = PaperTable.of(sweep, rows)
    lower, median, upper = np.percentile(cell_values(rows, "ic", 0.5), [25, 50, 75])
    assert f"| IC | {median:.2f} [{lower:.2f}, {upper:.2f}] | " in table.markdown()
    assert "Median [lower quartile, upper quartile] over 4 runs" in table.note
    group = table.groups[("UIC",), ("θ = 1π",), "final"]
    three = sorted(v for v in cell_values(rows, "uic", 1.0) if v is not None)
    assert group.quartiles[:2] == pytest.approx(np.percentile([*three, 1e300], [25, 50]))
    assert group.quartiles[2] == math.inf
    assert f"{statistics.median([*three, 1e9]):.2f} [" in group.text("quartiles")
    assert group.text("quartiles").endswith(", none] (1 of 4 failed)")


def test_columns_and_pooled_parameters_are_stated(written):
    sweep = written(TEXT.format(more='columns = ["rig.seed"]'))
    table = PaperTable.of(sweep, made_up(sweep))
    assert table.columns == (("seed = 1",), ("seed = 2",), ("seed = 3",), ("seed = 4",))
    assert "over 2 runs a cell, which differ in target; " in table.note
    sweep = written(TEXT.format(more='columns = ["target", "rig.seed"]'))
    assert PaperTable.of(sweep, made_up(sweep)).note.startswith("One run a cell; ")


def test_its_figure_has_a_panel_for_each_figure_that_exists(written, tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(sweep_figure.look, "save", lambda figure, path: kept.append(figure) or [])
    sweep = written(TEXT.format(more=LABELS))
    sweep_figure.draw_table(PaperTable.of(sweep, made_up(sweep)), tmp_path / "table")
    (figure,) = kept  # nobody measured step times
    titles = [axes.get_ylabel() for axes in figure.axes]
    assert titles == ["e(T) (cm)", "rms error (cm)", "mean squared error (cm²)", "effort"]
    for axes in figure.axes:
        assert [text.get_text() for text in axes.get_xticklabels()] == ["Near", "θ = 1π"]
    (legend,) = figure.legends
    assert [t.get_text() for t in legend.get_texts()] == ["Impedance_1", "UIC", "failed run"]


def test_the_command_writes_the_table_as_markdown_latex_csv_and_pdf(folder, call):
    (folder / "sweep.toml").write_text(TEXT.format(more=LABELS).replace(", 2, 3, 4]", ", 2]"))
    code, out, err = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert code == 0, err
    files = {Path(name).name for name in json.loads(out)["files"]}
    assert files == {
        "sweep.csv", "sweep.md", "sweep.pdf", "sweep.png",
        "table.csv", "table.tex", "table.pdf", "table.png",
    }  # fmt: skip
    assert Path("out/table.pdf").read_bytes()[:5] == b"%PDF-"
    table = list(csv.DictReader(io.StringIO(Path("out/table.csv").read_text())))
    near = [
        result["final_error_cm"] for result in results(Path("out"))
        if (result["inputs"]["controller"], result["inputs"]["target"]) == ("ic", 0.5)
    ]  # fmt: skip
    found = {(row["controller"], row["target"], row["figure"]): row for row in table}
    line = found["Impedance_1", "Near", "final"]
    assert float(line["mean"]) == pytest.approx(statistics.fmean(near), rel=1e-14)
    step = found["UIC", "θ = 1π", "step_us"]
    assert float(step["median"]) > 0
    assert Path("out/sweep.md").read_text().count("Mean ± population standard deviation") == 1
    # another call has the same step times: they are kept
    code, out, _ = call(folder / "sweep.toml", "--out", "out", "--jobs", 1, "--json", "-")
    assert (code, json.loads(out)["ran"]) == (0, 0)
    again = list(csv.DictReader(io.StringIO(Path("out/table.csv").read_text())))
    assert again == table


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"final", ',
            '"fianl", ',
            "figures: expected any of final, rms, mse, effort, step_us, got",
        ),
        ('rows = ["controller"]', "", "figures: expected a file with rows, got none"),
        ("[targets]", 'spread = "sd"\n[targets]', "spread: expected std or quartiles, got"),
        ("[targets]", 'columns = ["goal"]\n[targets]', "columns: expected any of target, robot"),
        ("[targets]", 'labels.icc = "A"\n[targets]', "[labels]: icc: expected one of finger, ic,"),
        ("[targets]", "labels.ic = 3\n[targets]", "[labels]: ic: expected a text, got 3"),
    ],
)
def test_what_is_wrong_with_a_table_is_told_in_one_line(refused, old, new, message):
    refused(TEXT.format(more=""), old, new, message)
