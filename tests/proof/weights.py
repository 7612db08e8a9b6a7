"""The size of each package that a plain installation brings: docs/installation.md."""

from __future__ import annotations

from importlib import metadata
from typing import Any

from softdyn.commands import cli

EPILOG = """\
The packages are those that softdyn needs without any extra, as this environment has them. The sizes
go to tests/proof/documents/measured/weights.json; then `python -m tests.proof tables` writes the
table.

exit codes: 0 done; 2 bad input.
"""
SMALL = 10.0  # MB: smaller packages share one row
COLUMNS = (("package", "package", ""), ("version", "version", ""), ("MB", "megabytes", ".0f"),
           ("needed by", "needed_by", ""))  # fmt: skip

parser = cli.Parser(__doc__, EPILOG)


def command(_arguments: cli.Arguments) -> int:
    """Measure, write."""
    from softdyn.validation.files import write_json
    from tests.proof.documents.settings import MEASURED

    rows = sorted(packages().values(), key=lambda row: -row["megabytes"])
    large = [row for row in rows if row["megabytes"] >= SMALL]
    small = rows[len(large) :]
    for name, several in ((f"{len(small)} smaller ones", small), ("all", rows)):
        size = sum(row["megabytes"] for row in several)
        large.append({"package": name, "version": "", "megabytes": size, "needed_by": ""})
    write_json(MEASURED / "weights.json", {"rows": large})
    return cli.PASSED


def packages(name: str = "softdyn") -> dict[str, dict[str, Any]]:
    """A row for each installed package that `name` needs, by its name; it is the first."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    rows: dict[str, dict[str, Any]] = {}
    todo = [(name, "")]
    for wanted, needed_by in todo:  # it grows
        key = canonicalize_name(wanted)
        if key in rows:
            continue
        found = metadata.distribution(key)
        size = sum(file.size or 0 for file in found.files or ())
        rows[key] = {
            "package": key, "version": found.version, "megabytes": size / 1e6,
            "needed_by": needed_by,
        }  # fmt: skip
        needs = [Requirement(text) for text in found.requires or ()]
        todo += [(r.name, key) for r in needs if not r.marker or r.marker.evaluate({"extra": ""})]
    return rows


main = cli.program(parser, command, __name__)
