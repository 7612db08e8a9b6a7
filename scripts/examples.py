#!/usr/bin/env python3
"""Copy the examples into a folder: overlays, gains, a sweep, a controller, and a tour."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

EPILOG = """\
DIR is created if it does not exist. Existing files in it are never overwritten.

exit codes: 0 copied; 2 bad input, nothing copied.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("dir", metavar="DIR", type=Path)


def command(arguments: cli.Arguments) -> int:
    """Copy all files, or none."""
    import softdyn
    from softdyn.validation.files import write_text

    folder = Path(softdyn.__file__).parent / "examples"
    sources = sorted(path for path in folder.iterdir() if path.is_file())
    cli.make_folder(arguments.dir)
    for source in sources:
        if (arguments.dir / source.name).exists():
            expected = "a folder without files of our examples' names"
            raise softdyn.InputError(str(arguments.dir), expected, source.name)
    for source in sources:
        write_text(arguments.dir / source.name, source.read_text(encoding="utf-8"))
        print(arguments.dir / source.name)
    cli.say(f"first: python {arguments.dir / 'tour.py'}")
    return cli.PASSED


main = cli.program(parser, command, __name__)
