#!/usr/bin/env python3
"""Write a robot's file from a table of its sections, material and cables."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

EPILOG = """\
FILE is TOML with a [material], one [[section]] or more, and [[cable]]s; or a preset, [log_spiral]
or [finger]. Every key ends in its unit: length_mm, youngs_modulus_MPa. docs/design.md lists them.

exit codes: 0 written; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("file", metavar="FILE", help="TOML")
parser.output(
    "--out", "URDF",
    "file to write or replace (default: FILE with .urdf, unless another program wrote that)",
)  # fmt: skip
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Read, check and write."""
    from softdyn import InputError, design
    from softdyn.design.chain import GENERATED
    from softdyn.loading import load_text
    from softdyn.validation.files import atomic

    table = cli.read_toml(arguments.file)
    out = Path(arguments.out or Path(arguments.file).with_suffix(".urdf"))
    if arguments.out is None:
        cli.check_outputs(parser, arguments, out)
    own = not out.is_file() or GENERATED.encode() in out.read_bytes()
    if arguments.out is None and not own:
        raise InputError(str(out), "no file, or --out to replace it", "a file of another program")
    made = design.read(table, arguments.file)
    for name, content in made.meshes.items():
        there = out.parent / name
        if there.is_file() and there.read_bytes() != content and not (own and out.is_file()):
            raise InputError(str(there), "no file, or the mesh that this command writes", "another")
    # refuse a robot that `softdyn.load` would refuse, before writing
    load_text(made.text, path=out)
    for name, content in {**made.meshes, out.name: made.text.encode()}.items():
        cli.make_folder((out.parent / name).parent)
        with atomic(out.parent / name) as file:
            file.write(content)
    report = {"file": str(out), "name": made.name, **made.figures}
    figures = ", ".join(f"{name} {value:.4g}" for name, value in made.figures.items())
    cli.write_report(report, arguments.json, f"{out}: {figures}")
    return cli.PASSED


main = cli.program(parser, command, __name__)
