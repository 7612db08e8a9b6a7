"""Many robots through the cross-check: those of example-robot-data, or random ones."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import softdyn
from softdyn import SoftdynError
from softdyn.description.library import example_files
from softdyn.validation.crosschecks.crosscheck import CrossCheck, crosscheck, finite
from softdyn.validation.crosschecks.random_robots import write_robot
from softdyn.validation.processes import in_processes

FIXED, REPAIRED, FLOATING = "fixed base", "fixed base, inertia repaired", "floating base"


@dataclass(frozen=True)
class Job:
    """One robot to examine: `name` for people, where it comes from, and how to load it."""

    name: str
    path: Path | None
    seed: int
    samples: int
    floating: bool = False
    repair_inertia: bool = False
    trajectories: bool = True


@dataclass(frozen=True)
class Row:
    """What the cross-check said of one robot.

    Attributes
    ----------
    name, variant : the robot, and how its base was held.
    passed : None of a robot that is not supported, with the reason why.
    nv : degrees of freedom; None of a robot that was not built.
    quantity, max_error : the one that comes closest to its tolerance, or exceeds it most.
    condition : the largest condition number of M met.
    repairs : what was mended.
    seconds : wall clock, the building of both models included.
    """

    name: str
    variant: str
    passed: bool | None
    nv: int | None = None
    quantity: str = ""
    max_error: float | None = None
    condition: float | None = None
    reason: str = ""
    repairs: tuple[str, ...] = ()
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return {**vars(self), "repairs": list(self.repairs)}


def catalogue_jobs(
    samples: int, seed: int, *, floating: bool, repair_inertia: bool, trajectories: bool = True
) -> list[Job]:
    """Every URDF of example-robot-data as it is; floating and repaired on top where asked for."""
    jobs = []
    for path in example_files():
        plain = Job(_short(path), path, seed, samples, trajectories=trajectories)
        jobs.append(plain)
        if repair_inertia:
            jobs.append(replace(plain, repair_inertia=True))
        if floating:
            jobs.append(replace(plain, floating=True, repair_inertia=repair_inertia))
    return jobs


def random_jobs(
    count: int, samples: int, seed: int, *, floating: bool = False, trajectories: bool = True
) -> list[Job]:
    """`count` random robots of the seeds from `seed` on."""
    return [
        Job(f"random_{k}", None, k, samples, floating, trajectories=trajectories)
        for k in range(seed, seed + count)
    ]


def examine_all(jobs: Sequence[Job], processes: int = -1) -> Iterator[Row]:
    """Rows as they come; no row for a repair of what needs none."""
    rows = in_processes(examine, ((job,) for job in jobs), processes)
    return (row for row in rows if row is not None)


def examine(job: Job) -> Row | None:
    """Load one robot, cross-check it, and say what came out; never raises on a bad file."""
    if job.path is None:
        with TemporaryDirectory() as folder:
            return _examine(replace(job, path=write_robot(job.seed, Path(folder))))
    return _examine(job)


def _examine(job: Job) -> Row | None:
    variant = FLOATING if job.floating else REPAIRED if job.repair_inertia else FIXED
    began = perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the robot's links; what is mended is in the row
        try:
            model = softdyn.load(
                str(job.path), floating=job.floating, repair_inertia=job.repair_inertia
            )
            if variant == REPAIRED and not model.robot.mended:
                return None
            result = crosscheck(
                model, samples=job.samples, seed=job.seed, trajectories=job.trajectories
            )
        except SoftdynError as error:
            if variant == REPAIRED:
                return None
            reason = str(error).replace(str(job.path), job.name)
            return Row(job.name, variant, None, reason=reason, seconds=perf_counter() - began)
    repairs = tuple(text.partition(": ")[2] for text in model.robot.warnings if "repaired" in text)
    return _row(job.name, variant, result, repairs, perf_counter() - began)


def _row(
    name: str, variant: str, result: CrossCheck, repairs: tuple[str, ...], seconds: float
) -> Row:
    worst = max(
        result.checks,
        key=lambda check: (not check.passed, (finite(check.max_error) or 0.0) / check.tolerance),
    )
    return Row(
        name,
        variant,
        result.passed,
        result.nv,
        worst.quantity,
        finite(worst.max_error),
        finite(result.condition),
        "; ".join(f"{check.quantity}: {check.reason}" for check in result.checks if check.reason),
        repairs,
        seconds,
    )


def _short(path: Path) -> str:
    """A file of the package below its folder of robots."""
    return str(path).rpartition("/robots/")[2] if "/robots/" in str(path) else path.name


def in_order(jobs: Sequence[Job], rows: Sequence[Row]) -> list[Row]:
    """Rows in the order of their jobs, whatever order they came in."""
    names = {name: k for k, name in enumerate(dict.fromkeys(job.name for job in jobs))}
    variants = (FIXED, REPAIRED, FLOATING)
    return sorted(rows, key=lambda row: (names[row.name], variants.index(row.variant)))


def counts(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """By variant, how many robots passed, failed and are not supported."""
    words = {True: "passed", False: "failed", None: "unsupported"}
    found: dict[str, dict[str, int]] = {}
    for row in rows:
        tally = found.setdefault(row.variant, dict.fromkeys(words.values(), 0))
        tally[words[row.passed]] += 1
    return found


def verdict(row: Row) -> str:
    """The row's last column."""
    if row.passed is None:
        return f"unsupported: {row.reason}"
    parts = [] if row.passed else ["FAILED"]
    parts += [row.reason] if row.reason else []
    parts += [f"{len(row.repairs)} inertias repaired"] if row.repairs else []
    return ", ".join(parts)


def cells(row: Row) -> tuple[str, ...]:
    """Robot, nv, worst error, the quantity it is of, cond(M), seconds, verdict."""
    return (
        row.name,
        "-" if row.nv is None else str(row.nv),
        "-" if row.max_error is None else f"{row.max_error:.1e}",
        row.quantity or "-",
        "-" if row.condition is None else f"{row.condition:.0e}",
        f"{row.seconds:.1f}",
        verdict(row) or "ok",
    )


def text(rows: Sequence[Row], tally: dict[str, dict[str, int]]) -> str:
    """Aligned columns for a terminal, one line a robot and one a variant."""
    lines = [(*cells(row), row.variant) for row in rows]
    widths = [max((len(line[i]) for line in lines), default=0) for i in range(6)]
    shown = [
        "  ".join(cell.ljust(width) for cell, width in zip(line[:6], widths, strict=True))
        + f"  {line[7]}: {line[6]}"
        for line in lines
    ]
    for variant, count in tally.items():
        shown.append(f"{variant}: " + ", ".join(f"{n} {word}" for word, n in count.items()))
    return "\n".join(shown)


def markdown(rows: Sequence[Row], command: str) -> str:
    """The tables as a document, one a variant."""
    lines = [
        "# The catalogue: every URDF of example-robot-data through the cross-check",
        "",
        f"Written by `{command}`.",
        "Each robot is built in Pinocchio and in MuJoCo from its file, by two parsers",
        "([conventions.md](conventions.md)). It passes when every quantity is within 1e-10 (1e-11",
        "along trajectories); shown is the one that comes closest to its tolerance. cond(M) is the",
        "largest condition number of the mass matrix met: engines that agree on M to rounding ε",
        "can differ by ε cond(M) in q̈, which solves with M. Times are wall clock of one process,",
        "the building of both models included.",
    ]
    for variant, group in groupby(sorted(rows, key=lambda row: row.variant), lambda r: r.variant):
        members = list(group)
        tally = counts(members)[variant]
        lines += [
            "",
            f"## {variant.capitalize()}",
            "",
            f"{tally['passed']} of {len(members)} pass, {tally['failed']} fail, "
            f"{tally['unsupported']} are not supported.",
            "",
            "| robot | nv | worst error | of | cond(M) | s | |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [
            "| " + " | ".join(_escaped(cell) for cell in cells(row)) + " |" for row in members
        ]
    repairs = sorted({repair for row in rows for repair in row.repairs})
    if repairs:
        lines += ["", "## What was repaired", "", *(f"- {_escaped(text)}" for text in repairs)]
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")
