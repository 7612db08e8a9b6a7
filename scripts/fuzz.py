#!/usr/bin/env python3
"""Fuzzing: thousands of damaged files, each loaded in a process that may die of it."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

CORPUS = Path(__file__).resolve().parents[1] / "tests" / "corpus"

EPILOG = """\
Each input is a file of the corpus after a few random changes (validation/fuzzing/inputs.py), wholly
determined by --seed and its number. It is loaded as a user's file would be, in a process of its
own that is killed after 5 s of processor time. A finding is

  crash            the process died
  hang             it took longer than 5 s
  exception        anything but a softdyn error, or terms that are not finite at rest
  message          an error that is not one line, or names no file
  lost content     accepted, but a second reading of the file by another parser says otherwise
  engines differ   accepted, but MuJoCo computes another robot (one input in three is asked)

--data damages logs, a store's results, a tuning's summary, a sweep and a schedule instead, and
reads them as their commands do; lost content is then what the reader accepted and json, tomllib or
numpy.load find to be something else (validation/fuzzing/data.py).

Inputs behind findings are written to --out.

exit codes: 0 no finding; 1 some; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.option("--count", cli.count, "N", "inputs", 1000)
parser.add_argument("--seed", type=int, default=0, metavar="S", help="(default: 0)")
parser.add_argument("--first", type=int, default=0, metavar="I", help="number of the first one")
parser.add_argument(
    "--corpus", type=Path, default=CORPUS, metavar="DIR", help="where base files are"
)
parser.add_argument("--out", type=Path, metavar="DIR", help="folder for inputs with a finding")
parser.add_argument(
    "--data", action="store_true", help="logs, stores and TOML instead of robot files"
)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Fuzz, count, report."""
    from tqdm import tqdm

    from softdyn.validation.fuzzing import campaign, data

    if arguments.out is not None:
        cli.make_folder(arguments.out)
    bases = data.kinds() if arguments.data else campaign.base_files(arguments.corpus)
    judge = (data.work, data.kept) if arguments.data else (campaign.work, campaign.robot_file)
    numbers = range(arguments.first, arguments.first + arguments.count)
    with tqdm(total=len(numbers), disable=None, leave=False, unit="file") as bar:
        report = campaign.campaign(
            bases, arguments.seed, numbers, arguments.out, bar.update, *judge
        )
    cli.write_report(report, arguments.json, campaign.summary(report))
    return cli.FAILED if report["inputs_with_findings"] else cli.PASSED


main = cli.program(parser, command, __name__)
