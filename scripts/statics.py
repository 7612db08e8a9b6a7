#!/usr/bin/env python3
"""Equilibria of a robot: inputs that hold its tip at targets, and their stability."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    import numpy as np

    from softdyn import SoftModel

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

By default the targets are the four set points of the paper's ellipse for its robots. For any other
robot they are four stable equilibria, as far apart as its inputs can move the tip. A robot without
inputs has no targets: the answer is its equilibrium. The search for every target begins at many
starts: stable equilibria under random inputs, and random shapes. Every equilibrium found is exact,
but others may exist. Each one is put into the MuJoCo twin, which holds its input for --hold
seconds, once exactly and once with joints displaced by 1e-3 rad. The report has the tip's drift.

--inputs raises the given input slowly from rest instead, and shows the resulting equilibrium.
--pose searches the equilibria nearest to a pose of the tip.
--axis samples stable equilibria and reports, for each cell of tip positions, the cone in which this
axis of the tip's link lies. More samples (--rays, --spread) may widen the cones. --map draws them.
--friction is for cables that rub: the robot rests anywhere between two shapes, after its cables
were pulled in and after they were paid out. With --map it draws the tip while the inputs rise
slowly, fall to zero and rise again.

exit codes: 0 done; 1 no equilibrium was found; 2 bad input.
"""


LOOP_STEPS = 40  # steps of each branch of a hysteresis loop
TARGETS = 4  # number of targets of a robot without published ones
parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
cli.add_force_options(parser)
goal = parser.add_mutually_exclusive_group()
goal.add_argument("--theta", type=cli.finite, metavar="T", help="the set point at T pi")
goal.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="a point in m"
)
goal.add_argument(
    "--inputs",
    type=cli.finite,
    nargs="*",
    metavar="U",
    help="find the equilibrium under these inputs; a robot without inputs needs no number",
)
goal.add_argument(
    "--pose",
    type=cli.finite,
    nargs=6,
    metavar=("X", "Y", "Z", "RX", "RY", "RZ"),
    help="a pose of the tip: a point in m and a rotation vector in rad",
)
goal.add_argument(
    "--axis", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"),
    help="map the directions that this axis of the tip's link can have",
)  # fmt: skip
parser.add_argument(
    "--cell", type=cli.positive, metavar="M",
    help="with --axis: side of a cell in m (default: a tenth of the robot's length)",
)  # fmt: skip
parser.add_argument(
    "--friction", action="store_true", dest="cable_friction",
    help="with --inputs: the rests with friction of cables",
)  # fmt: skip
parser.option("--rays", cli.count, "N", "random inputs to raise", 40)
parser.option(
    "--spread", cli.count, "N", "further stable equilibria sought where there are few", 100
)
parser.option(
    "--shapes", cli.count, "N", "random shapes at which the search for each target starts", 12
)
parser.option("--seed", cli.whole, "S", "seed of all random numbers", 0)
parser.option("--hold", cli.positive, "S", "length of the twin's run in s", 10.0)
parser.add_argument(
    "--log", metavar="FILE", help="also start at the last state of a run of scripts/run.py"
)
parser.output("--map", "FILE", "draw the equilibria and the targets: .png or .pdf")
cli.add_json(parser)
parser.unused(
    "--rays --spread --shapes --seed --log", lambda a: a.inputs is not None,
    "with --inputs nothing is searched",
)  # fmt: skip
parser.unused("--spread --shapes --log", lambda a: a.pose, "the search for --pose has none")
parser.unused("--shapes --log --hold", lambda a: a.axis, "--axis maps sampled equilibria")
parser.unused("--hold", lambda a: a.cable_friction, "the twin does not run for --friction")


def command(arguments: cli.Arguments) -> int:
    """Search, judge and report."""
    from softdyn.validation.loop.pictures.plot_style import check_path

    if arguments.cable_friction and arguments.inputs is None:
        parser.error("argument --friction: only with --inputs")
    for name in ("inputs", "pose"):
        drawn = arguments.map is not None and not arguments.cable_friction
        if drawn and getattr(arguments, name) is not None:
            parser.error(f"argument --map: not allowed with --{name}")
    if arguments.map is not None:
        check_path(arguments.map)
    if arguments.cell is not None and arguments.axis is None:
        parser.error("argument --cell: only with --axis")
    model = cli.load_robot(arguments)
    goals = (arguments.theta, arguments.target, arguments.inputs, arguments.pose, arguments.axis)
    if model.nu == 0 and all(one is None for one in goals):
        arguments.inputs = []
        parser.warn_of_unused(arguments)
    led = arguments.inputs is not None
    answer = lead if led else search if arguments.pose is None else hold_pose
    answer = rub if arguments.cable_friction else answer if arguments.axis is None else directions
    report, text = answer(model, arguments)
    cli.write_report(report, arguments.json, text)
    return cli.PASSED


def rub(model: SoftModel, arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """Find the rests under the given inputs after both directions of motion."""
    import numpy as np

    from softdyn import InputError, statics
    from softdyn.actuation import Capstan
    from softdyn.validation.report import statics_figure

    u, capstan = given(model, arguments.inputs), Capstan(model)
    if not len(capstan.tendon):
        raise InputError("--friction", "a robot with friction of cables", model.name)
    pulled, paid_out = statics.rest_interval(capstan, u)
    if arguments.map is not None:
        rise = np.linspace(0, 1, LOOP_STEPS + 1)
        shares = np.concatenate((rise, rise[-2::-1], rise[1:]))
        start = statics.settle(model, 0 * u).q
        loop = statics.follow(capstan, shares[:, None] * u, start)
        statics_figure.draw_loop(arguments.map, shares, loop)
    robot, apart = model.bundled or model.name, 1e3 * float(np.linalg.norm(pulled.y - paid_out.y))
    found = {"pulled_in": pulled, "paid_out": paid_out}
    lines = [f"{robot}: rests {apart:.3g} mm apart at the tip"]
    for name, one in found.items():
        lines.append(f"  {name.replace('_', ' ')}: tip {' '.join(f'{x:.4f}' for x in one.y)} m")
    tips = {name: {"tip": one.y.tolist()} for name, one in found.items()}
    return {"robot": robot, "u": u.tolist(), "apart_mm": apart, **tips}, "\n".join(lines)


def given(model: SoftModel, inputs: list[float]) -> np.ndarray:
    """The inputs of the command line."""
    import numpy as np

    from softdyn import InputError

    u = np.array(inputs, float)
    if u.shape != (model.nu,):
        expected = f"{model.nu} numbers" if model.nu else "none, because the robot has no inputs"
        raise InputError("--inputs", expected, f"{len(u)}")
    if (u < model.u_min).any() or (u > model.u_max).any():
        raise InputError("--inputs", f"numbers from {model.u_min} to {model.u_max}", u)
    return u


def lead(model: SoftModel, arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """Raise the given inputs from rest to an equilibrium."""
    from softdyn import statics
    from softdyn.validation.crosschecks.rest_report import HeldRest

    u = given(model, arguments.inputs)
    found, snaps = statics.ramp(model, u)
    rest, robot = HeldRest.of(found, arguments.hold), model.bundled or model.name
    tip = " ".join(f"{x:.4f}" for x in found.y)
    text = f"{robot}: equilibrium with its tip at {tip} m, {snaps} snaps\n{rest}"
    return {"robot": robot, "snaps": snaps, "rest": rest.to_dict()}, text


def hold_pose(model: SoftModel, arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """Search equilibria with the tip at a pose; the robot's length counts as much as 1 rad."""
    import numpy as np

    from softdyn import SetPoint, statics
    from softdyn.tasks import OrientationTask, PointTask, StackedReference, Target
    from softdyn.tasks.targets import turned
    from softdyn.validation import paper
    from softdyn.validation.crosschecks.rest_report import CM, HeldRest

    point, turn = np.array(arguments.pose[:3]), np.array(arguments.pose[3:])
    paper.check_reach(model, point)
    rotation = turned("--pose", turn)
    tip = model.robot.task
    tasks = [PointTask(tip, weight=model.robot.length**-2), OrientationTask(tip, name="turn")]
    goal = StackedReference({tip: SetPoint(point), "turn": Target(rotation)})
    found = statics.inputs_for_tasks(model, tasks, goal, rays=arguments.rays, seed=arguments.seed)
    robot, lines = model.bundled or model.name, list[str]()
    report: dict[str, Any] = {"robot": robot, "pose": arguments.pose}
    for name, one in (("closest", found.nearest), ("closest_stable", found.nearest_stable)):
        report[name] = None
        if one is not None:
            rest, errors = HeldRest.of(one, arguments.hold), found.errors(one)
            away, angle = CM * errors[tip], float(np.rad2deg(errors["turn"]))
            report[name] = {"distance_cm": away, "angle_deg": angle, **rest.to_dict()}
            words = f"{away:.3f} cm and {angle:.3f} deg away, {rest}"
            lines.append(f"  {name.replace('_', ', '):<16} {words}")
    head = f"{robot}: {len(found.found)} equilibria found near the pose"
    if found.timed_out:
        head += "; the time of the search was used up"
    report |= {"equilibria": len(found.found), "timed_out": found.timed_out}
    return report, "\n".join([head, *lines])


def directions(model: SoftModel, arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """Sample equilibria and find the cone of directions in each cell of tip positions."""
    import numpy as np

    from softdyn import statics
    from softdyn.validation.report import statics_figure
    from softdyn.validation.tables import Table

    side = arguments.cell or model.robot.length / 10
    rests = list(statics.sample_rests(model, arguments.rays, arguments.seed))
    rests += statics.sample_between(rests, arguments.spread, arguments.seed)
    cells = statics.reach_by_direction(rests, arguments.axis, side)
    if arguments.map is not None:
        statics_figure.draw_directions(arguments.map, cells)
    rows: list[dict[str, Any]] = [
        {"centre": cell.centre.tolist(), "rests": len(cell.rests),
         "direction": cell.direction.tolist(), "cone_deg": float(np.rad2deg(cell.cone))}
        for cell in cells
    ]  # fmt: skip
    robot = model.bundled or model.name
    shown = [
        [" ".join(f"{x:.3f}" for x in row["centre"]), row["rests"],
         " ".join(f"{x:+.2f}" for x in row["direction"]), f"{row['cone_deg']:.1f}"]
        for row in rows if row["rests"] > 1
    ]  # fmt: skip
    titles = ["cell (m)", "equilibria", "mean direction", "cone (degrees)"]
    head = f"{robot}: {len(rests)} stable equilibria in {len(rows)} cells of {side:.4g} m; "
    head += f"those with several, of {len(shown)} cells:"
    report = {"robot": robot, "axis": arguments.axis, "cell_m": side, "cells": rows}
    return report, f"{head}\n{Table(titles, shown).text()}"


def search(model: SoftModel, arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """Search each target from many starts."""
    from softdyn import statics
    from softdyn.validation import paper
    from softdyn.validation.crosschecks.rest_report import rests_at
    from softdyn.validation.report import statics_figure

    on_ellipse = arguments.theta is not None or model.bundled in paper.ROBOTS
    curve, thetas = None, [None]
    if arguments.target is not None:
        paper.check_reach(model, arguments.target)
        goals = {"target": arguments.target}
    elif on_ellipse:
        asked = paper.THETAS if arguments.theta is None else (arguments.theta,)
        ellipse, curve = (
            paper.setup_of(model).ellipse(),
            paper.ellipse_points(model, 121),
        )
        goals = {theta_name(theta): ellipse.point(theta) for theta in asked}
        thetas = [*asked]
    else:
        spread = statics.spread_rests(model, TARGETS, arguments.seed)
        goals = {f"rest {i + 1}": one.y for i, one in enumerate(spread)}
        thetas = [None] * len(goals)
    found = rests_at(
        model,
        goals,
        rays=arguments.rays,
        more=arguments.spread,
        shapes=arguments.shapes,
        seed=arguments.seed,
        seconds=arguments.hold,
        guesses=[] if arguments.log is None else [last_state(model, arguments.log)],
    )
    if arguments.map is not None:
        statics_figure.draw(arguments.map, found, curve)
    report = found.to_dict()
    for theta, row in zip(thetas, report["targets"], strict=True):
        row["theta"] = theta
    return report, str(found)


def last_state(model: SoftModel, path: str) -> tuple[np.ndarray, np.ndarray]:
    """(q, u) at the end of a logged run."""
    from softdyn import InputError

    log = cli.read_log(path)
    log.source.check(model, path)
    if not log.steps or log.finite_samples < len(log.q):
        raise InputError(path, "a run that ended in a finite state", log.reason)
    return log.q[-1], log.u[-1]


def theta_name(theta: float) -> str:
    """A set point in words."""
    return "θ = " + {0.0: "0", 1.0: "π"}.get(theta, f"{theta:g}π")


main = cli.program(parser, command, __name__)
