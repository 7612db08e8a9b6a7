"""The benchmark's table as Markdown, LaTeX, and text for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from softdyn.controllers.registry import label_of
from softdyn.validation.files import write_json, write_text
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.studies import experiments
from softdyn.validation.studies.engine.distribution import NOTE, number
from softdyn.validation.tables import Table, document

TITLES = (
    "Robot", "Controller", "SP (cm)", "SP, paper", "SP, emulated", "TT (cm²)", "TT, paper",
    "TT, emulated", "Inputs (1/s)", "Failed runs",
)  # fmt: skip
EMULATED = (
    'The columns "emulated" repeat the published experiment with its own targets, plant and '
    "program: compare these with the paper. Their figures are committed; `python -m tests.proof "
    "reproduce …`, in a checkout, makes them again. The first column of SP and of TT is another "
    "experiment: the paper's equations in a finer plant."
)
ABOUT = (
    "SP: mean ± population standard deviation over the set points of the final error. "
    "TT: the same over the trajectories of the time-mean of the squared error. Means contain "
    'every run; "none" where one of them ended before its time. Inputs: how much they change '
    f"a second, over their range, mean over the inputs and the runs. {NOTE} {EMULATED}"
)


def benchmark_cells(row: dict[str, Any]) -> tuple[str, ...]:
    """One row of the table as text; a dash where no figure was requested or published."""
    published, emulated = row["paper"], row.get("emulated") or {}
    runs = len(row["set_points_cm"]) + len(row["trajectories_cm2"])

    def ours(kind: str, unit: str, runs: str) -> str:
        chaotic = row.get("ensemble", {}).get(f"{kind}_mean_{unit}")
        if chaotic is not None:
            return str(chaotic["text"])
        if not row[runs]:
            return "-"
        return spread(row, f"{kind}_mean_{unit}", f"{kind}_std_{unit}")

    def theirs(kind: str, unit: str) -> str:
        if published is None:
            return "-"
        return experiments.spread(*(published[f"{kind}_{what}_{unit}"] for what in ("mean", "std")))

    def again(kind: str, unit: str) -> str:
        mean, std = f"{kind}_mean_{unit}", f"{kind}_std_{unit}"
        return spread(emulated, mean, std) if mean in emulated else "-"

    return (
        row["robot"],
        label_of(row["controller"]),
        ours("sp", "cm", "set_points_cm"),
        theirs("sp", "cm"),
        again("sp", "cm"),
        ours("tt", "cm2", "trajectories_cm2"),
        theirs("tt", "cm2"),
        again("tt", "cm2"),
        "-" if row.get("input_activity") is None else f"{row['input_activity']:.3g}",
        f"{len(row['failed'])} of {runs}" if row["failed"] else "-",
    )


def spread(row: Mapping[str, Any], mean: str, std: str) -> str:
    """Mean ± deviation as text; "none" where a run ended before its time."""
    if row[mean] is None or row[std] is None:
        return "none"
    return f"{number(row[mean])} ± {number(row[std])}"


def emulations(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The commands, in a checkout of softdyn, that make the columns "emulated".

    CHECKOUT is one of the paper's program.
    """
    return [
        f"python -m tests.proof reproduce {' '.join(row['emulated']['experiments'])} "
        f"--robots {row['robot']} --controllers {row['controller']} --files CHECKOUT --keep FILE"
        for row in rows
        if row.get("emulated")
    ]


def benchmark_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Our values beside the published ones, a row for each robot and controller."""
    return Table(TITLES, [benchmark_cells(row) for row in rows])


def every_run_table(rows: Sequence[dict[str, Any]]) -> Table:
    """The figure of every run and the solver's counts, for each robot and controller."""
    points = list(rows[0]["set_points_cm"]) if rows else []
    rates = list(rows[0]["trajectories_cm2"]) if rows else []
    titles = [
        "Robot", "Controller", *(f"θ = {x}π (cm)" for x in points),
        *(f"ω = {x}π (cm²)" for x in rates), "Not solved", "Fallbacks", "Bounds exceeded by",
    ]  # fmt: skip
    lines = []
    for row in rows:
        shown = []
        for every in ("set_points_cm", "trajectories_cm2"):
            chaotic = row.get("ensemble", {}).get(every, {})
            for value, found in row[every].items():
                usual = "none" if found is None else number(found)
                shown.append(chaotic[value]["text"] if value in chaotic else usual)
        shown += [f"{row[key]:g}" for key in ("not_solved", "fallbacks", "max_bound_violation")]
        lines.append([*benchmark_cells(row)[:2], *shown])
    return Table(titles, lines)


def benchmark_document(rows: Sequence[dict[str, Any]]) -> str:
    """The table, every run's figure, the solver's counts, and the reasons of failed runs."""
    named = [(", ".join((row["robot"], benchmark_cells(row)[1])), row) for row in rows]
    apart = [f"- {name}: {', '.join(row['outside'])}" for name, row in named if row.get("outside")]
    failures = [
        f"- {name}, {cell_title(f['kind'], f['value'])}: {f['reason']}"
        for name, row in named
        for f in row["failed"]
    ]
    commands = "\n".join(f"    {line}" for line in emulations(rows))
    return document(
        "# Benchmark", benchmark_table(rows).markdown(), ABOUT,
        *(["## How the emulated figures were made", commands] if commands else []),
        "## Every run", every_run_table(rows).markdown(),
        *(["## Outside the committed ensembles", "\n".join(apart)] if apart else []),
        *(["## Failed runs", "\n".join(failures)] if failures else []),
    )  # fmt: skip


def write_benchmark(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """Write the table into a folder, as Markdown, LaTeX and JSON."""
    write_text(folder / "table.md", benchmark_document(rows))
    write_text(folder / "table.tex", benchmark_table(rows).latex("llrrrrrrrl"))
    write_json(folder / "results.json", {"rows": list(rows)})
