#!/usr/bin/env python3
"""Tune the schedule of `best` for a robot, on set points and rates that the paper does not have."""

from __future__ import annotations

from typing import Any

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48). CMA-ES in the logarithms of the gains and
the horizon of a stage: first of the approach, on the first second of runs, then of the stay, on
whole runs. Set points at theta = 0.25, 0.75, 1.25 and 1.75 pi, trajectories at 0.12, 0.17, 0.25
and 0.45 pi rad/s. The start and the best of the search then meet on 28 other set points and 9
trajectories, which decide. None of all these is in the paper. The start is --gains, a schedule as
those in controllers/schedules/, by default the robot's own, or else the published gains in both
stages. --again repeats a search from its summary, as those in docs/tuning/.

--out gets the schedule found (TOML), --summary the settings, each stage's winner and the finals
(JSON), --trace every candidate with its scores (JSON), after every generation anew. Needs the
extra: pip install 'softdyn[tune]'.

exit codes: 0 done; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
what = parser.add_mutually_exclusive_group(required=True)
what.add_argument("robot", metavar="ROBOT", nargs="?")
what.add_argument("--again", metavar="FILE", help="all settings from a summary (JSON)")
parser.add_argument("--gains", metavar="FILE", help="the schedule to start from, TOML")
for stage, generations in (("approach", 10), ("stay", 8)):
    parser.add_argument(
        f"--{stage}", type=int, default=generations, metavar="N",
        help=f"generations of the {stage}, 0 to keep it (default: {generations})",
    )  # fmt: skip
parser.add_argument(
    "--finalists", type=cli.count, default=6, metavar="N",
    help="how many meet at the end, the start included (default: 6)",
)  # fmt: skip
parser.add_argument("--population", type=cli.count, default=10, metavar="N")
parser.add_argument("--seed", type=cli.count, default=1, metavar="S", help="> 0")
parser.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")
parser.add_argument("--out", default="schedule.toml", metavar="FILE")
parser.add_argument("--summary", default="tuning.json", metavar="FILE")
parser.add_argument("--trace", metavar="FILE", help="default: none")


def command(arguments: cli.Arguments) -> int:
    """Search, write the trace as it grows, the schedule and the summary at the end."""
    from softdyn.validation.files import write_json, write_text
    from softdyn.validation.studies import tuning

    cli.check_outputs(arguments.out, arguments.summary, arguments.trace)
    if arguments.again:
        wanted = tuning.read(arguments.again)
    else:
        table = cli.read_toml(arguments.gains) if arguments.gains else None
        wanted = tuning.Search(
            arguments.robot,
            tuning.first_schedule(arguments.robot, table),
            {stage: getattr(arguments, stage) for stage in tuning.STAGES},
            arguments.population,
            arguments.finalists,
            arguments.seed,
        )
    trace: list[dict[str, Any]] = []

    def keep(entry: dict[str, Any]) -> None:
        trace.append(entry)
        write_json(arguments.trace, {"settings": vars(wanted), "trace": trace})

    found = tuning.search(wanted, arguments.jobs or -1, keep if arguments.trace else None)
    write_text(arguments.out, tuning.toml(found.pop("schedule")))
    write_json(arguments.summary, found)
    cli.say(tuning.text(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
