#!/usr/bin/env python3
"""Pinocchio against MuJoCo: the same robot in two engines, quantity by quantity and along time."""

from __future__ import annotations

import sys

from softdyn.commands import cli

COMMAND = "scripts/crosscheck.py --catalogue"
EPILOG = """\
Instead of one ROBOT, --catalogue takes every URDF of example-robot-data (with --repair-inertia and
--floating also repaired and floating), and --random N takes N random robots of the seeds from
--seed on. They print a row a robot; a robot that is not supported is no failure.

ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

At random states inside the limits each quantity is computed by both engines, and
error = max|a - b| / max(|a|, |b|, scale). Limits, contacts and dry friction are off.

exit codes: 0 everything agrees; 1 something differs; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
which = parser.add_mutually_exclusive_group(required=True)
which.add_argument("robot", metavar="ROBOT", nargs="?")
which.add_argument(
    "--catalogue", action="store_true", help="every URDF of example-robot-data, one row each"
)
which.add_argument("--random", type=cli.count, metavar="N", help="N random robots")
cli.add_robot_options(parser)
parser.add_argument("--states-only", action="store_true", help="random states, and no trajectories")
parser.add_argument(
    "--jobs", type=cli.count, metavar="N", help="processes for many robots (default: all cores)"
)
parser.add_argument(
    "--markdown", metavar="FILE", help="write the rows of --catalogue as a document"
)
parser.option("--samples", cli.count, "N", "random states", 20)
parser.option("--seed", cli.whole, "S", "of the random states", 0)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Load, compare, report."""
    from softdyn.validation import Twin, crosscheck

    cli.check_outputs(
        arguments.json, arguments.markdown, inputs=(arguments.robot, arguments.annotations)
    )
    if arguments.robot is None:
        return many(arguments)
    model = cli.load_robot(arguments)
    show = sys.stderr.isatty()
    result = crosscheck(
        model,
        Twin(model, limits=False),
        samples=arguments.samples,
        seed=arguments.seed,
        trajectories=not arguments.states_only,
        progress=say if show else None,
    )
    if show:
        say("")
    cli.write_report(result.to_dict(), arguments.json, str(result))
    return cli.PASSED if result.passed else cli.FAILED


def many(arguments: cli.Arguments) -> int:
    """One row a robot, and how many there are of each kind."""
    from softdyn import InputError
    from softdyn.validation.crosschecks import batch
    from softdyn.validation.files import write_text

    if arguments.annotations is not None:
        raise InputError("--annotations", "one ROBOT", "many robots")
    common = (arguments.samples, arguments.seed)
    options = {"floating": arguments.floating, "trajectories": not arguments.states_only}
    if arguments.catalogue:
        repair = arguments.repair_inertia
        jobs = batch.catalogue_jobs(*common, **options, repair_inertia=repair)
    else:
        jobs = batch.random_jobs(arguments.random, *common, **options)
    survey = batch.survey(jobs, arguments.jobs or -1)
    if arguments.markdown is not None:
        given = [" --repair-inertia"] * arguments.repair_inertia
        given += [" --floating"] * arguments.floating
        write_text(arguments.markdown, survey.document("".join([COMMAND, *given])))
    # of random robots only those worth a look
    shown = [row for row in survey.rows if arguments.catalogue or not row.passed]
    report = {"samples": arguments.samples, "seed": arguments.seed, **survey.to_dict()}
    cli.write_report(report, arguments.json, survey.text_of(shown))
    return cli.PASSED if survey.passed else cli.FAILED


def say(text: str) -> None:
    """Replace the progress line on stderr."""
    print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


main = cli.program(parser, command, __name__)
