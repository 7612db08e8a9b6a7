"""Write the tables of the documents from the committed figures."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

EPILOG = """\
A table lies between <!-- table NAME: written by tests/proof/tables.py --> and
<!-- end of NAME -->. Its figures are in tests/proof/documents/measured, those of the paper's table
in validation/studies/measured. The documents name the commands that made them.

exit codes: 0 all tables are as they should be, or are written; 1 with --check, some are not;
2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("documents", nargs="*", metavar="FILE", help="default: docs/*.md")
parser.add_argument("--check", action="store_true", help="write nothing")


def command(arguments: cli.Arguments) -> int:
    """Fill in, say which changed."""
    from tests.proof.documents import tables as documents

    paths = [Path(name) for name in arguments.documents] or sorted(Path("docs").glob("*.md"))
    stale = documents.write(paths, arguments.check)
    for path in stale:
        print(path)
    return cli.FAILED if stale and arguments.check else cli.PASSED


main = cli.program(parser, command, __name__)
