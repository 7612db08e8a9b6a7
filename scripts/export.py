#!/usr/bin/env python3
"""Write a robot in the other format, a URDF as MJCF or an MJCF as URDF; a log as CSV or MCAP."""

from __future__ import annotations

import sys

from softdyn.commands import cli

EPILOG = """\
--mjcf writes the twin as one file that MuJoCo's own viewer loads. It has several joints per body if
links are massless, and sites, tendons, actuators, stiff stops, shapes and a keyframe at rest.
Collision shapes are in group 3; they touch with --contacts (or <flag contact="enable"/> in the
file).
The file's rig is written too: winches, lags, delays, slack tendons, sensors. --motors FILE is TOML
that replaces lag, delay, rate, command, stiffness and damping of all motors, e.g. "lag = 0.02".
--urdf writes an MJCF's tree as an annotated URDF, with its boxes, spheres, cylinders and capsules.
Both list on stderr what the other format cannot state.
--csv writes a saved run with a row per sample and units in the header.
--mcap writes it for viewers such as Foxglove: poses of the links, joint states, the robot's URDF,
and every quantity of the log. It needs the extra softdyn[mcap]. --start is the date at t = 0, so
that the file lines up with a camera's recording.

exit codes: 0 written, and compared with the source: they agree; 1 they do not; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument(
    "robot",
    metavar="ROBOT",
    help="a URDF or its name; an MJCF for --urdf, a log for --csv and --mcap",
)
output = parser.add_mutually_exclusive_group(required=True)
output.add_argument("--mjcf", metavar="FILE", help="write MJCF")
output.add_argument("--urdf", metavar="FILE", help="write an annotated URDF")
output.add_argument("--csv", metavar="FILE", help="write a log as CSV")
output.add_argument("--mcap", metavar="FILE", help="write a log as MCAP")
parser.outputs += ["mjcf", "urdf", "csv", "mcap"]
cli.add_robot_options(parser)
cli.add_force_options(parser)
parser.add_argument("--no-shapes", action="store_true", help="leave out shapes (MJCF: visual ones)")
parser.add_argument("--contacts", action="store_true", help="MJCF: its links can touch each other")
parser.add_argument(
    "--start", metavar="DATE", help="MCAP: date and time at t = 0, such as 2026-11-26T12:00:00Z"
)
parser.add_argument("--motors", metavar="FILE", help="MJCF: motors of a TOML file, as run --rig")
cli.add_json(parser)
parser.unused("--start", lambda a: not a.mcap, "only --mcap writes dates")
parser.unused(
    "--annotations --floating --repair-inertia --contacts --force --motors", lambda a: a.urdf,
    "--urdf writes the robot as its file states it",
)  # fmt: skip
parser.unused(
    "--annotations --floating --repair-inertia --root --contacts --no-shapes --force --motors"
    " --json", lambda a: a.csv or a.mcap, "--csv and --mcap write a log",
)  # fmt: skip


def command(arguments: cli.Arguments) -> int:
    """Write, then read the file and compare."""
    from softdyn.description.library import find
    from softdyn.description.urdf import parse
    from softdyn.validation import Log
    from softdyn.validation.mjcf import export

    cli.doing(f"reads and writes {arguments.robot}")
    if arguments.csv is not None:
        Log.load(arguments.robot).to_csv(arguments.csv)
        return cli.PASSED
    if arguments.mcap is not None:
        from softdyn.validation.loop.mcap_file import save_mcap

        save_mcap(arguments.mcap, cli.read_log(arguments.robot, None), start=arguments.start)
        return cli.PASSED
    if arguments.urdf is not None:
        shapes = not arguments.no_shapes
        root = cli.root_folder(arguments)
        result, lost = export.write_urdf(arguments.robot, arguments.urdf, shapes=shapes, root=root)
    else:
        loading = {
            name: getattr(arguments, name) for name in ("annotations", "floating", "repair_inertia")
        }
        loading["root"] = cli.root_folder(arguments)
        cli.warn_of_no_use(parse(find(arguments.robot), **loading), arguments)
        result, lost = export.write_mjcf(
            arguments.robot,
            arguments.mjcf,
            shapes=not arguments.no_shapes,
            contacts=arguments.contacts,
            forces=cli.make_forces(arguments),
            motors=None if arguments.motors is None else cli.read_toml(arguments.motors),
            **loading,
        )
    for note in lost:
        print(f"lost: {note}", file=sys.stderr)
    report = {"lost": list(lost), "comparison": result.to_dict()}
    cli.write_report(report, arguments.json, result.verdict)
    return cli.PASSED if result.passed else cli.FAILED


main = cli.program(parser, command, __name__)
