"""A sweep's table for a paper: chosen figures of groups of runs, in Markdown, LaTeX and CSV.

A cell is all runs of the same row and column. Its figures are the mean and the standard deviation
over these runs, or the median with both quartiles; a note below the table says which, and over
what.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from softdyn.validation.loop.labels import cell_title, controller_title, robot_title
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import value as finite_or_inf
from softdyn.validation.studies.sweep import Sweep
from softdyn.validation.studies.sweep_report import Row, label, title_of
from softdyn.validation.tables import Table

TARGET, CHANGE = "target", "change"  # parameters of rows and columns that no axis has
Figure = tuple[str, str, Callable[[Mapping[str, Any]], float | None]]


def _root(result: Mapping[str, Any]) -> float | None:
    mse = result.get("mse_cm2")
    return None if mse is None else math.sqrt(mse)


MERITS: dict[str, Figure] = {
    "final": ("final error", "cm", lambda result: result.get("final_error_cm")),
    "rms": ("rms error", "cm", _root),
    "mse": ("mean squared error", "cm²", lambda result: result.get("mse_cm2")),
    "effort": ("effort", "", lambda result: result.get("input_effort")),
    "step_us": ("step", "µs", lambda result: (result.get("step_us") or {}).get("median")),
}
"""Name in a file → title, unit, and its value in a case's result."""
SPREADS = {
    "std": "Mean ± population standard deviation",
    "quartiles": "Median [lower quartile, upper quartile]",
}
MEANINGS = {
    "effort": "effort: root mean square of the inputs, each over its larger bound",
    "step_us": "step: median time of a control step, of runs that shared this machine",
}


@dataclass(frozen=True)
class Group:
    """The values of one figure of merit in the runs of a cell.

    Attributes
    ----------
    values : tuple of float
        One a run, infinite where a run has none.
    failed : int
        Number of its runs that failed.
    """

    values: tuple[float, ...]
    failed: int

    @cached_property
    def mean(self) -> float:
        """The mean; infinite if a run has no value."""
        return float(np.mean(self.values)) if self.whole else math.inf

    @cached_property
    def std(self) -> float:
        """The population standard deviation; infinite if a run has no value."""
        return float(np.std(self.values)) if self.whole else math.inf

    @property
    def whole(self) -> bool:
        """Whether each run has a value."""
        return all(map(math.isfinite, self.values))

    @cached_property
    def quartiles(self) -> tuple[float, float, float]:
        """Lower quartile, median, upper quartile; a run without a value counts as infinite."""
        order, found = sorted(self.values), []
        for share in (0.25, 0.5, 0.75):
            low, part = divmod(share * (len(order) - 1), 1.0)
            left, right = order[int(low)], order[min(int(low) + 1, len(order) - 1)]
            between = left + part * (right - left) if math.isfinite(right) else right
            found.append(left if part == 0 else between)
        return found[0], found[1], found[2]

    def centre(self, spread: str) -> tuple[float, float, float]:
        """The middle, and how far the spread reaches below and above it."""
        if spread == "std":
            return self.mean, self.std, self.std
        lower, median, upper = self.quartiles
        return median, median - lower, upper - median

    def text(self, spread: str) -> str:
        """The figure in a table."""
        middle = self.centre(spread)[0]
        failed = f" ({self.failed} of {len(self.values)} failed)" if self.failed else ""
        if not math.isfinite(middle):
            return f"failed{failed}" if len(self.values) > 1 else "failed"
        if len(self.values) == 1:
            return short(middle) + (" (failed)" if self.failed else "")
        if spread == "std":
            return f"{short(middle)} ± {short(self.std, middle)}{failed}"
        lower, _, upper = self.quartiles
        return f"{short(middle)} [{short(lower, middle)}, {short(upper, middle)}]{failed}"


def short(value: float, like: float | None = None) -> str:
    """A figure with three decimals below 0.1, two below 10, one below 100; or as many as `like`."""
    size = value if like is None else like
    if not math.isfinite(value):
        return "none"
    return f"{value:.{3 if size < 0.0995 else 2 if size < 9.995 else 1 if size < 99.95 else 0}f}"


@dataclass(frozen=True, eq=False)
class PaperTable:
    """The groups of a sweep's runs.

    Attributes
    ----------
    sweep : Sweep
    rows, columns : tuple of tuple of str
        Their texts, in the sweep's order.
    groups : mapping
        (row, column, name of a figure) → its `Group`.
    """

    sweep: Sweep
    rows: tuple[tuple[str, ...], ...]
    columns: tuple[tuple[str, ...], ...]
    groups: Mapping[tuple[tuple[str, ...], tuple[str, ...], str], Group]

    @classmethod
    def of(cls, sweep: Sweep, found: Sequence[Row]) -> PaperTable:
        """The table of cases with their results."""
        changes = {case.name: change for case, change in sweep.expanded}
        runs: dict[tuple[tuple[str, ...], tuple[str, ...]], list[Mapping[str, Any]]] = {}
        for case, result in found:
            place = (
                tuple(text(sweep, case, name, changes) for name in sweep.rows),
                tuple(text(sweep, case, name, changes, True) for name in sweep.columns),
            )
            runs.setdefault(place, []).append(result)
        groups = {
            (*place, name): Group(
                tuple(finite_or_inf(MERITS[name][2](result)) for result in results),
                sum(result["outcome"] != "done" for result in results),
            )
            for place, results in runs.items()
            for name in sweep.figures
        }
        rows, columns = (tuple(dict.fromkeys(place[k] for place in runs)) for k in (0, 1))
        return cls(sweep, rows, columns, groups)

    @property
    def note(self) -> str:
        """The meaning of a cell: its statistic, over how many runs, and which."""
        counts = sorted({len(group.values) for group in self.groups.values()})
        if counts in ([], [1]):
            said = "One run a cell"
        else:
            many = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
            said = f"{SPREADS[self.sweep.spread]} over {many} runs a cell"
            said += f", which differ in {over}" if (over := " and ".join(self._pooled())) else ""
        meanings = [MEANINGS[name] for name in self.sweep.figures if name in MEANINGS]
        return "; ".join([said, *meanings]) + "."

    def _pooled(self) -> Iterator[str]:
        """The settings that differ between the runs of a cell."""
        sweep = self.sweep
        named = {*sweep.rows, *sweep.columns}
        for name in sweep.grouped:
            if name not in named:
                yield sweep.labels.get(name, title_of(name))

    def titled(self, name: str) -> str:
        """Title and unit of a figure."""
        title, unit, _ = MERITS[name]
        title = self.sweep.labels.get(name, title)
        return f"{title} ({unit})" if unit else title

    def _table(self) -> tuple[list[tuple[str, int]], Table]:
        """The line above the titles: each column's text and width; the titles and cells."""
        sweep, figures = self.sweep, self.sweep.figures
        heads = [sweep.labels.get(name, label(name, sweep.unitless)) for name in sweep.rows]
        above = [("", len(heads)), *((", ".join(column), len(figures)) for column in self.columns)]
        titles = [self.titled(name) for _ in self.columns for name in figures]
        lines = []
        for row in self.rows:
            found = [self.groups.get((row, c, name)) for c in self.columns for name in figures]
            cells = [None if group is None else group.text(sweep.spread) for group in found]
            lines.append([*row, *cells])
        return above, Table([*heads, *titles], lines)

    def markdown(self) -> str:
        """The table, its note below."""
        above, table = self._table()
        wide = [text for text, width in above for _ in range(width)]
        titles = [", ".join(filter(None, pair)) for pair in zip(wide, table.titles, strict=True)]
        return f"{Table(titles, table.rows).markdown()}\n\n{self.note}"

    def latex(self) -> str:
        """The table as a `tabular` of booktabs, with its note as the last line."""
        above, table = self._table()
        sides = "l" * len(self.sweep.rows) + "c" * (len(table.titles) - len(self.sweep.rows))
        return table.latex(sides, above if self.sweep.columns else (), self.note)

    def csv(self) -> str:
        """One line per row, column and figure: all statistics as numbers in full."""
        sweep = self.sweep
        titles = [*sweep.rows, *sweep.columns, "figure", "unit", "runs", "failed"]
        titles += ["mean", "std", "median", "lower_quartile", "upper_quartile"]
        lines = []
        for (row, column, name), group in self.groups.items():
            lower, median, upper = group.quartiles
            numbers = (group.mean, group.std, median, lower, upper)
            known = [x if math.isfinite(x) else None for x in numbers]
            _, unit, _ = MERITS[name]
            lines.append(
                [*row, *column, name, unit, len(group.values), group.failed, *known]
            )  # fmt: skip
        return Table(titles, lines).csv()


def text(
    sweep: Sweep, case: Case, name: str, changes: Mapping[str, str], alone: bool = False
) -> str:
    """A parameter of a case in a row, or as a column's title, where it stands `alone`."""
    found = raw_text(sweep, case, name, changes)
    if found in sweep.labels:
        return sweep.labels[found]
    if name == "controller":
        return controller_title(found)
    if name == "robot":
        return robot_title(found)
    named = alone and name not in (TARGET, CHANGE)
    return f"{sweep.labels.get(name, title_of(name))} = {found}" if named else found


def raw_text(sweep: Sweep, case: Case, name: str, changes: Mapping[str, str]) -> str:
    """A parameter of a case without a label: that by which `labels` names it."""
    if name == TARGET:
        return cell_title(case.kind, case.value)
    if name == CHANGE:
        return changes[case.name]
    return str(getattr(case, name)) if name in ("robot", "controller") else sweep.text(case, name)


def labelled(sweep: Sweep) -> list[str]:
    """All that `labels` may name: robots, controllers, texts of rows and columns, parameters."""
    changes = {case.name: change for case, change in sweep.expanded}
    names = [*sweep.rows, *sweep.columns]
    found = {raw_text(sweep, case, name, changes): None for name in names for case in sweep.cases}
    every = [*sweep.robots, *sweep.controllers, *found, *names, *sweep.grouped, *sweep.figures]
    return list(dict.fromkeys(every))
