"""A sweep's results for people: every case as CSV, the best ones as Markdown."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softdyn.validation.studies.sweep import FIGURES, PLANT, Case, Sweep
from softdyn.validation.studies.sweep_run import load, load_any
from softdyn.validation.tables import inline, pipes

BEST = 10
SHOWN_REASONS = 20
RESULTS = (
    "outcome", *FIGURES, "steps", "simulated_s", "not_solved", "fallbacks", "max_bound_violation",
    "reason",
)  # fmt: skip
UNITS = {
    "gains.Kp": "1/s²", "gains.eps": "s", "gains.null_damping": "1/s",
    "plant.period": "s", "plant.duration": "s", "plant.timestep": "s",
    "theta": "π rad", "omega": "π rad/s",
}  # fmt: skip
SYMBOLS = {"theta": "θ", "omega": "ω"}

Row = tuple[Case, dict[str, Any]]


@dataclass(frozen=True)
class Setting:
    """A robot, a controller and its parameters, over all targets.

    Attributes
    ----------
    rows : its cases.
    mean, worst : of the figure over them; None when a case has none.
    """

    rows: tuple[Row, ...]
    mean: float | None
    worst: float | None

    @property
    def case(self) -> Case:
        """Any of the cases; they differ in their targets alone."""
        return self.rows[0][0]

    @property
    def failed(self) -> int:
        """How many of its cases did not end well."""
        return sum(result["outcome"] != "done" for _, result in self.rows)


def rows(tasks: Iterable[Any], folder: Path) -> list[Row]:
    """Cases with their results, in the sweep's order; what never ran has none and is left out."""
    found = []
    for task in tasks:
        result = load(task, folder) or load_any(task.case, folder)
        if result is not None:
            found.append((task.case, result))
    return found


def settings(found: Iterable[Row], figure: str) -> list[Setting]:
    """Cases that differ in their targets alone, put together; the best first.

    Fewest failed cases come before the smallest mean: a figure of a failed run says little.
    """
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for case, result in found:
        groups.setdefault(_setting(case), []).append((case, result))
    made = []
    for group in groups.values():
        values = [result.get(figure) for _, result in group]
        numbers = [v for v in values if v is not None]
        whole = len(numbers) == len(values)
        mean = math.fsum(numbers) / len(numbers) if whole else None
        made.append(Setting(tuple(group), mean, max(numbers) if whole else None))
    return sorted(made, key=lambda s: (s.failed, math.inf if s.mean is None else s.mean))


def _setting(case: Case) -> tuple[Any, ...]:
    """All of a case but its target, and what a trajectory's rate decides."""
    gains = None if case.gains is None else tuple(case.gains.items())
    plant = (case.period, case.timestep, case.contacts, case.friction)
    return case.robot, case.controller, gains, plant, case.sample


def outcomes(found: Iterable[Row]) -> dict[str, int]:
    """How many cases ended how."""
    return dict(Counter(result["outcome"] for _, result in found))


# -- CSV -------------------------------------------------------------------------------------------


def to_csv(found: list[Row]) -> str:
    """One line a case, in the sweep's order: inputs, outcome, figures, reason, file."""
    gains = list(dict.fromkeys(name for case, _ in found for name in case.gains or {}))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["robot", "controller", "theta", "omega", "x", "y", "z", *(f"gains.{g}" for g in gains),
         *PLANT, "sample", *RESULTS, "file"]
    )  # fmt: skip
    for case, result in found:
        point = case.target if isinstance(case.target, tuple) else ("", "", "")
        writer.writerow(
            [case.robot, case.controller, _cell(case.parameter("theta")),
             _cell(case.parameter("omega")), *map(_cell, point),
             *(_cell(case.parameter(f"gains.{g}")) for g in gains),
             *(_cell(getattr(case, name)) for name in PLANT), _cell(case.sample),
             *(_cell(result.get(name)) for name in RESULTS), f"cases/{case.name}.json"]
        )  # fmt: skip
    return text.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(value)


# -- Markdown --------------------------------------------------------------------------------------


def to_markdown(sweep: Sweep, found: list[Row]) -> str:
    """What varied, how the cases ended, the best of every robot, and why cases failed."""
    total = len(sweep.cases)
    parts = [f"# Sweep {inline(sweep.path.name)}", "", _counts(found, total), "", *_varied(sweep)]
    for robot in sweep.robots:
        of_robot = [row for row in found if row[0].robot == robot]
        if of_robot:
            parts += _best(sweep, robot, of_robot)
    parts += _reasons(sweep, found)
    return "\n".join(parts) + "\n"


def _counts(found: list[Row], total: int) -> str:
    ended = outcomes(found)
    left = total - len(found)
    words = [f"{ended[name]} {name.replace('_', ' ')}" for name in sorted(ended)]
    return f"{total} cases: " + ", ".join(words + ([f"{left} without a result"] if left else []))


def _varied(sweep: Sweep) -> list[str]:
    lines = []
    for axis in (*sweep.targets, *sweep.varying()):
        if axis.drawn:
            kind = axis.drawn.replace("_", "-")
            text = f"{len(axis.values)} {kind} samples, seed {sweep.seed}"
        elif len(axis.values) > 12:
            text = f"{len(axis.values)} values from {axis.values[0]:g} to {axis.values[-1]:g}"
        else:
            text = ", ".join(_value(value) for value in axis.values)
        lines.append(f"- {label(axis.name)}: {text}")
    return lines


def _best(sweep: Sweep, robot: str, found: list[Row]) -> list[str]:
    """The best cases of one robot and, over several targets, its best settings."""
    figure = FIGURES[sweep.figure]
    names = _columns(sweep)
    made = settings(found, sweep.figure)
    parts = ["", f"## {inline(robot)}"]
    if any(len(setting.rows) > 1 for setting in made):
        lines = [["", *names, f"mean {figure}", "worst", "failed"]]
        for i, setting in enumerate(made[:BEST], 1):
            failed = f"{setting.failed} of {len(setting.rows)}"
            figures = map(_value, (setting.mean, setting.worst))
            lines.append([str(i), *_inputs(setting.case, names), *figures, failed])
        parts += ["", f"Best settings by the mean {figure} over their targets.", "", *pipes(lines)]
    lines = [["", *names, "target", figure, "outcome", "file"]]
    for i, (case, result) in enumerate(ranked(found, sweep.figure), 1):
        ended = (_value(result.get(sweep.figure)), result["outcome"].replace("_", " "))
        file = f"cases/{case.name}.json"
        lines.append([str(i), *_inputs(case, names), _target(case), *ended, file])
    return [*parts, "", f"Best cases by {figure}.", "", *pipes(lines)]


def ranked(found: Iterable[Row], figure: str) -> list[Row]:
    """The best cases, those that ended well first; of equal ones the first in the sweep."""

    def rank(row: Row) -> tuple[bool, float]:
        value = row[1].get(figure)
        return row[1]["outcome"] != "done", math.inf if value is None else value

    return sorted(found, key=rank)[:BEST]


def _columns(sweep: Sweep) -> dict[str, str]:
    """Heading → parameter, of all that varies but robots and targets."""
    names = {"controller": "controller"} if len(sweep.controllers) > 1 else {}
    return names | {label(axis.name): axis.name for axis in sweep.varying()}


def _inputs(case: Case, names: dict[str, str]) -> list[str]:
    return [
        case.controller if name == "controller" else _value(case.parameter(name))
        for name in names.values()
    ]


def _target(case: Case) -> str:
    if isinstance(case.target, tuple):
        return "(" + ", ".join(f"{x:g}" for x in case.target) + ") m"
    unit = " rad/s" if case.kind == "omega" else ""
    return f"{SYMBOLS[case.kind]} = {case.target:g}π{unit}"


def _reasons(sweep: Sweep, found: list[Row]) -> list[str]:
    """Why cases did not end well, the first few word for word."""
    failures = [(case, result) for case, result in found if result["outcome"] != "done"]
    if not failures:
        return []
    names = _columns(sweep)
    parts = ["", "## Cases that did not end well", ""]
    for case, result in failures[:SHOWN_REASONS]:
        inputs = [f"{n} = {v}" for n, v in zip(names, _inputs(case, names), strict=True)]
        words = ", ".join([case.robot, *inputs, _target(case)])
        parts.append(f"- {inline(words)}: {result['outcome'].replace('_', ' ')}, "
                     f"{inline(result['reason'])}")  # fmt: skip
    more = len(failures) - SHOWN_REASONS
    return [*parts, *([f"- and {more} more: see sweep.csv"] if more > 0 else [])]


def label(name: str) -> str:
    """A parameter with its unit, e.g. ``Kp (1/s²)``."""
    short = SYMBOLS.get(name, name.rpartition(".")[2])
    return f"{short} ({UNITS[name]})" if name in UNITS else short


def _value(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "(" + ", ".join(f"{x:g}" for x in value) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
