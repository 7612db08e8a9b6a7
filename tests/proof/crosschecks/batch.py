"""The cross-check of many robots: those of example-robot-data, or random ones."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import softdyn
from softdyn import SoftdynError
from softdyn.description.library import example_files
from softdyn.validation.crosschecks.crosscheck import crosscheck
from softdyn.validation.crosschecks.result import Check, finite
from softdyn.validation.processes import in_order
from softdyn.validation.tables import Table, document, inline
from tests.proof.crosschecks.forced_robots import forced_checks, forced_robot, forced_seeds
from tests.support.random_robots import write_robot

FIXED, REPAIRED, FLOATING = "fixed base", "fixed base, inertia repaired", "floating base"


VERDICTS = {True: "passed", False: "failed", None: "unsupported"}


@dataclass(frozen=True)
class RobotJob:
    """One robot to examine: its displayed `name`, its source, and how to load it."""

    name: str
    path: Path | None
    seed: int
    samples: int
    floating: bool = False
    repair_inertia: bool = False
    trajectories: bool = True
    force: str = ""

    @property
    def variant(self) -> str:
        """Whether the base is fixed or floats, and whether inertias are repaired; or the force."""
        if self.force:
            return f"with {self.force}"
        return FLOATING if self.floating else REPAIRED if self.repair_inertia else FIXED


@dataclass(frozen=True)
class BatchRow:
    """The cross-check's result for one robot.

    Attributes
    ----------
    name, variant : str
        The robot, and its base and repair.
    passed : bool or None
        None for a robot that is not supported.
    nv : int or None
        Degrees of freedom; None for a robot that was not built.
    quantity, max_error
        The quantity that comes closest to its tolerance or exceeds it most, and its error.
    condition : float or None
        The largest condition number of M.
    repairs : tuple of str
        The repairs.
    seconds : float
        Wall-clock time, including the building of both models.
    errors : dict of str to float
        Of a robot with a force the error of each quantity.
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
    errors: dict[str, float] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        if self.passed is None:
            return f"unsupported: {self.reason}"
        mended = f"{len(self.repairs)} inertias repaired" if self.repairs else ""
        parts = ("" if self.passed else "FAILED", self.reason, mended)
        return ", ".join(filter(None, parts)) or "ok"

    @property
    def shown(self) -> dict[str, Any]:
        """The row with the keys of `COLUMNS`."""
        return vars(self) | {"quantity": self.quantity or None, "verdict": self.verdict}


@dataclass(frozen=True)
class BatchReport:
    """The cross-check of many robots, a row each."""

    rows: tuple[BatchRow, ...]

    @property
    def passed(self) -> bool:
        """Whether no robot failed; a robot that is not supported does not count as failed."""
        return all(row.passed is not False for row in self.rows)

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """The numbers of robots that passed, failed and are not supported, by variant."""
        found: dict[str, dict[str, int]] = {}
        for row in self.rows:
            tally = found.setdefault(row.variant, dict.fromkeys(VERDICTS.values(), 0))
            tally[VERDICTS[row.passed]] += 1
        return found

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        rows = [vars(row) for row in self.rows]
        return {"passed": self.passed, "counts": self.counts, "rows": rows}

    def __str__(self) -> str:
        return self.text_of(self.rows)

    def text_of(self, rows: Sequence[BatchRow]) -> str:
        """A line for each of `rows`, and the total counts."""
        lines = [row.shown | {"verdict": f"{row.variant}: {row.verdict}"} for row in rows]
        table = replace(Table.of(COLUMNS, lines), titles=())
        tallies = [
            f"{variant}: " + ", ".join(f"{n} {word}" for word, n in count.items())
            for variant, count in self.counts.items()
        ]
        forced = [_largest(name, list(group)) for name, group in groupby(
            (row for row in self.rows if row.errors), lambda row: row.variant
        )]  # fmt: skip
        return "\n".join([*([table.text()] if lines else []), *tallies, *forced])

    def document(self, command: str) -> str:
        """The rows as a document, a table for each variant; it names `command` as its source."""
        blocks = [DOCUMENT.format(command)]
        rows = sorted(self.rows, key=lambda row: row.variant)
        for variant, group in groupby(rows, lambda row: row.variant):
            members, tally = list(group), self.counts[variant]
            blocks += [
                f"## {variant.capitalize()}",
                f"{tally['passed']} of {len(members)} pass, {tally['failed']} fail, "
                f"{tally['unsupported']} are not supported.",
                Table.of(COLUMNS, (row.shown for row in members)).markdown(),
            ]
        repairs = sorted({repair for row in rows for repair in row.repairs})
        if repairs:
            listed = "\n".join(f"- {inline(text)}" for text in repairs)
            blocks += ["## What was repaired", listed]
        return document(*blocks)


COLUMNS = (
    ("robot", "name", ""), ("nv", "nv", "d"), ("worst error", "max_error", ".1e"),
    ("of", "quantity", ""), ("cond(M)", "condition", ".0e"), ("s", "seconds", ".1f"),
    ("", "verdict", ""),
)  # fmt: skip
DOCUMENT = """\
# The catalogue: every URDF of example-robot-data through the cross-check

Written by `{}`.
Two parsers read each file, one for Pinocchio and one for MuJoCo ([conventions](conventions.md)).
A robot passes if every quantity agrees within 1e-10 (1e-11 along trajectories). The table gives
the quantity that comes closest to its tolerance. cond(M) is the largest condition number of the
mass matrix: if M agrees to rounding ε, q̈ can differ by ε cond(M). Times are wall clock of one
process and include the building of both models."""


def catalogue_jobs(
    samples: int, seed: int, *, floating: bool, repair_inertia: bool, trajectories: bool = True
) -> list[RobotJob]:
    """Jobs for every URDF of example-robot-data, on request also floating and repaired."""
    jobs = []
    for path in example_files():
        plain = RobotJob(_short(path), path, seed, samples, trajectories=trajectories)
        jobs.append(plain)
        if repair_inertia:
            jobs.append(replace(plain, repair_inertia=True))
        if floating:
            jobs.append(replace(plain, floating=True, repair_inertia=repair_inertia))
    return jobs


def random_jobs(
    count: int, samples: int, seed: int, *, floating: bool = False, trajectories: bool = True
) -> list[RobotJob]:
    """Jobs for `count` random robots, with the seeds from `seed` on."""
    return [
        RobotJob(f"random_{k}", None, k, samples, floating, trajectories=trajectories)
        for k in range(seed, seed + count)
    ]


def forced_jobs(
    kind: str, count: int, samples: int, seed: int, *, trajectories: bool = True
) -> list[RobotJob]:
    """Jobs for `count` random robots with a kind of force, with seeds from `seed` on."""
    return [
        RobotJob(f"random_{k}", None, k, samples, trajectories=trajectories, force=kind)
        for k in forced_seeds(kind, count, seed)
    ]


def survey(jobs: Sequence[RobotJob], processes: int = -1) -> BatchReport:
    """`examine` all `jobs` in their order; a repair job without repairs has no row."""
    rows = in_order(examine, [(job,) for job in jobs], processes)
    return BatchReport(tuple(row for row in rows if row is not None))


def examine(job: RobotJob) -> BatchRow | None:
    """Load one robot, cross-check it and return the row; a bad file raises nothing."""
    if job.force:
        return _examine_forced(job)
    if job.path is None:
        with TemporaryDirectory() as folder:
            return examine(replace(job, path=write_robot(job.seed, Path(folder))))
    began = perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings about links; the row has the repairs
        try:
            model = softdyn.load(
                str(job.path), floating=job.floating, repair_inertia=job.repair_inertia
            )
            if job.variant == REPAIRED and not model.robot.mended:
                return None
            result = crosscheck(
                model, samples=job.samples, seed=job.seed, trajectories=job.trajectories
            )
        except SoftdynError as error:
            if job.variant == REPAIRED:
                return None
            reason = str(error).replace(str(job.path), job.name)
            seconds = perf_counter() - began
            return BatchRow(job.name, job.variant, None, reason=reason, seconds=seconds)
    worst = _worst(result.checks)
    return BatchRow(
        job.name,
        job.variant,
        result.passed,
        result.nv,
        worst.quantity,
        finite(worst.max_error),
        finite(result.condition),
        "; ".join(f"{check.quantity}: {check.reason}" for check in result.checks if check.reason),
        tuple(text.partition(": ")[2] for text in model.robot.warnings if "repaired" in text),
        perf_counter() - began,
    )


def _examine_forced(job: RobotJob) -> BatchRow:
    """The row of a random robot with a force."""
    began = perf_counter()
    model = forced_robot(job.force, job.seed)
    assert model is not None  # `forced_seeds` has looked
    checks, condition = forced_checks(model, job.samples, job.seed, trajectories=job.trajectories)
    worst = _worst(checks)
    return BatchRow(
        job.name, job.variant, all(check.passed for check in checks), model.nv, worst.quantity,
        finite(worst.max_error), finite(condition),
        "; ".join(f"{check.quantity}: {check.reason}" for check in checks if check.reason),
        seconds=perf_counter() - began,
        errors={one.quantity: one.max_error for one in checks if one.compared},
    )  # fmt: skip


def _largest(variant: str, rows: Sequence[BatchRow]) -> str:
    """The largest error of each quantity that all rows have."""
    names = set.intersection(*({*row.errors} for row in rows))
    worst = (f"{name} {max(row.errors[name] for row in rows):.1e}" for name in sorted(names))
    return f"{variant}, largest errors: {', '.join(worst)}"


def _worst(checks: Sequence[Check]) -> Check:
    """The check that comes closest to its tolerance, or exceeds it most."""
    return max(
        checks,
        key=lambda check: (not check.passed, (finite(check.max_error) or 0.0) / check.tolerance),
    )


def _short(path: Path) -> str:
    """A file's path relative to the package's folder of robots."""
    return str(path).rpartition("/robots/")[2] if "/robots/" in str(path) else path.name
