#!/usr/bin/env python3
"""Write a robot's file from a table of its sections, material and cables; or copy the examples."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

SEGMENTS, TOLERANCE = (5, 10, 20, 40, 80), 1e-3
EPILOG = """\
FILE is TOML with a [material], one [[section]] or more, and [[cable]]s; or a preset, [log_spiral]
or [finger]. Every key ends in its unit: length_mm, youngs_modulus_MPa. docs/design.md lists them.

--converge writes nothing. It tells how many joints the arm needs: it measures its sag, its
frequencies and its shape under a cable with several numbers of joints. Errors are relative to the
limit that is extrapolated from the finest arms; for tips they are relative to the arm's length.

--examples DIR copies the examples: overlays, gains, a sweep, a controller, a tour. DIR is created
if it does not exist. Existing files in it are never overwritten.

exit codes: 0 done; 2 bad input, nothing written.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("file", metavar="FILE", nargs="?", help="TOML")
parser.output(
    "--out", "URDF",
    "file to write or replace (default: FILE with .urdf, unless another program wrote that)",
)  # fmt: skip
parser.add_argument("--converge", action="store_true", help="how many joints does the arm need?")
parser.add_argument(
    "--segments", type=cli.count, nargs="+", metavar="N",
    help="of --converge: joints in each section (default: 5 10 20 40 80)",
)  # fmt: skip
parser.add_argument(
    "--tolerance", type=cli.positive, metavar="X",
    help=f"of --converge: allowed relative error (default: {TOLERANCE:g})",
)  # fmt: skip
parser.add_argument("--examples", metavar="DIR", type=Path, help="copy the examples into DIR")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Write a file, measure an arm, or copy the examples."""
    from softdyn import InputError

    if (arguments.file is None) == (arguments.examples is None):
        got = "neither" if arguments.file is None else "both"
        raise InputError("FILE", "a TOML file, or --examples DIR", got)
    if not arguments.converge and (arguments.segments or arguments.tolerance):
        raise InputError("--segments, --tolerance", "--converge to go with them", "none")
    if arguments.examples is not None:
        return copy_examples(arguments)
    return converge(arguments) if arguments.converge else write(arguments)


def write(arguments: cli.Arguments) -> int:
    """Read the table, check it, and write the robot's file and its meshes."""
    from softdyn import InputError, design
    from softdyn.design.chain import GENERATED
    from softdyn.loading import load_text

    table = cli.read_toml(arguments.file)
    out = Path(arguments.out or Path(arguments.file).with_suffix(".urdf"))
    if arguments.out is None:
        cli.check_outputs(parser, arguments, out)
    if arguments.out is None and not cli.is_own(out, GENERATED):
        raise InputError(str(out), "no file, or --out to replace it", "a file of another program")
    made = design.read(table, arguments.file)
    # refuse a robot that `softdyn.load` would refuse, before writing
    load_text(made.text, path=out)
    cli.write_design(made, out, GENERATED)
    cli.report_design(made, out, arguments.json)
    return cli.PASSED


def converge(arguments: cli.Arguments) -> int:
    """Measure the arm with several numbers of joints, extrapolate and report."""
    from softdyn import InputError, design
    from softdyn.validation.rods import convergence

    if arguments.out is not None:
        raise InputError("--out", "none: --converge writes no file", arguments.out)
    arm = design.make_arm(cli.read_toml(arguments.file), arguments.file)
    counts, tolerance = arguments.segments or SEGMENTS, arguments.tolerance or TOLERANCE
    found = convergence.converge(arm, counts, tolerance)
    report = {"file": arguments.file, "name": arm.name, **found.to_dict()}
    cli.write_report(report, arguments.json, str(found))
    return cli.PASSED


def copy_examples(arguments: cli.Arguments) -> int:
    """Copy all files of the examples, or none."""
    import softdyn
    from softdyn.validation.files import write_text

    for name, given in (("--converge", arguments.converge), ("--out", arguments.out)):
        if given:
            raise softdyn.InputError(name, "a FILE to go with it", "--examples")
    target, folder = arguments.examples, Path(softdyn.__file__).parent / "examples"
    sources = sorted(path for path in folder.iterdir() if path.is_file())
    cli.make_folder(target)
    for source in sources:
        if (target / source.name).exists():
            expected = "a folder without files of our examples' names"
            raise softdyn.InputError(str(target), expected, source.name)
    for source in sources:
        write_text(target / source.name, source.read_text(encoding="utf-8"))
    copied = [str(target / source.name) for source in sources]
    text = "\n".join([*copied, f"first, in Jupyter: {target / 'tour.ipynb'}"])
    cli.write_report({"files": copied}, arguments.json, text)
    return cli.PASSED


main = cli.program(parser, command, __name__)
