#!/usr/bin/env python3
"""Make the README's picture: finger, helix and spirob on their targets, drawn by the viewer."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import BinaryIO

from softdyn.commands import cli

EPILOG = """\
Each robot runs a set point of the paper with Soft ID-CLF-QP; what is shown is the end of the run,
its replay drawn by Chromium without a window.

exit codes: 0 written; 2 bad input, or no Chromium.
"""
SHOWN = (("finger", 0.5), ("helix", 0.5), ("spirob", 0.5))  # and θ in multiples of π
NAMES = ("chromium", "chromium-browser", "google-chrome")
SIZE = 540  # pixels of each picture, a square
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--no-first-run", "--hide-scrollbars",
    "--force-device-scale-factor=1", "--virtual-time-budget=4000", f"--window-size={SIZE},{SIZE}",
)  # fmt: skip


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--out", default="docs/robots.png", metavar="FILE", help="%(default)s")


def command(arguments: cli.Arguments) -> int:
    """Run the loops, draw their ends, write one picture."""
    import softdyn
    from softdyn.controllers import SoftIdClfQp
    from softdyn.validation import simulate
    from softdyn.validation.files import atomic
    from softdyn.validation.report.replay import replay
    from softdyn.validation.studies import paper

    cli.check_outputs(arguments.out)
    browser = next((path for name in NAMES if (path := shutil.which(name))), None)
    if browser is None:
        raise softdyn.InputError("pictures", "Chromium (apt-get install chromium)", "none")
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for robot, theta in SHOWN:
            model = softdyn.load(robot)
            log = simulate(model, SoftIdClfQp(model), paper.set_point(robot, theta), progress=True)
            page = Path(folder) / f"{robot}.html"
            page.write_text(replay(log, model).html(), encoding="utf-8")
            files.append(screenshot(browser, page, f"bare&t={log.t[-1]:g}"))
        with atomic(arguments.out) as stream:
            side_by_side(files, stream)
    print(arguments.out)
    return cli.PASSED


def screenshot(browser: str, page: Path, state: str) -> Path:
    """A picture of a page at a moment of its run."""
    target = page.with_suffix(".png")
    profile = page.parent / "profile"
    url = f"{page.as_uri()}#{state}"
    subprocess.run(
        [browser, *FLAGS, f"--user-data-dir={profile}", f"--screenshot={target}", url],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    return target


def side_by_side(files: list[Path], stream: BinaryIO) -> None:
    """One PNG of pictures of equal height."""
    from PIL import Image

    pictures = [Image.open(file).convert("RGB").crop((0, 0, SIZE, SIZE)) for file in files]
    gap = 6
    whole = Image.new("RGB", (len(pictures) * (SIZE + gap) - gap, SIZE), "white")
    for i, picture in enumerate(pictures):
        whole.paste(picture, (i * (SIZE + gap), 0))
    whole.save(stream, "PNG", optimize=True)


main = cli.program(parser, command, __name__)
