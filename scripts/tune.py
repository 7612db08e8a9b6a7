#!/usr/bin/env python3
"""Tune the schedule of `best` for a robot; its test has other targets than the search."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from softdyn.commands import cli

EPILOG = """\
ROBOT is a path to an annotated URDF, the name of a robot of example-robot-data with --annotations,
or a bundled name (finger, helix, spirob, spirob48).

A robot of your own: statics finds equilibria and paths that it can follow. Gains are drawn at
random and then searched by CMA-ES. The best few are compared on other targets. The winner is tested
against mpc on a third set of targets, or on a part of it if time is short. The answer comes after
about --seconds, statics included, plus the compilation of a first use and the runs in progress at
the end. Two runs of mpc, four candidates and their test are made in any case. A winner that beats
mpc is written beside the file (my.urdf: my.schedule.toml, or beside the annotations). best uses it
as long as the robot's dynamics do not change. Otherwise nothing is written, and best stays mpc.
--gains adds a schedule to the start of the search.

A bundled robot: CMA-ES searches the approach on the first second of runs, then the stay on complete
runs, with set points at theta = 0.25, 0.75, 1.25 and 1.75 pi and trajectories at 0.12, 0.17, 0.25
and 0.45 pi rad/s. Then 28 other set points and 9 trajectories decide between the start and the best
candidates. None of all these is the paper's. The start is --gains, else the robot's own schedule,
else its published gains in both stages. --again repeats a search from its summary, as those in
docs/tuning/. --summary receives the settings, each stage's winner and the finals (JSON). --trace
receives every candidate with its scores (JSON), updated after every generation.

Needs the package cma (the extra softdyn[tune]): pip install cma.

exit codes: 0 done; 1 the schedule does not beat mpc; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
what = parser.add_mutually_exclusive_group(required=True)
what.add_argument("robot", metavar="ROBOT", nargs="?")
what.add_argument("--again", metavar="FILE", help="all settings from a summary (JSON)")
parser.add_argument(
    "--annotations", metavar="FILE", help="a <softdyn> block for a URDF that has none"
)
parser.option("--seconds", cli.positive, "S", "own robot: time until the answer", 300.0)
parser.add_argument("--gains", metavar="FILE", help="the schedule to start from, TOML")
parser.option("--approach", int, "N", "bundled: generations of the approach, 0 to keep it", 10)
parser.option("--stay", int, "N", "bundled: generations of the stay, 0 to keep it", 8)
parser.option("--finalists", cli.count, "N", "bundled: candidates in the finals, with the start", 6)
parser.option("--population", cli.count, "N", "bundled: candidates per generation", 10)
parser.option("--seed", cli.count, "S", "> 0", 1)
parser.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")
parser.output("--out", "FILE", "default: beside the robot's file; bundled: schedule.toml")
parser.output("--summary", "FILE", "default: none; bundled: tuning.json")
parser.output("--trace", "FILE", "bundled; default: none")


def command(arguments: cli.Arguments) -> int:
    """Tune a bundled robot on the paper's ellipse, another one on targets that its statics find."""
    import softdyn
    from softdyn.controllers.schedule import read_schedule
    from softdyn.validation.studies.schedule_search import schedule_tables

    start = schedule_tables(read_schedule(arguments.gains)) if arguments.gains else None
    bundled = arguments.again is not None or arguments.robot in softdyn.bundled_names()
    return (tune_bundled if bundled else tune_own)(arguments, start)


def tune_own(arguments: cli.Arguments, start: dict[str, Any] | None) -> int:
    """Find targets, search, test, and write a schedule that is better."""
    from time import monotonic

    from softdyn.controllers.registry import make_controller
    from softdyn.controllers.schedule import schedule_path
    from softdyn.validation.files import write_json, write_text
    from softdyn.validation.studies import tuning
    from softdyn.validation.studies.engine.sources import load_model
    from softdyn.validation.studies.tuning_targets import find_targets

    model = load_model(arguments.robot, arguments.annotations)
    if model.nu:  # this compiles the kernels, which is not a part of the time
        make_controller("mpc", model)
        make_controller("soft-id-clf-qp", model, {"Kp": 100.0, "eps": 0.05, "horizon": 0.05})
    began = monotonic()
    out = arguments.out or str(schedule_path(model))
    if arguments.out is None:
        cli.check_outputs(parser, arguments, out)
    with share_bar("statics") as tell:
        targets = find_targets(arguments.robot, arguments.annotations, model, arguments.seed)
        found = tuning.tune_schedule(
            targets, arguments.seconds, began=began, start=start, seed=arguments.seed,
            jobs=arguments.jobs or -1, tell=tell,
        )  # fmt: skip
    text = tuning.tuning_text(targets, found)
    if arguments.summary is not None:
        write_json(arguments.summary, {"robot": model.name, **found})
    if found["better"]:
        write_text(out, tuning.robot_schedule_toml(targets, found["schedule"], text))
    cli.say(f"{text}{f': {out}' if found['better'] else ''}")
    return cli.PASSED if found["better"] else cli.FAILED


@contextmanager
def share_bar(first: str) -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal for work of a known time: the current step, and the share of the time."""
    from tqdm import tqdm

    layout = "{desc} |{bar}| {percentage:3.0f} % [{elapsed}]"
    with tqdm(total=1.0, desc=first, disable=None, leave=False, bar_format=layout) as bar:

        def tell(text: str, share: float) -> None:
            bar.set_description_str(text, refresh=False)
            bar.update(min(share, 1.0) - bar.n)

        yield tell


def tune_bundled(arguments: cli.Arguments, start: dict[str, Any] | None) -> int:
    """Search, write the trace as it grows, the schedule and the summary at the end."""
    from softdyn.validation.files import write_json, write_text
    from softdyn.validation.studies import paper_tuning, schedule_search

    out, summary = arguments.out or "schedule.toml", arguments.summary or "tuning.json"
    new = [path for path in (out, summary) if path not in (arguments.out, arguments.summary)]
    cli.check_outputs(parser, arguments, *new)
    if arguments.again:
        wanted = paper_tuning.read_search(arguments.again)
    else:
        wanted = paper_tuning.Search(
            arguments.robot,
            start or paper_tuning.first_schedule(arguments.robot),
            {stage: getattr(arguments, stage) for stage in schedule_search.STAGES},
            arguments.population,
            arguments.finalists,
            arguments.seed,
        )
    trace: list[dict[str, Any]] = []

    def keep(entry: dict[str, Any]) -> None:
        trace.append(entry)
        if arguments.trace:
            write_json(arguments.trace, {"settings": vars(wanted), "trace": trace})

    found = paper_tuning.search_schedule(wanted, arguments.jobs or -1, keep)
    write_text(out, schedule_search.schedule_toml(found.pop("schedule")))
    write_json(summary, found)
    cli.say(paper_tuning.search_text(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
