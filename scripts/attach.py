#!/usr/bin/env python3
"""Attach an arm to a link of another robot: both become one file."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

EPILOG = """\
ARM and BASE are URDFs, TOML files as `softdyn new` reads them, or names of robots. The new file has
links, joints, shapes, springs, cables, motors, sensors and tasks of both. Its tip is the arm's.
Meshes outside the folder of the new file are copied to its folder meshes/.

--at places the arm's root link in the frame of LINK. With R = 3.14159 an arm that hangs down in its
own file points along the z axis of LINK.

A name must not occur in both robots: --prefix stands before each name of the arm.

exit codes: 0 written; 2 bad input, nothing written.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("arm", metavar="ARM", help="the robot that is attached")
parser.add_argument(
    "--to", nargs=2, metavar=("BASE", "LINK"), required=True, help="the other robot, and its link"
)
parser.add_argument(
    "--at", type=cli.finite, nargs=6, metavar=("X", "Y", "Z", "R", "P", "Y"), default=[0.0] * 6,
    help="position (m), roll, pitch and yaw (rad) of the arm on LINK (default: zeros)",
)  # fmt: skip
parser.add_argument("--prefix", metavar="P", default="", help="text before each name of the arm")
parser.add_argument("--annotations", metavar="FILE", help=f"{cli.BLOCK}, for BASE")
parser.add_argument("--arm-annotations", metavar="FILE", help=f"{cli.BLOCK}, for ARM")
parser.output("--out", "URDF", "file to write or replace", required=True)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Join the two robots, check the result, and write its file and meshes."""
    import warnings

    from softdyn import design
    from softdyn.description.library import find
    from softdyn.description.urdf import parse
    from softdyn.design.attachment import JOINED
    from softdyn.loading import load_text

    (base, link), out = arguments.to, Path(arguments.out)
    arm, below = (
        source if block is None else parse(find(source), annotations=block)
        for source, block in (
            (arguments.arm, arguments.arm_annotations), (base, arguments.annotations),
        )
    )  # fmt: skip
    made = design.attach(
        arm, below, link, arguments.at, prefix=arguments.prefix, name=out.stem, folder=out.parent
    )
    # refuse a robot that `softdyn.load` would refuse, before writing
    for warning in load_text(made.text, path=out).robot.warnings:
        warnings.warn(warning, stacklevel=2)
    cli.write_design(made, out, JOINED)
    cli.report_design(made, out, arguments.json)
    return cli.PASSED


main = cli.program(parser, command, __name__)
