"""Make the README's pictures: the robots on their targets; with --clip, softdyn play in motion."""

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
SHOWN = (("finger", 0.5), ("helix", 0.5), ("spirob", 0.5))  # robot, and θ in multiples of π
SIZE = 540  # pixels of each picture, a square
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--no-first-run", "--hide-scrollbars",
    "--force-device-scale-factor=1", "--virtual-time-budget=4000", f"--window-size={SIZE},{SIZE}",
)  # fmt: skip


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--out", default="docs/robots.png", metavar="FILE", help="%(default)s")
parser.output("--clip", "FILE", "instead, softdyn play in motion, as GIF")


def command(arguments: cli.Arguments) -> int:
    """Run the loops, draw their ends, write one picture."""
    import softdyn
    from softdyn.controllers import SoftIdClfQp
    from softdyn.validation import paper, simulate
    from softdyn.validation.files import atomic
    from softdyn.validation.loop.pictures.replay import replay

    if arguments.clip is not None:
        return film(arguments.clip)
    browser = shutil.which("chromium") or shutil.which("google-chrome")
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


def film(target: str) -> int:
    """Write a clip of `softdyn play`."""
    from PIL import Image

    from softdyn.validation.files import atomic
    from tests.proof.film.clip import COLOURS, RATE, clip

    pictures = clip()
    # octree keeps the colours of small objects such as arrows and targets
    palette = pictures[-1].quantize(COLOURS, method=Image.Quantize.FASTOCTREE)
    frames = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures]
    with atomic(target) as stream:
        frames[0].save(
            stream, "GIF", save_all=True, append_images=frames[1:], duration=round(1000 / RATE),
            loop=0, optimize=False,
        )  # fmt: skip
    print(target)
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
    """Join pictures of equal height into one PNG."""
    from PIL import Image

    pictures = [Image.open(file).convert("RGB").crop((0, 0, SIZE, SIZE)) for file in files]
    gap = 6
    whole = Image.new("RGB", (len(pictures) * (SIZE + gap) - gap, SIZE), "white")
    for i, picture in enumerate(pictures):
        whole.paste(picture, (i * (SIZE + gap), 0))
    whole.save(stream, "PNG", optimize=True)


main = cli.program(parser, command, __name__)
