#!/usr/bin/env python3
"""Where a robot can rest: its tip's targets, the inputs that hold them, and how stably."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    import numpy as np

    from softdyn import SoftModel
    from softdyn.statics import Equilibrium, TipSearch

STARTS = 24  # sampled rests that each target is sought from
NUDGE = 1e-3  # rad, or part of a stroke: what stability is tried with in the twin

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

Without a goal: the four set points of the paper's ellipse, scaled to the robot. Every target is
searched from many starts: stable rests under random inputs, and random shapes. What is found
exists; what is not found may exist. Each result is put into the MuJoCo twin with its input frozen
for --hold seconds, exactly and with joints nudged by 1e-3 rad, and the tip's drift is told.

--inputs raises the given input slowly from rest instead, and tells where that ends.

exit codes: 0 done; 1 no equilibrium was found; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
goal = parser.add_mutually_exclusive_group()
goal.add_argument("--theta", type=cli.finite, metavar="T", help="the set point at T pi")
goal.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="a point in m"
)
goal.add_argument(
    "--inputs", type=cli.finite, nargs="+", metavar="U", help="where these inputs lead"
)
parser.add_argument(
    "--rays",
    type=cli.count,
    default=40,
    metavar="N",
    help="random inputs to raise (default: 40)",
)
parser.add_argument(
    "--spread",
    type=cli.count,
    default=100,
    metavar="N",
    help="stable rests sought where there are few (default: 100)",
)
parser.add_argument(
    "--shapes",
    type=cli.count,
    default=12,
    metavar="N",
    help="random shapes to start from, for each target (default: 12)",
)
parser.add_argument(
    "--seed", type=cli.whole, default=0, metavar="S", help="of all that is random (default: 0)"
)
parser.add_argument(
    "--hold",
    type=cli.positive,
    default=10.0,
    metavar="S",
    help="length of the twin's run in s (default: 10)",
)
parser.add_argument(
    "--log", metavar="FILE", help="start from the last state of a run of scripts/run.py, too"
)
parser.add_argument("--map", metavar="FILE", help="draw the rests and the targets: .png or .pdf")
parser.add_argument(
    "--json", metavar="FILE", help="write the figures as JSON; - prints them and nothing else"
)


def command(arguments: cli.Arguments) -> int:
    """Search, judge, report."""
    from softdyn.statics import StaticsError
    from softdyn.validation.files import check_writable
    from softdyn.validation.report.statics_figure import check_path

    if arguments.inputs is not None and arguments.map is not None:
        parser.error("argument --map: not allowed with --inputs")
    if arguments.map is not None:
        check_writable(check_path(arguments.map))
    if arguments.json not in (None, "-"):
        check_writable(arguments.json)
    model = cli.load_robot(arguments)
    try:
        report = lead(model, arguments) if arguments.inputs else search(model, arguments)
    except StaticsError as error:
        print(f"error: {error}", file=sys.stderr)
        return cli.FAILED
    cli.write_report(report, arguments.json, summary(report))
    return cli.PASSED


def lead(model: SoftModel, arguments: cli.Arguments) -> dict[str, Any]:
    """Where the given inputs lead from rest."""
    import numpy as np

    from softdyn import InputError, statics

    u = np.array(arguments.inputs)
    if u.shape != (model.nu,):
        raise InputError("--inputs", f"{model.nu} numbers", f"{len(u)}")
    if (u < model.u_min).any() or (u > model.u_max).any():
        raise InputError("--inputs", f"numbers from {model.u_min} to {model.u_max}", u)
    found, snaps = statics.ramp(model, u)
    return {
        "robot": model.bundled or model.name,
        "snaps": snaps,
        "rest": figures(found, arguments.hold),
    }


def search(model: SoftModel, arguments: cli.Arguments) -> dict[str, Any]:
    """The targets, each from many starts."""
    import numpy as np

    from softdyn import statics
    from softdyn.statics.samples import STATIONS
    from softdyn.validation.report import statics_figure
    from softdyn.validation.studies import paper

    goals = targets(model, arguments)
    guesses = [] if arguments.log is None else [last_state(model, arguments.log)]
    rests = statics.sample_rests(model, arguments.rays, arguments.seed)
    samples = list(progress(rests, arguments.rays * STATIONS, "rests"))
    more = statics.sample_between(samples, arguments.spread, arguments.seed)
    samples += list(progress(more, arguments.spread, "between them"))
    searches, rows = [], []
    for theta, target in progress(goals, len(goals), "targets"):
        nearest = sorted(samples, key=lambda one: float(np.linalg.norm(one.y - target)))[:STARTS]
        one = statics.inputs_for_tip(
            model, target, nearest, guesses=guesses, shapes=arguments.shapes, seed=arguments.seed
        )
        searches.append(one)
        rows.append(row(theta, one, samples, arguments.hold))
    if arguments.map is not None:
        labels = [target_name(line) for line in rows]
        statics_figure.draw(arguments.map, samples, searches, labels, paper.ellipse_points(model))
    return {
        "robot": model.bundled or model.name,
        "samples": len(samples),
        "targets": rows,
    }


def last_state(model: SoftModel, path: str) -> tuple[np.ndarray, np.ndarray]:
    """(q, u) at the end of a logged run."""
    from softdyn import InputError
    from softdyn.validation import Log

    log = Log.load(path)
    if log.joint_names != model.joint_names or not log.steps:
        raise InputError(path, f"a run of {model.name}", f"one of {log.robot}")
    return log.q[-1], log.u[-1]


def targets(model: SoftModel, arguments: cli.Arguments) -> list[tuple[float | None, np.ndarray]]:
    """(θ or None, point) of every target asked for."""
    import numpy as np

    from softdyn.validation.studies import paper

    if arguments.target is not None:
        return [(None, np.array(arguments.target))]
    thetas: Iterable[float] = paper.THETAS if arguments.theta is None else (arguments.theta,)
    setup = paper.setup_of(model)
    return [(theta, setup.ellipse().point(theta)) for theta in thetas]


def row(
    theta: float | None, one: TipSearch, samples: list[Equilibrium], hold_s: float
) -> dict[str, Any]:
    """What a search says about one target."""
    import numpy as np

    def described(equilibrium: Equilibrium | None) -> dict[str, Any] | None:
        if equilibrium is None:
            return None
        distance = {"distance_cm": 100 * one.distance(equilibrium)}
        return distance | figures(equilibrium, hold_s)

    ramped = min((float(np.linalg.norm(x.y - one.target)) for x in samples), default=np.nan)
    closest, stable, firmest = one.nearest, one.nearest_stable, one.most_stable
    return {
        "theta": theta,
        "target": one.target.tolist(),
        "closest": described(closest),
        "closest_stable": described(stable),
        "most_stable": described(firmest),
        "closest_sample_cm": 100 * ramped,
        "equilibria": len(one.found),
    }


def figures(one: Equilibrium, hold_s: float) -> dict[str, Any]:
    """An equilibrium in numbers, the twin's verdict among them."""
    from softdyn.validation.crosschecks.rests import hold

    drift, nudged = hold(one, hold_s), hold(one, hold_s, nudge=NUDGE)
    held = [name for name, held in zip(one.model.joint_names, one.held, strict=True) if held]
    return {
        "y": one.y.tolist(),
        "u": one.u.tolist(),
        "q": one.q.tolist(),
        "residual": one.residual,
        "stable": one.stable,
        "smallest_eigenvalue": float(one.eigenvalues[0]) if one.eigenvalues.size else None,
        "rightmost_pole": float(one.poles[0].real) if one.poles.size else None,
        "joints_at_limits": held,
        "tip_compliance": one.tip_compliance.tolist(),
        "hold_s": hold_s,
        "drift_cm": {"largest": 100 * drift.largest, "final": 100 * drift.final},
        "nudged_drift_cm": {"largest": 100 * nudged.largest, "final": 100 * nudged.final},
    }


def progress(items: Iterable[Any], total: int, what: str) -> Iterable[Any]:
    """`items` with a bar on stderr, on a terminal only."""
    from tqdm import tqdm

    return tqdm(items, total=total, desc=what, disable=not sys.stderr.isatty(), leave=False)


def summary(report: dict[str, Any]) -> str:
    """The report for people."""
    if "rest" in report:
        tip = " ".join(f"{x:.4f}" for x in report["rest"]["y"])
        lines = [f"{report['robot']}: rests with its tip at {tip} m, {report['snaps']} snaps"]
        return "\n".join([*lines, describe(report["rest"])])
    lines = [f"{report['robot']}: {report['samples']} stable rests sampled"]
    for line in report["targets"]:
        place = " ".join(f"{x:.4f}" for x in line["target"])
        lines.append(f"{target_name(line)} ({place} m), {line['equilibria']} equilibria found")
        lines.append(f"  closest        {describe(line['closest'])}")
        stable = line["closest_stable"]
        if stable is None:
            lines.append("  stable         none found")
        elif stable != line["closest"]:
            lines.append(f"  stable         {describe(stable)}")
        if line["most_stable"] != stable:
            lines.append(f"  most stable    {describe(line['most_stable'])}")
        lines.append(f"  closest sample {line['closest_sample_cm']:.3f} cm away")
    return "\n".join(lines)


def describe(one: dict[str, Any]) -> str:
    """One equilibrium on one line."""
    away = f"{one['distance_cm']:.3f} cm away, " if "distance_cm" in one else ""
    value, pole = one["smallest_eigenvalue"], one["rightmost_pole"]
    firm = "nothing free" if value is None else f"eigenvalue {value:.4g}, pole {pole:.3g} /s"
    count = len(one["joints_at_limits"])
    stops = f", {count} joints at limits" if count else ""
    inputs = " ".join(f"{x:.3f}" for x in one["u"])
    return (
        f"{away}{'stable' if one['stable'] else 'unstable'} ({firm}){stops}, "
        f"drift {one['drift_cm']['final']:.2g} cm in {one['hold_s']:g} s, "
        f"nudged {one['nudged_drift_cm']['final']:.2g} cm, u = {inputs}"
    )


def target_name(line: dict[str, Any]) -> str:
    """θ of a set point, or that it is the target."""
    if line["theta"] is None:
        return "target"
    from softdyn.validation.report.names import experiment_title

    return experiment_title("set_point", line["theta"])


main = cli.program(parser, command, __name__)
