"""Public reports about other tools, tried with softdyn: each row of docs/public_reports.md."""

import re
import shlex

import pytest

from tests.support import ROOT
from tests.support.command import command
from tests.support.public_reports import BESIDE, MENDED, REPORTS, RIGHT, Report


def names(reports):
    return [report.name for report in reports]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("report", REPORTS, ids=names(REPORTS))
def test_a_report_comes_out_right(report: Report, tmp_path):
    for name, content in report.files.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    code, out, err = command(*shlex.split(report.command), cwd=tmp_path)
    assert code == report.code, out + err
    for words in report.says:
        assert words in out + err
    if code == 2:
        assert (out, err.count("\n")) == ("", 1)
    for label, measure, right in report.values:
        found = measure(tmp_path)
        if isinstance(right, str):
            assert found == right, label
        else:
            bound = {"rel": report.tolerance, "abs": 0.0 if right else report.tolerance}
            assert found == close(right, **bound), label


def close(right, **bound):
    """Nested lists of numbers, each within the bounds."""
    if isinstance(right, list) and any(isinstance(row, list) for row in right):
        return [close(row, **bound) for row in right]
    return pytest.approx(right, **bound)


def test_every_report_is_one_row_with_its_source():
    assert len(set(names(REPORTS))) == len(REPORTS)
    sources = [source for report in (*RIGHT, *MENDED) for source in report.sources]
    assert len(set(sources)) == len(sources)
    assert all(report.sources for report in (*RIGHT, *MENDED))
    assert all(report.says or report.values for report in REPORTS)
    page = (ROOT / "docs/public_reports.md").read_text("utf-8")
    for report in REPORTS:
        assert page.count(f"`softdyn {report.command}`") == 1, report.name
    for source in sources:
        assert re.search(rf"\[?{re.escape(source)}\b", page), source
    assert not any(report.sources for report in BESIDE)
