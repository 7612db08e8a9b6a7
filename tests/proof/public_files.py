"""Read public robot files, write each in the other format, and compare both in their engines."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
Each DIR holds checkouts of public repositories. Every URDF and MJCF with a body is read, with DIR
as --root. Files that only others include are left out.

An MJCF is exported as a URDF, and a URDF as an MJCF, which reads both again and compares them. Then
the URDF in Pinocchio is compared with the MJCF in MuJoCo at random states. A file passes if it is
refused, or if the export says that the files differ, or if the engines agree, too.

exit codes: 0 no export calls two files equal whose motion differs; 1 one does; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("folders", nargs="+", metavar="DIR")
parser.option("--samples", cli.count, "N", "random states", 3)
parser.option("--seed", cli.whole, "S", "of the random states", 0)
parser.output("--markdown", "FILE", "write the rows as a document")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Read all files, report."""
    from softdyn.validation.files import write_text
    from tests.proof.mjcf import foreign_files

    survey = foreign_files.survey(arguments.folders, arguments.samples, arguments.seed)
    if arguments.markdown is not None:
        write_text(arguments.markdown, survey.document())
    cli.write_report(survey.to_dict(), arguments.json, str(survey))
    return cli.PASSED if survey.passed else cli.FAILED


main = cli.program(parser, command, __name__)
