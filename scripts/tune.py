#!/usr/bin/env python3
"""Tune the schedule of `best` for a robot, on targets that its test does not have."""

from __future__ import annotations

from typing import Any

from softdyn.commands import cli

EPILOG = """\
ROBOT is a path to an annotated URDF, the name of a robot of example-robot-data with --annotations,
or a bundled name (finger, helix, spirob, spirob48).

Of anyone's robot the statics find targets that it can rest at and paths that it can follow. Gains
are drawn at random and then searched by CMA-ES; the best few meet on other targets, and the winner
is tested against mpc on others still, on fewer where the time is short. The answer comes in about
--seconds, statics included; on top come a first use's compilation and the runs under way at the
end; the least is two runs of mpc, four candidates, two of the winner. If it beats mpc it is written
beside the file (my.urdf: my.schedule.toml, or beside the annotations), where `best` finds it as
long as the robot's dynamics do not change; if not, nothing is written, and `best` stays mpc.
--gains is a schedule to begin with besides.

A bundled robot: CMA-ES in the logarithms of the gains and the horizon of a stage: first of the
approach, on the first second of runs, then of the stay, on whole runs. Set points at theta = 0.25,
0.75, 1.25 and 1.75 pi, trajectories at 0.12, 0.17, 0.25 and 0.45 pi rad/s. The start and the best
of the search then meet on 28 other set points and 9 trajectories, which decide. None of all these
is in the paper. The start is --gains, a schedule as those in controllers/schedules/, by default the
robot's own, or else the published gains in both stages. --again repeats a search from its summary,
as those in docs/tuning/. --summary gets the settings, each stage's winner and the finals (JSON),
--trace every candidate with its scores (JSON), after every generation anew.

Needs the extra: pip install 'softdyn[tune]'.

exit codes: 0 done; 1 the schedule does not beat mpc; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
what = parser.add_mutually_exclusive_group(required=True)
what.add_argument("robot", metavar="ROBOT", nargs="?")
what.add_argument("--again", metavar="FILE", help="all settings from a summary (JSON)")
parser.add_argument(
    "--annotations", metavar="FILE", help="a <softdyn> block for a URDF that has none"
)
parser.option("--seconds", cli.positive, "S", "until the answer for anyone's robot", 300.0)
parser.add_argument("--gains", metavar="FILE", help="the schedule to start from, TOML")
for stage, generations in (("approach", 10), ("stay", 8)):
    parser.add_argument(
        f"--{stage}", type=int, default=generations, metavar="N",
        help=f"bundled: generations of the {stage}, 0 to keep it (default: {generations})",
    )  # fmt: skip
parser.add_argument(
    "--finalists", type=cli.count, default=6, metavar="N",
    help="bundled: how many meet at the end, the start included (default: 6)",
)  # fmt: skip
parser.option("--population", cli.count, "N", "bundled: candidates a generation", 10)
parser.add_argument("--seed", type=cli.count, default=1, metavar="S", help="> 0")
parser.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")
parser.add_argument(
    "--out", metavar="FILE", help="default: beside the robot's file; bundled: schedule.toml"
)
parser.add_argument("--summary", metavar="FILE", help="default: none; bundled: tuning.json")
parser.add_argument("--trace", metavar="FILE", help="bundled; default: none")


def command(arguments: cli.Arguments) -> int:
    """Tune a bundled robot on the paper's ellipse, any other one on what its statics find."""
    import softdyn

    if arguments.again is None and arguments.robot not in softdyn.bundled_names():
        return tune_own(arguments)
    return tune_bundled(arguments)


def tune_own(arguments: cli.Arguments) -> int:
    """Find targets, search, test, write what is better."""
    from time import monotonic

    from softdyn.controllers.registry import make_controller
    from softdyn.controllers.schedule import schedule_path
    from softdyn.validation.files import write_json, write_text
    from softdyn.validation.studies.engine.sources import load_model
    from softdyn.validation.studies.own import tuning as own_tuning
    from softdyn.validation.studies.own.tasks import find_tasks

    model = load_model(arguments.robot, arguments.annotations)
    if model.nu:  # what a first use compiles is not in the time: every law compiles when it is made
        make_controller("mpc", model)
        make_controller("soft-id-clf-qp", model, {"Kp": 100.0, "eps": 0.05, "horizon": 0.05})
    began = monotonic()
    out = arguments.out or str(schedule_path(model))
    cli.check_outputs(out, arguments.summary)
    start = cli.read_toml(arguments.gains) if arguments.gains else None
    with cli.share_bar("statics") as tell:
        tasks = find_tasks(arguments.robot, arguments.annotations, model, arguments.seed)
        found = own_tuning.search(
            tasks, arguments.seconds, began=began, start=start, seed=arguments.seed,
            jobs=arguments.jobs or -1, tell=tell,
        )  # fmt: skip
    text = own_tuning.text(tasks, found)
    if arguments.summary is not None:
        write_json(arguments.summary, {"robot": model.name, **found})
    if found["better"]:
        write_text(out, own_tuning.for_robot(tasks, found["schedule"], text))
    cli.say(f"{text}{f': {out}' if found['better'] else ''}")
    return cli.PASSED if found["better"] else cli.FAILED


def tune_bundled(arguments: cli.Arguments) -> int:
    """Search, write the trace as it grows, the schedule and the summary at the end."""
    from softdyn.validation.files import write_json, write_text
    from softdyn.validation.studies import tuning

    out, summary = arguments.out or "schedule.toml", arguments.summary or "tuning.json"
    cli.check_outputs(out, summary, arguments.trace)
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
    write_text(out, tuning.toml(found.pop("schedule")))
    write_json(summary, found)
    cli.say(tuning.text(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
