#!/usr/bin/env python3
"""Tune the schedule of `best` for a robot, on set points and rates that the paper does not have."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48). CMA-ES in the logarithms of the gains and
the horizon of a stage: first of the approach, on the first second of runs, then of the stay, on
whole runs. Set points at theta = 0.25, 0.75, 1.25 and 1.75 pi, trajectories at 0.12, 0.17, 0.25
and 0.45 pi rad/s. The start and the best of the search then meet on 28 other set points and 9
trajectories, which decide. None of all these is in the paper. The start is --gains, a schedule as
those in controllers/schedules/, by default the robot's own, or else the published gains in both
stages. --out gets the schedule found (TOML), --trace the seed and every candidate with its scores
(JSON), after every generation anew. Needs the extra: pip install 'softdyn[tune]'.

exit codes: 0 done; 2 bad input.
"""
TUNED = ("Kp", "eps", "w2", "w3", "w4", "null_damping", "rho", "hold", "u0")


def parser() -> cli.Parser:
    """The command line."""
    found = cli.Parser(description=__doc__, epilog=EPILOG)
    found.add_argument("robot", metavar="ROBOT")
    found.add_argument("--gains", metavar="FILE", help="the schedule to start from, TOML")
    for stage, generations in (("approach", 10), ("stay", 8)):
        found.add_argument(
            f"--{stage}", type=int, default=generations, metavar="N",
            help=f"generations of the {stage}, 0 to keep it (default: {generations})",
        )  # fmt: skip
    found.add_argument(
        "--finalists", type=cli.count, default=6, metavar="N",
        help="how many meet at the end, the start included (default: 6)",
    )  # fmt: skip
    found.add_argument("--population", type=cli.count, default=10, metavar="N")
    found.add_argument("--seed", type=cli.count, default=1, metavar="S", help="> 0")
    found.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")
    found.add_argument("--out", default="schedule.toml", metavar="FILE")
    found.add_argument("--trace", default="tuning.json", metavar="FILE")
    return found


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return cli.start(parser(), command, argv)


def command(arguments: argparse.Namespace) -> int:
    """Search for both stages, decide, write the trace as it grows and the schedule at the end."""
    from softdyn.validation.files import write_json, write_text
    from softdyn.validation.studies import tuning

    cli.check_outputs(arguments.out, arguments.trace)
    schedule = start(arguments.robot, arguments.gains)
    settings = {name: getattr(arguments, name) for name in ("robot", "population", "seed")}
    settings |= {"thetas": tuning.THETAS, "omegas": tuning.OMEGAS, "start": schedule}
    trace: list[dict[str, Any]] = []

    def keep(stage: str, entry: dict[str, Any]) -> None:
        trace.append({"stage": stage, **entry})
        write_json(arguments.trace, {"settings": settings, "trace": trace})

    finalists = [schedule]
    for stage in ("approach", "stay"):
        ranked = search(arguments, stage, schedule, partial(keep, stage))
        if ranked:
            schedule, finalists = ranked[0], [finalists[0], *ranked[: arguments.finalists - 1]]
    judged = tuning.judge(
        tuning.final_cases(arguments.robot), tuning.stay_cost, finalists, arguments.jobs or -1
    )
    for finalist, entry in zip(finalists, judged, strict=True):
        keep("final", {"schedule": finalist, **entry})
    print("final: cost", ", ".join(f"{entry['cost']:.4g}" for entry in judged), "(start first)")
    best = min(range(len(judged)), key=lambda i: judged[i]["cost"])
    write_text(arguments.out, toml(finalists[best]))
    return cli.PASSED


def search(
    arguments: argparse.Namespace,
    stage: str,
    schedule: dict[str, Any],
    keep: Callable[[dict[str, Any]], None],
) -> list[dict[str, Any]]:
    """Schedules with other values in one stage, the best first; none without a generation."""
    from softdyn.validation.studies import tuning

    generations = getattr(arguments, stage)
    if generations == 0:
        return []
    first = stage == "approach"
    found = tuning.tune(
        (tuning.approach_cases if first else tuning.stay_cases)(arguments.robot),
        tuning.approach_cost if first else tuning.stay_cost,
        # the approach is tuned alone: the stay is not yet
        partial(tuning.only if first else changed, schedule, stage),
        {name: schedule[stage][name] for name in TUNED if schedule[stage][name] > 0},
        generations=generations,
        population=arguments.population,
        seed=arguments.seed,
        jobs=arguments.jobs or -1,
        each=keep,
    )
    ranked = sorted(found, key=lambda entry: entry["cost"])
    print(f"{stage}: cost {found[0]['cost']:.4g} at the start, {ranked[0]['cost']:.4g} now")
    return [changed(schedule, stage, entry["values"]) for entry in ranked]


def changed(schedule: dict[str, Any], stage: str, values: Mapping[str, float]) -> dict[str, Any]:
    """The schedule with other values in one stage, of four digits."""
    new = {name: float(f"{value:.4g}") for name, value in values.items()}
    return {**schedule, stage: {**schedule[stage], **new}}


def start(robot: str, file: str | None) -> dict[str, Any]:
    """The tables of the schedule to begin with."""
    import softdyn
    from softdyn.controllers import Schedule, SoftIdClfQp, Stage
    from softdyn.controllers.programmes.horizon import horizon
    from softdyn.controllers.schedule import make_schedule, tuned
    from softdyn.validation.studies import paper, tuning

    model = softdyn.load(robot)
    length = paper.setup_of(model).length
    schedule = make_schedule(cli.read_toml(file)) if file else tuned(model)
    if schedule is None:
        gains = SoftIdClfQp(model).gains
        both = Stage(gains, horizon(gains))
        schedule = Schedule(both, both, arrive=0.02 * length, leave=0.2 * length, dwell=0.2)
    return tuning.tables(schedule)


def toml(schedule: dict[str, Any]) -> str:
    """A schedule as text."""
    numbers = {name: value for name, value in schedule.items() if not isinstance(value, dict)}
    parts = [lines(numbers)]
    for name in ("approach", "stay"):
        parts.append(f"\n[{name}]\n" + lines(schedule[name]))
    return "".join(parts)


def lines(table: dict[str, float]) -> str:
    """A line for each number."""
    return "".join(f"{name} = {value:g}\n" for name, value in table.items())


if __name__ == "__main__":
    sys.exit(main())
