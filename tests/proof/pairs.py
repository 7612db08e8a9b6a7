"""Compare URDFs of example-robot-data with public MJCFs of the same robots, a row per pair."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
DIR holds checkouts of public repositories; the MJCFs that are found there are compared.

exit codes: 0 all files agree; 1 some differ; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("folders", nargs="+", metavar="DIR")
parser.option("--samples", cli.count, "N", "random states", 8)
parser.option("--seed", cli.whole, "S", "of the random states", 0)
parser.output("--markdown", "FILE", "write the rows as a document")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Compare, report."""
    from softdyn.validation.files import write_text
    from tests.proof.mjcf import public_pairs

    survey = public_pairs.survey(arguments.folders, arguments.samples, arguments.seed)
    if arguments.markdown is not None:
        write_text(arguments.markdown, survey.document())
    cli.write_report(survey.to_dict(), arguments.json, str(survey))
    return cli.PASSED if survey.passed else cli.FAILED


main = cli.program(parser, command, __name__)
