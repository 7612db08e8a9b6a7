"""The benchmark's table as Markdown, LaTeX and text."""

import re

from softdyn.validation.studies.benchmark import emulated
from softdyn.validation.studies.benchmark_table import (
    TITLES,
    benchmark_cells,
    benchmark_document,
    benchmark_table,
)

PAPER = {"sp_mean_cm": 0.08, "sp_std_cm": 0.09, "tt_mean_cm2": None, "tt_std_cm2": None}


def row(**changes):
    found = {
        "robot": "finger",
        "controller": "soft-id-clf-qp",
        "sp_mean_cm": 0.0625,
        "sp_std_cm": 0.5,
        "tt_mean_cm2": None,
        "tt_std_cm2": None,
        "failed": [{"kind": "tracking", "value": 0.2, "reason": "the tip | diverged"}],
        "set_points_cm": {"0": 0.125, "0.5": 0.0},
        "trajectories_cm2": {"0.2": None},
        "input_activity": 12.345,
        "not_solved": 3,
        "fallbacks": 4,
        "max_bound_violation": 0.0,
        "paper": PAPER,
    }
    return found | changes


NASTY = r"a_b&c%d#e$f{g}h^i~j|k\l<m>.py:C"
ROWS = [
    row(),
    row(controller=NASTY, paper=None),
    row(robot="my_arm.urdf", set_points_cm={"0": None, "0.5": 1.0}, failed=[]),
]


def table_lines(text):
    return [line for line in text.splitlines() if line.startswith("|")]


def columns(line):
    return len(re.split(r"(?<!\\)\|", line)) - 2


def test_cells():
    assert benchmark_cells(row()) == (
        "finger", "Soft ID-CLF-QP", "0.06 ± 0.50", "0.08 ± 0.09", "-", "none", "failed", "-",
        "12.3", "1 of 3",
    )  # fmt: skip
    assert benchmark_cells(row(input_activity=None))[8] == "-"


def test_what_was_not_asked_for_is_not_a_failure():
    found = benchmark_cells(row(sp_mean_cm=None, sp_std_cm=None, set_points_cm={}, paper=None))
    assert found[2:8] == ("-", "-", "-", "none", "-", "-")


def test_the_published_experiment_stands_beside_the_published_figure():
    """434 cm² beside 24.1 is no failed reproduction: the emulation of that experiment gives it."""
    helix = row(robot="helix", controller="ic-qp", emulated=emulated("helix", "ic-qp"))
    document = benchmark_document([helix])
    cells = dict(zip(TITLES, benchmark_cells(helix), strict=True))
    # the documents' own figures, docs/reproduction.md, "Cell by cell"
    assert (cells["SP, emulated"], cells["TT, emulated"]) == ("2.46 ± 1.21", "26.1 ± 9.88")
    again = "python -m tests.proof reproduce reference+hulls+w2 --robots helix --controllers ic-qp"
    assert again in document


def test_an_emulated_run_that_ended_early_has_no_mean():
    assert benchmark_cells(row(emulated=emulated("helix", "clf-qp")))[4] == "none"
    assert emulated("finger", "best") is None


def test_markdown_columns():
    text = benchmark_document(ROWS)
    blocks = [table_lines(block) for block in text.split("\n\n")]
    blocks = [block for block in blocks if block]
    assert [len(block) for block in blocks] == [2 + len(ROWS)] * 2
    for block in blocks:
        assert len({columns(line) for line in block}) == 1
        assert set(block[1]) == set("| -")
    assert "- finger, Soft ID-CLF-QP, ω = 0.2π: the tip | diverged" in text
    assert "| finger | Soft ID-CLF-QP | 0.12 | 0.00 | none | 3 | 4 | 0 |" in text


def test_markdown_without_failures():
    assert "Failed runs\n" not in benchmark_document([row(failed=[])])


def plain_tex(text):
    """`text` with every escaped or named symbol replaced by a letter."""
    text = re.sub(r"\\(textbackslash|textasciicircum|textasciitilde|textless|textgreater|textbar)"
                  r"\{\}", "x", text)  # fmt: skip
    return re.sub(r"\\[_&%#${}]", "x", text)


def test_latex_is_balanced_and_escaped():
    text = benchmark_table(ROWS).latex("llrrrrrrrl")
    lines = text.splitlines()
    (spec,) = re.findall(r"^\\begin\{tabular\}\{(\w+)\}$", lines[0])
    assert lines[-1] == r"\end{tabular}"
    assert lines.count(r"\midrule") == 2  # one a robot
    body = [line for line in lines if line.endswith(r"\\")]
    assert len(body) == 1 + len(ROWS)
    for line in body:
        bare = plain_tex(line.removesuffix(r"\\"))
        assert bare.count("&") == len(spec) - 1
        assert bare.count("$") % 2 == 0
        assert bare.count("{") == bare.count("}")
        outside = "".join(bare.split("$")[::2])
        assert not set(outside) & set(r"\{}_^~%#|<>$±²πθω")


def test_no_rows():
    table = benchmark_table([])
    assert len(benchmark_document([]).splitlines()) > 1
    assert len(table.latex("llrrrrrrrl").splitlines()) == 5
    assert len(table.text().splitlines()) == 1


def test_text_is_aligned():
    first, *others = benchmark_table(ROWS).text().splitlines()
    for title in ("Controller", "SP (cm)", "Failed runs"):
        start = first.index(title)
        assert all(line[start - 1] == " " != line[start] for line in others)
