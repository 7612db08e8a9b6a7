"""The benchmark's table for people: Markdown, LaTeX, and text for a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from softdyn.validation.files import write_json, write_text
from softdyn.validation.studies import experiments
from softdyn.validation.studies.engine.distribution import NOTE, number
from softdyn.validation.studies.names import CONTROLLERS, cell_title
from softdyn.validation.tables import columns, pipes

TITLES = (
    "Robot", "Controller", "SP (cm)", "SP, paper", "TT (cm²)", "TT, paper", "Inputs (1/s)",
    "Failed runs",
)  # fmt: skip


def spread(mean: float | None, std: float | None) -> str:
    """Mean ± standard deviation; "none" for a mean over a run that did not reach its end."""
    return "none" if mean is None or std is None else f"{number(mean)} ± {number(std)}"


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """One row of the table as text; a dash for what was not asked for or not published."""
    published = row["paper"]

    def ours(kind: str, unit: str, runs: str) -> str:
        chaotic = row.get("ensemble", {}).get(f"{kind}_mean_{unit}")
        if chaotic is not None:
            return str(chaotic["text"])
        mean, std = (row[f"{kind}_{what}_{unit}"] for what in ("mean", "std"))
        return spread(mean, std) if row[runs] else "-"

    def theirs(kind: str, unit: str) -> str:
        if published is None:
            return "-"
        mean, std = (published[f"{kind}_{what}_{unit}"] for what in ("mean", "std"))
        return experiments.spread(mean, std)

    return (
        row["robot"],
        CONTROLLERS.get(row["controller"], row["controller"]),
        ours("sp", "cm", "set_points_cm"),
        theirs("sp", "cm"),
        ours("tt", "cm2", "trajectories_cm2"),
        theirs("tt", "cm2"),
        "-" if row.get("input_activity") is None else f"{row['input_activity']:.3g}",
        ", ".join(cell_title(f["kind"], f["value"]) for f in row["failed"]) or "-",
    )


def write(rows: list[dict[str, Any]], folder: Path) -> None:
    """The table below a folder, as Markdown, LaTeX and JSON."""
    write_text(folder / "table.md", markdown(rows))
    write_text(folder / "table.tex", latex(rows))
    write_json(folder / "results.json", {"rows": rows})


def text(rows: list[dict[str, Any]]) -> str:
    """Aligned columns for a terminal."""
    return columns([TITLES, *(cells(row) for row in rows)])


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table, every run's figure, what the solver did, and the failed runs' reasons."""
    parts = ["# Benchmark", "", *pipes([TITLES, *(cells(row) for row in rows)])]
    parts += [
        "",
        "SP: mean ± population standard deviation over the set points of the final error. "
        "TT: the same over the trajectories of the time-mean of the squared error. Means contain "
        'every run; "none" where one of them ended before its time. Inputs: how much they change '
        "a second, over their range, mean over the inputs and the runs. " + NOTE,
        "",
    ]
    parts += ["## Every run", "", *pipes(every_run(rows))]
    apart = [
        f"- {row['robot']}, {cells(row)[1]}: {', '.join(row['outside'])}"
        for row in rows
        if row.get("outside")
    ]
    if apart:
        parts += ["", "## Outside the committed ensembles", "", *apart]
    failures = [
        f"- {row['robot']}, {cells(row)[1]}, {cell_title(f['kind'], f['value'])}: {f['reason']}"
        for row in rows
        for f in row["failed"]
    ]
    if failures:
        parts += ["", "## Failed runs", "", *failures]
    return "\n".join(parts) + "\n"


def every_run(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Titles, then for each row the figure of every run and what the solver did."""
    points = list(rows[0]["set_points_cm"]) if rows else []
    rates = list(rows[0]["trajectories_cm2"]) if rows else []
    titles = [
        "Robot", "Controller", *(f"θ = {x}π (cm)" for x in points),
        *(f"ω = {x}π (cm²)" for x in rates), "Not solved", "Fallbacks", "Bounds exceeded by",
    ]  # fmt: skip
    lines = [titles]
    for row in rows:
        shown = []
        for every in ("set_points_cm", "trajectories_cm2"):
            chaotic = row.get("ensemble", {}).get(every, {})
            for value, found in row[every].items():
                usual = "none" if found is None else number(found)
                shown.append(chaotic[value]["text"] if value in chaotic else usual)
        shown += [f"{row[key]:g}" for key in ("not_solved", "fallbacks", "max_bound_violation")]
        lines.append([*cells(row)[:2], *shown])
    return lines


def latex(rows: list[dict[str, Any]]) -> str:
    """A booktabs table in the paper's layout, ours beside the published values."""
    lines = [
        r"\begin{tabular}{llrrrrrl}",
        r"\toprule",
        " & ".join(_tex(title) for title in TITLES) + r" \\",
    ]
    robot = None
    for row in rows:
        shown = [_tex(cell) for cell in cells(row)]
        if row["robot"] != robot:
            lines.append(r"\midrule")
        else:
            shown[0] = ""
        robot = row["robot"]
        lines.append(" & ".join(shown) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


_TEX = str.maketrans({
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "_": r"\_", "&": r"\&", "%": r"\%",
    "#": r"\#", "$": r"\$", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "\n": " ",
    "±": r"$\pm$", "²": "$^2$", "π": r"$\pi$", "θ": r"$\theta$", "ω": r"$\omega$",
})  # fmt: skip


def _tex(text: str) -> str:
    return text.translate(_TEX)
