#!/usr/bin/env python3
"""Let a robot move under given inputs, without a controller."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
--u holds constant inputs, one for each actuator. --inputs FILE is CSV with the columns t (s) and
u.NAME for every actuator; times begin at 0 and have even steps, each row is held until the next
one, and other columns, such as those of a log, are ignored. Without either all inputs are zero.
Inputs beyond the bounds in the robot's file are refused.

The steps of --timestep are 0.5 ms or less by default. A coarser step adds numerical damping.

exit codes: 0 done; 1 the robot's motion diverged; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
given = parser.add_mutually_exclusive_group()
given.add_argument("--u", type=cli.finite, nargs="+", metavar="U", help="constant inputs")
given.add_argument("--inputs", metavar="FILE", help="inputs over time, CSV")
parser.add_argument(
    "--seconds", type=cli.positive, metavar="T",
    help="length of the run in s (default: 3, or to the last row of --inputs)",
)  # fmt: skip
parser.add_argument("--q0", type=cli.finite, nargs="+", metavar="Q", help="initial pose")
parser.add_argument("--timestep", type=cli.positive, metavar="S", help="plant step in s")
parser.add_argument(
    "--period", type=cli.positive, metavar="S", help="time between samples in s (default: 0.002)"
)
parser.add_argument(
    "--integrator", choices=("implicitfast", "implicit", "euler", "rk4"), default="implicitfast",
    help="MuJoCo's scheme (default: implicitfast)",
)  # fmt: skip
parser.add_argument("--contacts", action="store_true", help="let the links touch")
parser.add_argument("--friction", action="store_true", help="with the file's dry friction")
parser.add_argument(
    "--rig", nargs="?", const="file", metavar="FILE",
    help="with the rig of the robot's file; FILE changes it, as for run",
)  # fmt: skip
parser.output("--log", "FILE", "write the run as NPZ, or as CSV where FILE ends in .csv")
parser.output("--html", "FILE", "write the run as a page that replays it")
parser.output("--plot", "FILE", "the tip and the inputs over time: .png or .pdf")
cli.add_json(parser)

SECONDS = 3.0


def command(arguments: cli.Arguments) -> int:
    """Read the inputs, run and report."""
    import time

    import numpy as np

    from softdyn.commands.run import make_rig
    from softdyn.validation import rollout
    from softdyn.validation.report.plot_style import check_path
    from softdyn.validation.rollouts.inputs import read_inputs

    if arguments.plot is not None:
        check_path(arguments.plot)
    model = cli.load_robot(arguments)
    seconds, hold = arguments.seconds or SECONDS, None
    u = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
    if arguments.inputs is not None:
        rows = read_inputs(arguments.inputs, model)
        u, hold, seconds = rows.u, rows.hold, arguments.seconds or rows.seconds
    elif arguments.u is not None:
        u = np.array(arguments.u)
    began = time.perf_counter()
    log = rollout(
        model, u, seconds, hold=hold, period=arguments.period, timestep=arguments.timestep,
        integrator=arguments.integrator, q0=arguments.q0, contacts=arguments.contacts,
        friction=arguments.friction, rig=make_rig(arguments.rig),
    )  # fmt: skip
    wall = time.perf_counter() - began
    if arguments.log is not None:
        (log.to_csv if arguments.log.endswith(".csv") else log.save)(arguments.log)
    if arguments.html is not None:
        log.show(model).save(arguments.html)
    if arguments.plot is not None:
        log.plot(arguments.plot)
    report = {
        "robot": log.robot, "seconds": float(log.t[-1]), "timestep": log.timestep,
        "integrator": arguments.integrator, "failed": log.failed, "reason": log.reason,
        "final_tip": log.y[-1].tolist(), "wall_s": wall,
    }  # fmt: skip
    written = (arguments.log, arguments.html, arguments.plot, arguments.json)
    lines = [str(log), f"{wall:.3g} s of computing"]
    lines += [f"wrote {file}" for file in written if file not in (None, "-")]
    cli.write_report(report, arguments.json, "\n".join(lines))
    return cli.FAILED if log.failed else cli.PASSED


main = cli.program(parser, command, __name__)
