"""The figure of a sweep: a panel for each parameter, a dot for each case."""

import json

import matplotlib.figure
import numpy as np
import pytest

from softdyn.validation.loop.pictures import plot_style
from softdyn.validation.report import sweep_figure
from softdyn.validation.studies import sweep
from softdyn.validation.studies.sweep_file import read_sweep

TEXT = """
robots = "finger"
controllers = ["ic", "uic"]
rows = ["controller", "change", "sample", "gains.Kp", "gains.eps"]
targets.theta = [0, 0.5, 1]
gains.Kp = [10, 100, 1000]
gains.eps = { uniform = [0.01, 0.1] }
changes."mass x {}" = { plant.mass = [0.9, 1.1] }
samples.count = 2
"""


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Draw a sweep with these figures of its cases: (the figure or None, the cases)."""
    kept = []
    write = plot_style.write_figure
    monkeypatch.setattr(
        plot_style, "write_figure", lambda f, path, **more: kept.append(f) or write(f, path, **more)
    )

    def draw(text, figure_of):
        (tmp_path / "sweep.toml").write_text(text)
        wanted = read_sweep(tmp_path / "sweep.toml")
        found = [(case, figure_of(case)) for case in wanted.cases]
        there = sweep_figure.draw(wanted, found, tmp_path / "sweep")
        assert there == [one for one in (tmp_path / "sweep.pdf", tmp_path / "sweep.png")
                         if one.exists()]  # fmt: skip
        return (kept.pop() if there else None), found

    return draw


def done(value):
    return {"outcome": "done", "final_error_cm": value}


def dots(axes):
    """The points of the cases of a panel."""
    return sorted(
        tuple(map(float, point))
        for line in axes.lines if line.get_marker() == "o"
        for point in line.get_xydata()
    )  # fmt: skip


def test_every_case_is_a_dot_in_every_panel(drawn):
    kp = lambda case: case.parameters["Kp"]  # noqa: E731
    figure, found = drawn(TEXT, lambda case: done(kp(case) / 100 * (1 + case.value)))
    gain, eps, change, theta = figure.axes
    titles = [axes.get_xlabel() for axes in figure.axes]
    assert titles == ["Kp (1/s²)", "eps (s)", "change", "θ (π rad)"]
    assert figure.axes[0].get_ylabel() == "Finger\nfinal error (cm)"
    values = [(case, result["final_error_cm"]) for case, result in found]
    for axes, x in ((gain, kp), (eps, lambda case: case.parameters["eps"]),
                    (theta, lambda case: case.value)):  # fmt: skip
        assert dots(axes) == sorted((x(case), y) for case, y in values)
    assert (gain.get_xscale(), gain.get_yscale()) == ("log", "log")
    assert theta.get_xscale() == "linear"
    assert [text.get_text() for text in change.get_xticklabels()] == [
        "none", "mass x 0.9", "mass x 1.1"
    ]  # fmt: skip
    assert {round(x) for x, _ in dots(change)} == {0, 1, 2}
    # a line of medians for each controller, but none over random values
    lines = [line for line in gain.lines if line.get_linestyle() != "None"]
    assert len(lines) == 2
    np.testing.assert_allclose(lines[0].get_xydata(), [(10, 0.15), (100, 1.5), (1000, 15)])
    assert all(line.get_linestyle() == "None" for line in eps.lines)


def test_failed_cases_are_crosses_even_without_a_figure(drawn):
    text = 'robots = "finger"\ncontrollers = "ic"\ntargets.theta = 0.5\ngains.Kp = [10, 100, 1000]'
    results = {
        10: done(1.0),
        100: {"outcome": "failed", "final_error_cm": 30.0},
        1000: {"outcome": "raised", "final_error_cm": None},
    }
    figure, _ = drawn(text, lambda case: results[case.parameters["Kp"]])
    (axes,) = figure.axes
    assert dots(axes) == [(10, 1.0)]
    assert axes.get_yscale() == "log"
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    assert [tuple(line.get_xydata()[0]) for line in crosses] == [(100, 30.0), (1000, 1.0)]
    assert crosses[1].get_transform() == axes.get_xaxis_transform()  # on the upper edge
    (legend,) = figure.legends
    assert "failed run" in [text.get_text() for text in legend.get_texts()]


def test_a_sweep_in_which_nothing_varies_has_no_figure(drawn):
    text = 'robots = "finger"\ncontrollers = "ic"\ntargets.theta = 0.5\ngains.Kp = '
    figure, _ = drawn(text + "[10, 20]", lambda case: done(1.0))
    assert isinstance(figure, matplotlib.figure.Figure)
    assert drawn(text + "10", lambda case: done(1.0))[0] is None  # and the older one is gone


def test_the_command_writes_it_and_the_page_shows_it(tmp_path, capsys):
    from softdyn.commands import sweep as command

    (tmp_path / "sweep.toml").write_text(
        'robots = "finger"\ncontrollers = "ic"\ntargets.theta = 0.5\ngains.Kp = [10, 20]\n'
        "run.duration = 0.02\n"
    )
    out = tmp_path / "out"
    assert command.main([str(tmp_path / "sweep.toml"), "--out", str(out), "--jobs", "1",
                         "--json", "-"]) == 0  # fmt: skip
    files = json.loads(capsys.readouterr().out)["files"]
    assert str(out / "sweep.png") in files
    assert (out / "sweep.png").read_bytes()[:4] == b"\x89PNG"
    assert "![Every case](sweep.png)" in (out / "sweep.md").read_text()


def test_a_robot_has_no_panel_in_which_its_cases_do_not_differ(drawn, monkeypatch):
    """The targets of an arm are points of its own, so that it has no θ."""
    text = """
robots = ["finger", "helix"]
controllers = "ic"
rows = ["robot", "change", "gains.eps"]
targets.theta = [0.5, 1]
targets.equilibria = true
gains.eps = [0.01, 0.02]
labels = { ic = "Ours", "gains.eps" = "ε (s)", finger = "Fin" }
changes.heavy = { plant.mass = 1.1 }
"""
    results = iter(range(1000))
    own = {"helix": [("point", (0.1, 0.0, -0.2))]}
    monkeypatch.setattr(sweep, "study_targets", lambda model, found: own.get(model.name, found))
    figure, _ = drawn(text, lambda case: done(1.0 + next(results)))
    theta = "θ (π rad)"
    assert [axes.get_xlabel() for axes in figure.axes] == [
        "ε (s)", "change", theta, "ε (s)", "change"
    ]  # fmt: skip
    assert [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()] == [
        "Fin\nfinal error (cm)", "Helix\nfinal error (cm)"
    ]  # fmt: skip
    assert all(dots(axes) for axes in figure.axes)
    assert figure.get_figwidth() <= 3 * sweep_figure.WIDTH + 0.5
