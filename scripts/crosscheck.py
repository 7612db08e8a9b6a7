#!/usr/bin/env python3
"""Pinocchio against MuJoCo: the same robot in two engines, quantity by quantity and along time."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn.validation.crosschecks.batch import Row
    from softdyn.validation.crosschecks.crosscheck import CrossCheck

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
parser.add_argument(
    "--samples", type=cli.count, default=20, metavar="N", help="random states (default: 20)"
)
parser.add_argument(
    "--seed", type=cli.whole, default=0, metavar="S", help="of the random states (default: 0)"
)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Load, compare, report."""
    from softdyn.validation import Twin, crosscheck

    cli.check_outputs(arguments.json, arguments.markdown)
    if arguments.robot is None:
        return many(arguments)
    model = cli.load_robot(arguments)
    twin = Twin(model, limits=False)
    show = sys.stderr.isatty()
    result = crosscheck(
        model,
        twin,
        samples=arguments.samples,
        seed=arguments.seed,
        trajectories=not arguments.states_only,
        progress=say if show else None,
    )
    if show:
        say("")
    cli.write_report(result.to_dict(), arguments.json, summary(result))
    return cli.PASSED if result.passed else cli.FAILED


def many(arguments: cli.Arguments) -> int:
    """One row a robot, and how many there are of each kind."""
    from tqdm import tqdm

    from softdyn import InputError
    from softdyn.validation.crosschecks import batch as catalogue
    from softdyn.validation.files import write_text

    if arguments.annotations is not None:
        raise InputError("--annotations", "one ROBOT", "many robots")
    common = (arguments.samples, arguments.seed)
    options = {"floating": arguments.floating, "trajectories": not arguments.states_only}
    if arguments.catalogue:
        repair = arguments.repair_inertia
        jobs = catalogue.catalogue_jobs(*common, **options, repair_inertia=repair)
    else:
        jobs = catalogue.random_jobs(arguments.random, *common, **options)
    rows: list[Row] = []
    with tqdm(total=len(jobs), disable=None, leave=False, unit="robot") as bar:
        for row in catalogue.examine_all(jobs, arguments.jobs or -1):
            rows += [] if row is None else [row]
            bar.update()
    rows = catalogue.in_order(jobs, rows)
    if arguments.markdown is not None:
        names = ("--repair-inertia", "--floating")
        given = [name for name in names if getattr(arguments, name[2:].replace("-", "_"))]
        command = " ".join(["scripts/crosscheck.py --catalogue", *given])
        write_text(arguments.markdown, catalogue.markdown(rows, command))
    failed = [row for row in rows if row.passed is False]
    report = {
        "samples": arguments.samples,
        "seed": arguments.seed,
        "passed": not failed,
        "counts": catalogue.counts(rows),
        "rows": [row.to_dict() for row in rows],
    }
    # of random robots only those worth a look
    shown = rows if arguments.catalogue else [row for row in rows if not row.passed]
    cli.write_report(report, arguments.json, catalogue.text(shown, catalogue.counts(rows)))
    return cli.FAILED if failed else cli.PASSED


def say(text: str) -> None:
    """Replace the progress line on stderr."""
    print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


def summary(result: CrossCheck) -> str:
    """The tables for people."""
    lines = [
        f"{result.robot}: {result.nv} degrees of freedom, {result.nu} inputs; "
        f"{result.samples} random states, seed {result.seed}",
        "",
        f"{'quantity':<12}{'max error':>10}{'tolerance':>11}  {'':<7}relative to at least",
    ]
    for check in result.checks:
        verdict = "ok" if check.passed else "FAILED"
        lines.append(
            f"{check.quantity:<12}{check.max_error:>10.1e}{check.tolerance:>11.0e}  "
            f"{verdict:<7}{check.scale}"
        )
        if check.reason:
            lines.append(f"{'':<12}{check.reason}")
    if result.runs:
        lines += ["", f"{'trajectory':<12}{'scheme':<10}{'step s':>9}{'length s':>10}{'error':>10}"]
    for run in result.runs:
        lines.append(
            f"{run.name:<12}{run.scheme:<10}{run.step:>9.2g}{run.duration:>10.3g}"
            f"{run.max_error:>10.1e}  {run.why}"
        )
    for ladder in result.ladders:
        lines += [
            "",
            f"step halving, {ladder.scheme} over {ladder.duration:.2g} s, "
            f"expected order {ladder.expected_order}",
            f"{'':<4}{'step s':>9}{'engines differ':>16}{'from the limit':>16}{'order':>8}",
        ]
        for rung in ladder.rungs:
            order = "-" if rung.order is None else f"{rung.order:.2f}"
            lines.append(
                f"{'':<4}{rung.step:>9.2g}{rung.engine_error:>16.1e}"
                f"{rung.truncation_error:>16.1e}{order:>8}"
            )
    failed = ", ".join(result.failures)
    lines += ["", f"FAILED: {failed}" if failed else "the two engines agree"]
    return "\n".join(lines)


main = cli.program(parser, command, __name__)
