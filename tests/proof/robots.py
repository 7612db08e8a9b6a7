"""Cross-check many robots: all of example-robot-data, or random ones."""

from __future__ import annotations

from softdyn.commands import cli

COMMAND = "python -m tests.proof robots"
EPILOG = """\
Every URDF of example-robot-data is cross-checked (with --repair-inertia and --floating also
repaired and floating), or N random robots of the seeds from --seed on. A row a robot is printed; a
robot that is not supported is no failure. With --force each of the N random robots has one kind of
force, and the derivatives of its acceleration stand against differences of MuJoCo's, too.

exit codes: 0 everything agrees; 1 something differs; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--random", type=cli.count, metavar="N", help="N random robots instead")
parser.add_argument(
    "--force", choices=("fluid", "buoyancy", "joints", "tendons", "wrench"),
    help="with this force; joints and tendons have springs and dampers that are not linear",
)  # fmt: skip
parser.add_argument("--floating", action="store_true", help="floating ones besides")
parser.add_argument("--repair-inertia", action="store_true", help="repaired ones besides")
parser.add_argument("--states-only", action="store_true", help="random states, and no trajectories")
parser.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: all cores)")
parser.output("--markdown", "FILE", "write the rows as a document")
parser.option("--samples", cli.count, "N", "random states", 20)
parser.option("--seed", cli.whole, "S", "of the random states", 0)
cli.add_json(parser)
parser.unused("--floating --repair-inertia --markdown", lambda a: a.force, "only without --force")


def command(arguments: cli.Arguments) -> int:
    """Cross-check, report how many there are of each kind."""
    from softdyn.validation.files import write_text
    from tests.proof.crosschecks import batch

    common = (arguments.samples, arguments.seed)
    options = {"floating": arguments.floating, "trajectories": not arguments.states_only}
    if arguments.force is not None:
        count = arguments.random or 100
        jobs = batch.forced_jobs(
            arguments.force, count, *common, trajectories=options["trajectories"]
        )
    elif arguments.random is None:
        repair = arguments.repair_inertia
        jobs = batch.catalogue_jobs(*common, **options, repair_inertia=repair)
    else:
        jobs = batch.random_jobs(arguments.random, *common, **options)
    survey = batch.survey(jobs, arguments.jobs or -1)
    if arguments.markdown is not None:
        given = [" --repair-inertia"] * arguments.repair_inertia
        given += [" --floating"] * arguments.floating
        write_text(arguments.markdown, survey.document("".join([COMMAND, *given])))
    # of random robots only those with problems
    few = arguments.random is None and arguments.force is None
    shown = [row for row in survey.rows if few or not row.passed]
    report = {"samples": arguments.samples, "seed": arguments.seed, **survey.to_dict()}
    cli.write_report(report, arguments.json, survey.text_of(shown))
    return cli.PASSED if survey.passed else cli.FAILED


main = cli.program(parser, command, __name__)
