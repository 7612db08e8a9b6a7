#!/usr/bin/env python3
"""A controller away from its model: other targets, plants, delayed inputs, a noisy tip."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn.validation.studies.trials import Trial

EPILOG = """\
For each robot set points at theta = 0.25 and 1.25 pi and a trajectory at 0.25 pi rad/s, none of
them the paper's. Then each change by itself: an ellipse of 0.7 times the axes; masses, stiffnesses
and damping of the plant alone at 0.8, 0.9, 1.1 and 1.2 times the model's; inputs that come 5 ms
late; 1 mm of noise on each coordinate of the tip. All loops at --period.

exit codes: 0 no run failed with a plant within 10 %; 1 one did; 2 bad input.
"""
FACTORS = (0.8, 0.9, 1.1, 1.2)
SET_POINTS, RATE = (0.25, 1.25), 0.25


parser = cli.Parser(__doc__, EPILOG)
cli.add_trial_options(parser)
parser.add_argument("--period", type=cli.positive, default=0.005, metavar="S")


def command(arguments: cli.Arguments) -> int:
    """Run, report."""
    from softdyn.validation.studies.trials import run_all

    cli.check_trials(arguments)
    named = [
        (robot, change, trial)
        for robot in arguments.robots
        for change, trials in changes(robot, arguments.controller, arguments.period).items()
        for trial in trials
    ]
    results = run_all((trial for _, _, trial in named), arguments.jobs or -1)
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for (robot, change, trial), result in zip(named, results, strict=True):
        row = rows.setdefault((robot, change), {"robot": robot, "change": change, "failed": 0})
        set_point = trial.kind == "set_point"
        name = f"theta {trial.value:g}" if set_point else f"omega {trial.value:g}"
        row[name] = result["final_error_cm" if set_point else "mse_cm2"]
        row["failed"] += result["failed"]
    near = sum(
        row["failed"]
        for (_, change), row in rows.items()
        if not change.endswith((f"{FACTORS[0]:g}", f"{FACTORS[-1]:g}"))
    )
    table = list(rows.values())
    cli.write_report({"rows": table}, arguments.json, markdown(table))
    return cli.FAILED if near else cli.PASSED


def changes(robot: str, controller: str, period: float) -> dict[str, list[Trial]]:
    """The trials of one robot by what is changed."""
    from softdyn.validation.studies.trials import Plant, Trial

    def three(plant: Plant, shrink: float = 1.0) -> list[Trial]:
        cases = [("set_point", x) for x in SET_POINTS] + [("tracking", RATE)]
        return [
            Trial(robot, controller, kind, value, period, shrink, plant=plant)
            for kind, value in cases
        ]

    found = {"none": three(Plant()), "ellipse x 0.7": three(Plant(), 0.7)}
    for name in ("mass", "stiffness", "damping"):
        for factor in FACTORS:
            found[f"{name} x {factor:g}"] = three(Plant(**{name: factor}))
    found["5 ms delay"] = three(Plant(delay=0.005))
    found["1 mm noise"] = three(Plant(noise=0.001))
    return found


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table; set points in cm, trajectories in cm²."""
    from softdyn.validation.tables import pipes

    texts = [[f"{x:.2f}" if isinstance(x, float) else x for x in row.values()] for row in rows]
    return "\n".join(pipes([list(rows[0]), *texts]))


main = cli.program(parser, command, __name__)
