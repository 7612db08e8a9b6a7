"""The tables of public reports, from the rows that tests/test_public_reports.py runs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from softdyn.validation.tables import Table
from tests.support.public_reports import Report


def reports_table(reports: Iterable[Report]) -> str:
    """A row a report: source, fault, command with its exit code, answer, right value."""
    reports = tuple(reports)
    titles = ["source"] * any(report.sources for report in reports)
    lines = [[*_sources(report), *_cells(report)] for report in reports]
    columns = ["reported", "command", "exit code", "softdyn", "right value"]
    return Table([*titles, *columns], lines).markdown()


def _cells(report: Report) -> list[Any]:
    values = "; ".join(f"{label}: {_text(right)}" for label, _, right in report.values)
    answer = f"{report.does}: “{report.says[0]}”" if report.says else report.does
    return [report.reported, f"`softdyn {report.command}`", report.code, answer, values or "-"]


def _sources(report: Report) -> list[str]:
    links = []
    for source in report.sources:
        project, number, count = source.partition("#")
        link = f"[{source}](https://github.com/{project}/issues/{count})"
        links.append(link if number else source)
    return [", ".join(links)] if links else []


def _text(value: Any) -> str:
    """A number with six digits, a matrix row by row."""
    if isinstance(value, list):
        rows = any(isinstance(row, list) for row in value)
        return ("; " if rows else ", ").join(map(_text, value))
    return value if isinstance(value, str) else f"{value:.6g}"
