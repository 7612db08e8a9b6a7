"""Distributions of cells over several runs, with their tables and files.

A figure that varies is printed as the median of all runs with their range, marked ``~``; a constant
figure is a plain number.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from statistics import fmean, pstdev
from typing import Any

from softdyn import InputError
from softdyn.validation.files import read_json, write_text
from softdyn.validation.tables import Table

LEVEL = 0.05  # significance level of a test of two seeds
MARK = "~"  # mark of a figure that stands for a distribution
CHANGE = "Δu (%)"  # title of the column of input changes
NOTE = f"{MARK}: the loop is chaotic; median [range] of runs whose first velocities differ by 1e-9."
NOISY = f"{NOTE[:-1]}, or, with noise or an observer, of runs with other seeds of the rig."
BESIDE = {
    "second_cycle": "a / b: whole run / second cycle.",
    "input_change": f"{CHANGE}: rms change of the inputs per period, of their range, in the second"
    " half; worst set point.",
}


def number(value: float) -> str:
    """A figure as in tables: two decimals, or three digits; "none" if a run has none."""
    if not math.isfinite(value):
        return "none"
    return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f}"


@dataclass(frozen=True)
class Distribution:
    """The figures of one cell in several runs.

    Attributes
    ----------
    nominal : float
        Figure of the run from rest (cm or cm²); inf if the run ended early.
    seeds : mapping
        Seed → the figures of its nudged runs; empty if the printed figure is constant.
    failed : mapping
        Seed, or "nominal" → number of its failed runs, if there are any.
    second_cycle : Distribution, optional
        Of a trajectory: the figure of the second cycle (cm²) in the same runs.
    input_change : Distribution, optional
        Of a set point: the rms change of the inputs per period in the second half (% of their
        range) in the same runs.
    """

    nominal: float
    seeds: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    failed: Mapping[str, int] = field(default_factory=dict)
    second_cycle: Distribution | None = None
    input_change: Distribution | None = None

    @cached_property
    def values(self) -> tuple[float, ...]:
        """The figures of all runs, the one from rest first."""
        return (self.nominal, *(x for found in self.seeds.values() for x in found))

    @property
    def moves(self) -> bool:
        """Whether the runs' printed figures differ."""
        return len(set(map(number, self.values))) > 1

    @property
    def median(self) -> float:
        """The median of all runs."""
        return _median(self.values)

    @property
    def range(self) -> tuple[float, float]:
        """The least and the largest of all runs."""
        return min(self.values), max(self.values)

    def holds(self, value: float) -> bool:
        """Whether another run's figure lies in the range, or prints like one of its ends."""
        return _within(value, self.values)

    def overlap(self) -> bool:
        """Whether the ranges of all seeds overlap; seeds with one or two runs are ignored."""
        seeds = [found for found in self.seeds.values() if len(found) > 2]
        return not seeds or max(map(min, seeds)) <= min(map(max, seeds))

    def chance(self) -> float:
        """The probability that two draws of one distribution differ as much as its seeds do.

        The two-sided p-value of the rank test by Mann and Whitney (1947); 1 without two seeds.
        """
        if len(self.seeds) != 2:
            return 1.0
        from scipy.stats import mannwhitneyu  # its import takes half a second; few sweeps need it

        found = float(mannwhitneyu(*self.seeds.values()).pvalue)
        return 1.0 if math.isnan(found) else found  # all runs are equal

    @property
    def beside(self) -> dict[str, Any]:
        """The figures beside the cell's own that it has, a `Distribution` each, by their field."""
        found = {name: getattr(self, name) for name in BESIDE}
        return {name: cell for name, cell in found.items() if cell is not None}

    def constant(self) -> Distribution:
        """The same cell with only the run from rest."""
        beside = {name: cell.constant() for name, cell in self.beside.items()}
        return replace(self, seeds={}, **beside)

    def summary(self) -> dict[str, Any]:
        """Median, range, number of runs, failures, and the figure as in tables."""
        low, high = self.range
        found: dict[str, Any] = {"median": self.median, "low": low, "high": high}
        found["failed"] = dict(self.failed)
        found |= {"runs": len(self.values), "text": self.text()}
        return found | {name: cell.median for name, cell in self.beside.items()}

    def text(self, std: Distribution | None = None) -> str:
        """The figure, or the marked median and range; with a deviation, its median."""
        after = "" if std is None or math.isinf(std.median) else f" ± {number(std.median)}"
        if not self.moves:
            return number(self.nominal) + after
        low, high = self.range
        return f"{MARK}{number(self.median)}{after} [{number(low)}, {number(high)}]"

    def pair(self, std: Distribution | None = None) -> str:
        """The figure as text, and after a slash the second cycle's median if it has one."""
        second = self.second_cycle
        return self.text(std) + ("" if second is None else f" / {number(second.median)}")


@dataclass(frozen=True)
class Agreement:
    """Whether two seeds agree over many cells.

    At the 5 % level one cell in twenty differs by chance, so the differing cells are counted.

    Attributes
    ----------
    cells : mapping
        Label → cell, for cells with two seeds.
    disjoint : tuple of str
        Labels of cells whose ranges do not overlap.
    apart : tuple of str
        Labels of cells that differ at the 5 % level.
    allowed : int
        In 99 of 100 cases, at most this number differs by chance (binomial).
    """

    cells: Mapping[str, Distribution]
    disjoint: tuple[str, ...]
    apart: tuple[str, ...]
    allowed: int

    @classmethod
    def of(cls, cells: Mapping[str, Distribution]) -> Agreement:
        """Count the differing cells."""
        from scipy.stats import binom

        both = {label: cell for label, cell in cells.items() if len(cell.seeds) == 2}
        disjoint = tuple(label for label, cell in both.items() if not cell.overlap())
        apart = tuple(label for label, cell in both.items() if cell.chance() < LEVEL)
        return cls(both, disjoint, apart, int(binom.ppf(0.99, len(both), LEVEL)))


def mean_and_std(cells: Sequence[Distribution]) -> tuple[Distribution, Distribution]:
    """Mean and population standard deviation over cells, for runs of equal number and seed.

    Uses the same number of runs per seed in every cell that has runs. The mean also has that of
    the second cycles, if all cells have one.
    """
    lengths: dict[str, int] = {}
    for cell in cells:
        lengths |= {s: min(lengths.get(s, len(x)), len(x)) for s, x in cell.seeds.items()}

    def combined(of: Any) -> Distribution:
        def at(seed: str, k: int) -> float:
            # a constant cell has the same figure in every run
            return of([c.seeds[seed][k] if seed in c.seeds else c.nominal for c in cells])

        seeds = {seed: tuple(at(seed, k) for k in range(n)) for seed, n in lengths.items()}
        return Distribution(of([c.nominal for c in cells]), seeds)

    mean, second = combined(_finite(fmean)), [c.second_cycle for c in cells if c.second_cycle]
    if cells and len(second) == len(cells):
        mean = replace(mean, second_cycle=mean_and_std(second)[0])
    return mean, combined(_finite(pstdev))


def pivot(cells: Mapping[str, Distribution], titles: Sequence[str], mean: str = "") -> str:
    """A Markdown table of cells whose labels are ``row/…/column``.

    If cells have input changes, the last column is the largest of each row.

    Parameters
    ----------
    cells : mapping
        Cells by label, in the order of the table.
    titles : sequence of str
        Titles of all parts of a label except the last.
    mean : str
        Title of a last column with mean ± standard deviation over the row; none by default.
    """
    rows: dict[tuple[str, ...], dict[str, Distribution]] = {}
    for label, cell in cells.items():
        *row, column = label.split("/")
        rows.setdefault(tuple(row), {})[column] = cell
    columns = list(dict.fromkeys(column for found in rows.values() for column in found))
    smooth = any(cell.input_change for cell in cells.values())
    lines = []
    for row_, found in rows.items():
        lines.append([*row_, *(found[c].pair() if c in found else None for c in columns)])
        if mean:
            average, std = mean_and_std(list(found.values()))
            lines[-1].append(average.pair(std))
        if smooth:
            changes = [c.input_change.median for c in found.values() if c.input_change]
            lines[-1].append(number(max(changes)) if changes else None)
    more = [mean] * bool(mean) + [CHANGE] * smooth
    return Table([*titles, *columns, *more], lines).markdown()


def notes(cells: Mapping[str, Distribution]) -> str:
    """The meaning of the marks, pairs and columns of these cells' tables; empty without any."""
    has = {name for cell in cells.values() for name in cell.beside}
    marked = any(cell.moves for cell in cells.values())
    return " ".join([NOISY] * marked + [text for name, text in BESIDE.items() if name in has])


def read_distributions(path: Path) -> dict[str, Distribution]:
    """The cells that `write_distributions` wrote.

    Raises
    ------
    InputError
        For any other file.
    """
    expected = "distributions of closed loops, as --keep writes them"
    try:
        return {label: _read(entry) for label, entry in read_json(path, expected)["cells"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(str(path), expected, repr(error)) from None


def write_distributions(path: Path, cells: Mapping[str, Distribution]) -> None:
    """Write one cell per line, so that a diff shows the changed cells."""
    lines = [
        f"{json.dumps(label, ensure_ascii=False)}: {json.dumps(_written(cell))}"
        for label, cell in cells.items()
    ]
    write_text(path, '{"cells": {\n' + ",\n".join(lines) + "\n}}\n")


def join(
    old: Mapping[str, Distribution], new: Mapping[str, Distribution]
) -> dict[str, Distribution]:
    """Join old and new cells; a cell in both gets the runs of all seeds.

    If both have a seed, the longer list is kept, because both begin with the same runs. If the
    figure from rest differs, the old runs come from other code and are dropped.
    """
    both = dict(old)
    for label, cell in new.items():
        before = both.get(label)
        if before is None or number(before.nominal) != number(cell.nominal):
            both[label] = cell
        else:
            both[label] = _joined(before, cell)
    return both


def _joined(before: Distribution, cell: Distribution) -> Distribution:
    keys = {**before.seeds, **cell.seeds, **before.failed, **cell.failed}
    runs = {key: _longer(before, cell, key) for key in keys}
    seeds = {key: of.seeds[key] for key, of in runs.items() if key in of.seeds}
    failed = {key: of.failed[key] for key, of in runs.items() if key in of.failed}
    beside: dict[str, Any] = {
        name: _joined(before.beside[name], one) if name in before.beside else one
        for name, one in cell.beside.items()
    }
    return replace(cell, seeds=seeds, failed=failed, **beside)


def _longer(old: Distribution, new: Distribution, seed: str) -> Distribution:
    return old if len(old.seeds.get(seed, ())) > len(new.seeds.get(seed, ())) else new


def _written(cell: Distribution) -> dict[str, Any]:
    def short(value: float) -> float | None:
        return float(f"{value:.5g}") if math.isfinite(value) else None

    seeds = {seed: [short(x) for x in found] for seed, found in cell.seeds.items()}
    failed = {"failed": dict(cell.failed)} if cell.failed else {}
    beside = {name: _written(one) for name, one in cell.beside.items()}
    return {"nominal": short(cell.nominal), **seeds, **failed, **beside}


def _read(entry: Mapping[str, Any]) -> Distribution:
    known = {field.name for field in fields(Distribution)}
    seeds = {k: tuple(map(value, v)) for k, v in entry.items() if k not in known}
    beside = {name: _read(entry[name]) for name in BESIDE if name in entry}
    return Distribution(value(entry["nominal"]), seeds, dict(entry.get("failed", {})), **beside)


def value(figure: float | None) -> float:
    """A figure of a run as a number; inf if it has none."""
    return math.inf if figure is None or math.isnan(figure) else float(figure)


def _within(x: float, values: Sequence[float]) -> bool:
    low, high = min(values), max(values)
    return low <= x <= high or number(x) in (number(low), number(high))


def _median(values: Sequence[float]) -> float:
    found = sorted(values)
    low, high = found[(len(found) - 1) // 2], found[len(found) // 2]
    return high if math.isinf(high) else (low + high) / 2


def _finite(of: Any) -> Any:
    def finite(values: Sequence[float]) -> float:
        return float(of(values)) if all(map(math.isfinite, values)) else math.inf

    return finite
