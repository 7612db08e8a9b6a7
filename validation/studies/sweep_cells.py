"""A sweep as a table: one cell a case, told apart by what differs between its rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from softdyn import InputError
from softdyn.validation.files import safe_filename
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import NOTE, Distribution, pivot
from softdyn.validation.studies.sweep import HORIZON_SHARE, Sweep, parameter
from softdyn.validation.studies.sweep_report import label

TITLES = {HORIZON_SHARE: "τ / ε", "gains.horizon": "τ", "plant.period": "period"}
IN_MS = ("gains.horizon", "plant.period", "signals.delay", "signals.lag")


def cells(sweep: Sweep) -> dict[str, Case]:
    """Every case by its label ``row/…/target``, row by row.

    Raises
    ------
    InputError
        Two cases that the rows do not tell apart.
    """
    return {name: case for name, (case, _) in _labelled(sweep).items()}


def _labelled(sweep: Sweep) -> dict[str, tuple[Case, str]]:
    names, rows = _names(sweep), dict[str, dict[str, tuple[Case, str]]]()
    for case, change in sweep.changed_cases:
        row = rows.setdefault("/".join(_part(name, case, change) for name in names), {})
        column = cell_title(case.kind, case.value)
        if column in row:
            expected = "parameters that tell all cases apart"
            raise InputError(f"{sweep.path}: rows", expected, f"{case.name} beside another")
        row[column] = case, change
    return {
        f"{row}/{column}": both for row, found in rows.items() for column, both in found.items()
    }


def markdown(sweep: Sweep, found: Mapping[str, Distribution]) -> str:
    """One table or, with means over its rows, one of final errors and one of trajectories."""
    titles, asked = [TITLES.get(name) or label(name) for name in _names(sweep)], cells(sweep)
    groups = [(found, "")]
    if sweep.means:
        tracking = {k: cell for k, cell in found.items() if asked[k].kind == "tracking"}
        others = {k: cell for k, cell in found.items() if k not in tracking}
        groups = [(others, "mean (cm)"), (tracking, "mean (cm²)")]
    parts = [pivot(group, titles, mean) for group, mean in groups if group]
    return "\n\n".join([*parts, *([NOTE] if any(cell.moves for cell in found.values()) else [])])


def failures(sweep: Sweep, found: Mapping[str, Distribution]) -> int:
    """How many cells failed from rest that must not."""
    return sum(
        found[name].failed.get("nominal", 0)
        for name, (_, change) in _labelled(sweep).items()
        if change in sweep.must_not_fail
    )


def _names(sweep: Sweep) -> list[str]:
    """The parameters in a row's label: the file's, or all that differ between cases."""
    if sweep.rows:
        return [*sweep.rows]
    varying = [axis.name for axis in sweep.varying()]
    periods = ["plant.period"] if sweep.shorter_periods and "plant.period" not in varying else []
    changes = ["change"] if len(sweep.changes) > 1 else []
    samples = ["sample"] if sweep.samples else []
    return ["robot", "controller", *periods, *varying, *changes, *samples]


def _part(name: str, case: Case, change: str) -> str:
    if name == "change":
        return change
    if name in ("robot", "controller", "sample"):
        return safe_filename(str(getattr(case, name)))
    value: Any = parameter(case, name)
    if isinstance(value, float):
        return f"{1e3 * value:g} ms" if name in IN_MS else f"{value:g}"
    return safe_filename(str(value))
