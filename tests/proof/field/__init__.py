"""Compare with published rollouts of other codes: the tables and figures of docs/field.md.

- `published`: the data of the others, read from a fetched folder
- `cases`: the four rods, as our arms and as the others' numbers
- `rods`: our rollouts: distances to the published tips, convergence
- `drag`: our rod with PyElastica's external damping; PyElastica's rod
- `peers`: the others' programs, run and timed in an environment of their own
- `pyelastica_rod`, `soromox_rod`, `soromox_newest`: programs for that environment
- `newest`: the newest versions of the others, beside ours with their step
- `tentacle`: a real arm's poses, identified
- `page`: tables, figures, the blocks of docs/field.md
"""

from __future__ import annotations

from softdyn import InputError
from softdyn.commands import cli

EPILOG = """\
FOLDER is a checkout of github.com/tud-phi/soromox (MIT). --peers PYTHON is the interpreter of an
environment with pyelastica 0.3.3 and soromox 0.2.3; it times their programs beside ours. The case
newest needs an environment with pyelastica 1.0 and soromox 0.5 instead.
--write FILE replaces the case's block in a document, and draws its figure beside it.

exit codes: 0 done; 2 bad input.
"""

CASES = ("rod", "planar", "spatial", "linear", "tentacle", "newest")

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("case", choices=CASES, help="the published rollout")
parser.add_argument("--data", required=True, metavar="FOLDER", help="the published data")
parser.add_argument("--peers", metavar="PYTHON", help="interpreter with the other codes")
parser.option("--runs", cli.count, "N", "timed runs of each code", 5)
parser.option("--seconds", cli.positive, "T", "length of a timed run in s", 0.3)
parser.output("--write", "FILE", "the document, docs/field.md")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure, report, write."""
    from tests.proof.field import cases, newest, page, peers, published, rods, tentacle

    if arguments.case == "tentacle":
        return tentacle.command(arguments)
    if arguments.case == "newest":
        if arguments.peers is None:
            raise InputError("--peers", "an interpreter with pyelastica and soromox", "none")
        return newest.command(arguments)
    case = cases.CASES[arguments.case]
    tips = published.read(arguments.data, case)
    found = rods.measure(case, tips)
    if arguments.peers is not None:
        found["theirs"] |= peers.refined(case, arguments.peers)
        found |= peers.times(
            case, arguments.peers, arguments.data, arguments.runs, arguments.seconds
        )
    text = page.tables(found)
    if arguments.write is not None:
        page.write(arguments.write, arguments.case, text, tips, found)
    cli.write_report(page.plain(found), arguments.json, text)
    return cli.PASSED


main = cli.program(parser, command, __name__)
