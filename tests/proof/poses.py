"""`mpc` at poses and pairs of points that the statics hold, or do not: docs/beyond.md."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from softdyn.commands import cli

EPILOG = """\
The robots are the helix and docs/examples/three_sections.toml. Each target is a stable equilibrium
that `statics` finds again from the target alone, or a pair of values of two equilibria, for which
its search finds no stable one. The figures go to tests/proof/documents/measured/poses.json; then
`python -m tests.proof tables` writes the table. All cases take half an hour.

exit codes: 0 done; 2 bad input.
"""
HELD = {"m": 1e-4, "rad": 1e-3}  # residual of an equilibrium that holds a target
REACHED = {"m": 1e-3, "rad": math.radians(0.5)}
NEAR = {"m": 1e-2, "rad": math.radians(1.0)}
AXIS, MIDDLE = "tip and axis", "tip and mid-point"
ARM = "docs/examples/three_sections.toml"
CASES = {"helix": ("helix", AXIS), "arm": (ARM, AXIS), "middle": ("helix", MIDDLE)}

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("cases", nargs="*", metavar="CASE", help=f"{', '.join(CASES)} (default: all)")
parser.add_argument("--count", type=int, default=20, metavar="N", help="targets (default: 20)")
parser.add_argument("--apart", type=int, default=5, metavar="N", help="pairs (default: 5)")
parser.add_argument("--seconds", type=float, default=15.0, metavar="S", help="default: 15")


def command(arguments: cli.Arguments) -> int:
    """Run the targets of each case; its rows are written when it is done."""
    from softdyn import InputError
    from tests.proof.documents.measured_rows import replace_rows
    from tests.proof.documents.settings import MEASURED

    path = MEASURED / "poses.json"
    for case in arguments.cases or CASES:
        if case not in CASES:
            raise InputError("CASE", f"one of {', '.join(CASES)}", case)
        name, what = CASES[case]
        rows = [{"case": case, **row} for row in runs(loaded(name), what, arguments)]
        replace_rows(path, "case", [case], rows, [*CASES])
    return cli.PASSED


def loaded(name: str) -> Any:
    """A bundled robot, or that of an arm's table."""
    import softdyn
    from softdyn import design
    from softdyn.loading import load_text

    if not name.endswith(".toml"):
        return softdyn.load(name)
    return load_text(design.read(cli.read_toml(name), name).text, path=name)


def within(errors: Sequence[float], units: Sequence[str], limits: Mapping[str, float]) -> bool:
    """Whether all errors are at most the limits of their units."""
    return all(error <= limits[unit] for error, unit in zip(errors, units, strict=True))


def tasks_for(model: Any, what: str) -> tuple[Any, ...]:
    """The tip's position, and its direction or the position of a link half-way."""
    from softdyn.tasks import PointTask, direction_tasks

    if what == AXIS:
        return tuple(direction_tasks(model))
    tip, chain = model.robot.task, model.robot.chain(model.robot.task)
    return PointTask(tip), PointTask(chain[len(chain) // 2].child)


def goal_of(tasks: Sequence[Any], rests: Sequence[Any]) -> Any:
    """Targets that each task has at its own equilibrium."""
    from softdyn import SetPoint
    from softdyn.tasks import AxisTask, LinkKinematics, References, Target

    motions = {}
    for task, rest in zip(tasks, rests, strict=True):
        at = LinkKinematics.of(rest.model)(rest.state, task.link)
        turned = isinstance(task, AxisTask)
        motions[task.name] = Target(at.rotation @ task.axis) if turned else SetPoint(at.position)
    return References(motions)


def runs(model: Any, what: str, arguments: cli.Arguments) -> Iterator[dict[str, Any]]:
    """A row for each target."""
    import numpy as np

    from softdyn import statics
    from softdyn.controllers import Mpc
    from softdyn.validation import simulate

    tasks, left = tasks_for(model, what), {True: arguments.count, False: arguments.apart}
    rests = statics.spread_rests(model, 2 * arguments.count, seed=1)
    pairs = [(one, one) for one in rests] + list(pairwise(rests))
    units = ["rad" if task.name.endswith(".axis") else "m" for task in tasks]
    for pair in pairs:
        possible = pair[0] is pair[1]
        if not left[possible]:
            continue
        goal = goal_of(tasks, pair)
        search = statics.inputs_for_tasks(model, tasks, goal(0.0), seconds=math.inf)
        rest = search.nearest_stable
        errors = [] if rest is None else list(search.errors(rest).values())
        if rest is None or within(errors, units, HELD) != possible:
            continue
        left[possible] -= 1
        row: dict[str, Any] = {"robot": model.name, "tasks": what, "held": possible,
                               "units": units, "statics": errors}  # fmt: skip
        log = simulate(model, Mpc(model, tasks=tasks), goal, duration=arguments.seconds)
        state, last = model.state(log.q[-1], log.v[-1]), goal(0.0)
        row["end"] = [float(np.linalg.norm(task(state, last).error)) for task in tasks]
        print(row, flush=True)
        yield row


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows of `runs` as a Markdown table, a line for each case."""
    import numpy as np

    from softdyn.validation.tables import Table

    titles = [
        "robot", "tasks", "within 1 mm and 0.5°", "median", "worst",
        "no stable rest found: at most 1 cm and 1° farther than the nearest one",
    ]  # fmt: skip
    lines = []
    for case in dict.fromkeys(row["case"] for row in rows):
        held, apart = ([r for r in rows if (r["case"], r["held"]) == (case, k)] for k in (1, 0))
        units = held[0]["units"]
        ends = np.array([row["end"] for row in held])
        reached = sum(within(end, units, REACHED) for end in ends)
        beyond = [np.subtract(row["end"], row["statics"]).tolist() for row in apart]
        near = sum(within(each, units, NEAR) for each in beyond)
        lines.append([
            held[0]["robot"], held[0]["tasks"], f"{reached} of {len(held)}",
            shown(np.median(ends, axis=0).tolist(), units), shown(ends.max(axis=0).tolist(), units),
            f"{near} of {len(apart)}" if apart else None,
        ])  # fmt: skip
    return Table(titles, lines).markdown()


def shown(errors: Sequence[float], units: Sequence[str]) -> str:
    """Errors in mm and degrees."""
    factors = {"m": (1e3, " mm"), "rad": (math.degrees(1.0), "°")}
    pairs = [(x, *factors[unit]) for x, unit in zip(errors, units, strict=True)]
    return ", ".join(f"{x * factor:.2f}{unit}" for x, factor, unit in pairs)


main = cli.program(parser, command, __name__)
