#!/usr/bin/env python3
"""Let a robot move under given inputs, without a controller."""

from __future__ import annotations

from functools import partial

from softdyn.commands import cli

EPILOG = """\
--u holds constant inputs, one for each actuator. --inputs FILE is CSV with the columns t (s) and
u.NAME for every actuator; times begin at 0 and have even steps, each row is held until the next
one, and other columns, such as those of a log, are ignored. Without either all inputs are zero.
Inputs beyond the bounds in the robot's file are refused.

Inputs u.NAME are forces. With --rig a column command.NAME may stand in place of u.NAME. It has the
command of the motor, as the robot's file states it: the free length of a winch (m), or its rate of
change (m/s), or a force. Where a file has both columns, as the log of a run behind a rig, the
command counts with --rig, and the force without.

Several files run at once on all cores, for the time of the shortest. --out FOLDER writes a log for
each, with the file's name; page and plot show all runs.

--obstacles FILE is as for run: the links touch them, unless they say "contact = false". The log has
the forces, and the page shows the obstacles.

--plant model integrates the analytic model in place of the twin. --plant FILE is an MJCF that
replaces the twin.

The steps of --timestep are 0.5 ms or less by default. A coarser step adds numerical damping.

exit codes: 0 done; 1 a motion diverged, or a file had no room; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
cli.add_force_options(parser)
given = parser.add_mutually_exclusive_group()
given.add_argument("--u", type=cli.finite, nargs="+", metavar="U", help="constant inputs")
given.add_argument("--inputs", metavar="FILE", nargs="+", help="inputs or commands over time, CSV")
parser.add_argument(
    "--seconds", type=cli.positive, metavar="T",
    help="length of the run in s (default: 3, or to the last row of --inputs)",
)  # fmt: skip
parser.settings(
    without=("duration", "observer"),
    period="time between samples in s (default: 0.002)",
)
parser.output("--log", "FILE", "write the run as NPZ, or as CSV where FILE ends in .csv")
parser.add_argument("--out", metavar="FOLDER", help="write a log for each of several --inputs")
parser.output("--html", "FILE", "write a page that replays the motion")
parser.output("--plot", "FILE", "the tip and the inputs over time: .png or .pdf")
cli.add_json(parser)

SECONDS = 3.0


def command(arguments: cli.Arguments) -> int:
    """Read the inputs, run and report."""
    import time
    from pathlib import Path

    import numpy as np

    import softdyn
    from softdyn.commands.run import make_plant, make_rig, make_surroundings
    from softdyn.validation import rollouts
    from softdyn.validation.loop.pictures.replay import show_runs
    from softdyn.validation.loop.pictures.time_figures import look, save_comparison
    from softdyn.validation.rollouts.inputs import read_files

    if arguments.plot is not None:
        look.check_path(arguments.plot)
    model = cli.load_robot(arguments)
    rig = make_rig(arguments.rig, model)
    settings = parser.given(arguments) | {
        "rig": rig, "surroundings": make_surroundings(arguments.surroundings, model),
        "plant": make_plant(model, arguments.plant, arguments),
    }  # fmt: skip
    names, several = ["run"], len(arguments.inputs or ()) > 1
    if several and arguments.log is not None:
        raise softdyn.InputError("--log", "--out FOLDER with several --inputs", arguments.log)
    seconds, hold, commands = arguments.seconds or SECONDS, None, tuple[str, ...]()
    batch = [np.array(arguments.u or model.relaxed)]
    if arguments.inputs is not None:
        files = read_files(arguments.inputs, model, rig)
        names, batch = list(files), [rows.u for rows in files.values()]
        hold, commands = files[names[0]].hold, files[names[0]].commands
        seconds = arguments.seconds or min(rows.seconds for rows in files.values())
    logs_to = [] if arguments.out is None else [Path(arguments.out, f"{n}.npz") for n in names]
    if logs_to:
        cli.make_folder(Path(arguments.out))
        cli.check_outputs(parser, arguments, *logs_to)
    cli.doing(f"moves for {seconds:g} s")
    began = time.perf_counter()
    with cli.saved_in_errors(arguments.log):
        logs = rollouts(model, batch, seconds, hold=hold, commands=commands, **settings)
    wall = time.perf_counter() - began
    results = cli.Results()
    for log, path in zip(logs, logs_to, strict=False):
        results.save(log.save, str(path))
    if arguments.log is not None:
        results.save(partial(cli.save_log, logs[0]), arguments.log)
    if arguments.html is not None:
        page = show_runs(logs, [model] * len(logs), names) if several else logs[0].show(model)
        results.save(page.save, arguments.html)
    if arguments.plot is not None:
        results.save(
            lambda path: save_comparison(path, logs, names if several else None), arguments.plot
        )
    runs = [
        {"failed": log.failed, "reason": log.reason, "final_tip": log.y[-1].tolist()}
        for log in logs
    ]  # fmt: skip
    report = {
        "robot": model.name, "seconds": seconds, "timestep": logs[0].timestep,
        "integrator": arguments.integrator, "wall_s": wall,
        "record": cli.record_beside(logs[0], arguments.json),
        **({"runs": dict(zip(names, runs, strict=True))} if several else runs[0]),
    }  # fmt: skip
    lines = [f"{n}: {log}" if several else str(log) for n, log in zip(names, logs, strict=True)]
    lines.append(f"{wall:.3g} s of computing")
    results.tell(report, arguments.json, "\n".join(lines))
    return cli.FAILED if results.lost or any(log.failed for log in logs) else cli.PASSED


main = cli.program(parser, command, __name__)
