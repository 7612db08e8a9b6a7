"""The gallery of docs/index.md and the picture of docs/attach.md: run, write replays, take stills.

The page itself says what is run: after a picture `gallery/NAME.png` come a file to save, where one
is needed, and commands, of which the last writes `NAME.html`. What a person does with the mouse in
`softdyn play` is done here by the messages that the mouse would send.
"""

from __future__ import annotations

import pickle
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softdyn.commands import cli

if TYPE_CHECKING:
    from PIL.Image import Image

    from softdyn import SoftModel
    from softdyn.validation.live.session import Session
    from tests.support.browser import Browser

EPILOG = """\
The commands run in an empty folder, which is deleted afterwards. Each replay goes to --out.
--stills takes a picture of each replay at its moment, drawn by Chromium without a window.

exit codes: 0 written; 2 bad input, a command that failed, or no Chromium.
"""
DOCS = Path(__file__).parents[2] / "docs"
INDEX, ATTACH = DOCS / "index.md", DOCS / "attach.md"
SECTION = re.compile(r"^!\[[^\]]*\]\(gallery/(\w+)\.png\)$", re.M)
BLOCK = re.compile(
    r"(?:Save as `([^`]+)`:?\n+)?(<!-- not run: [^\n]+ -->\n)?```(\w*)\n(.*?)^```$", re.M | re.S
)
SIZE, SHOWN = (960, 800), (480, 400)  # of the window, of the picture (pixels)


@dataclass(frozen=True)
class Entry:
    """One replay of the gallery.

    Attributes
    ----------
    name : str
        Its name, of the picture and of the page.
    files : tuple of (str, str)
        Files to save, and their texts.
    commands : tuple of str
        Lines for a shell, none where a person plays.
    """

    name: str
    files: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]


@dataclass(frozen=True)
class Shot:
    """The moment of a still (s), and the run of the page.

    With `whole` the camera sees the trail too, and with `card` the picture has the page's legend.
    """

    t: float
    run: int = 0
    whole: bool = False
    card: bool = False


SHOTS = {
    "table": Shot(5.0),
    "dragged": Shot(2.0, whole=True),
    "push": Shot(1.9),
    "cables": Shot(1.0),
    "design": Shot(1.9, whole=True),
    "rig": Shot(0.1, card=True),
    "compare": Shot(4.0, run=1, card=True),
    "obstacles": Shot(0.26, whole=True, card=True),
    "attached": Shot(2.5),
}

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--out", default="build/gallery", metavar="DIR", help="%(default)s")
parser.add_argument("--stills", metavar="DIR", help="docs/gallery: the pictures of the page")
parser.add_argument("--only", nargs="+", choices=list(SHOTS), metavar="NAME", help="some of them")


def command(arguments: cli.Arguments) -> int:
    """Run, write, draw."""
    from softdyn.validation.files import atomic

    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    for entry in entries():
        if arguments.only is None or entry.name in arguments.only:
            (out / f"{entry.name}.html").write_text(replay(entry), encoding="utf-8")
            print(out / f"{entry.name}.html", flush=True)
    if arguments.stills is not None:
        from tests.support.browser import Browser

        with Browser() as browser:
            for name in arguments.only or SHOTS:
                picture = still(browser, out / f"{name}.html", SHOTS[name])
                with atomic(str(Path(arguments.stills) / f"{name}.png")) as stream:
                    picture.save(stream, "PNG", optimize=True)
    return cli.PASSED


def entries(*pages: Path) -> Iterator[Entry]:
    """The replays of some pages, or of all, in their order."""
    for page in pages or (INDEX, ATTACH):
        yield from _entries(page)


def _entries(page: Path) -> Iterator[Entry]:
    text = page.read_text(encoding="utf-8")
    found = [*SECTION.finditer(text)]
    for one, after in zip(found, [*found[1:], None], strict=True):
        end = after.start() if after else len(text)
        rest = text[one.end() : end]
        part = rest.partition("\n## ")[2 if page == ATTACH else 0].partition("\n## ")[0]
        files, commands = [], []
        for name, mark, kind, code in BLOCK.findall(part):
            if name:
                files.append((name, code))
            elif kind == "sh" and not mark:
                commands += code.splitlines()
        yield Entry(one[1], tuple(files), tuple(commands))


def replay(entry: Entry) -> str:
    """The page that its commands write.

    Raises
    ------
    InputError
        A command failed, or none wrote the page.
    """
    from softdyn import InputError

    if not entry.commands:
        return PLAYED[entry.name]()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, text in entry.files:
            (folder / name).write_text(text, encoding="utf-8")
        # a shell, because a line may end with `> FILE`; softdyn is the one that runs this
        ours = f'softdyn() {{ {shlex.quote(sys.executable)} -m softdyn.commands "$@"; }}'
        for line in entry.commands:
            done = subprocess.run(
                ["bash", "-c", f"{ours}\n{line}"], cwd=folder, text=True, capture_output=True,
                check=False,
            )  # fmt: skip
            if done.returncode:
                raise InputError(entry.name, f"exit code 0 of {line}", done.stderr.strip()[-300:])
        written = folder / f"{entry.name}.html"
        if not written.is_file():
            raise InputError(entry.name, f"a command that writes {entry.name}.html", "none")
        return written.read_text(encoding="utf-8")


# -- played by hand -------------------------------------------------------------------------------


def dragged(robot: str = "finger", seconds: float = 4.0) -> str:
    """`softdyn play`: the target is dragged along half of the paper's ellipse and back."""
    from softdyn.validation import paper
    from softdyn.view.live.messages import SetTarget

    def hand(session: Session, t: float) -> None:
        turn = 0.5 + 0.6 * np.sin(np.pi * t / 4) ** 2
        goal = paper.set_point(robot, float(turn)).reference(0.0).y
        session.apply(SetTarget(goal))

    return _recorded(robot, seconds, hand)


def pushed(robot: str = "spirob", seconds: float = 4.0) -> str:
    """`softdyn play`: a link is pulled aside, held for a second, and released."""
    from softdyn.view.live.messages import Push, Release

    def hand(session: Session, t: float) -> None:
        model, link = session.model, _low(session.model)
        at = model.link_poses(model.q0)[link][:3, 3]
        if t < 0.5:
            return
        if t < 2.0:
            way = min(1.0, (t - 0.5) / 0.6) * np.array([0.7, 0.0, 0.1]) * model.robot.length
            session.apply(Push(link, np.zeros(3), at + way))
        else:
            session.apply(Release())

    return _recorded(robot, seconds, hand)


PLAYED: dict[str, Callable[[], str]] = {"dragged": dragged, "push": pushed}


def _low(model: SoftModel) -> str:
    """The link whose frame is nearest to two thirds of the way from base to tip at rest."""
    poses = model.link_poses(model.q0)
    first, last = (poses[model.robot.links[k].name][:3, 3] for k in (0, -1))
    place = first + 2 / 3 * (last - first)
    return min(poses, key=lambda name: float(np.linalg.norm(poses[name][:3, 3] - place)))


def _recorded(robot: str, seconds: float, hand: Callable[[Session, float], None]) -> str:
    """The recording of a session that a hand acts on before each frame."""
    import softdyn
    from softdyn.validation.live.menu import menu_of
    from softdyn.validation.live.playing import figure_of
    from softdyn.validation.live.session import Session
    from softdyn.view.live.pacing import RATE
    from softdyn.view.live.recording import Recording

    model = softdyn.load(robot)
    session = Session(model, menu_of(model), "best")
    recording = Recording(pickle.dumps(figure_of(session)), session.columns.replayed, robot)
    recording.begin()
    steps = max(1, round(1 / RATE / session.period))
    while session.t < seconds:
        hand(session, session.t)
        for _ in range(steps):
            session.step()
        recording.add(session.frame().tobytes())
    recording.end()
    return recording.html()


# -- stills ---------------------------------------------------------------------------------------

# the corners of all shapes at this moment, the targets and, if asked, the trails: what is in sight
FIT = """
(() => {
  const points = [];
  for (const track of softdyn.tracks) {
    const shift = new T.Vector3(...track.offset);
    points.push(...track.figure.corners().map(point => point.add(shift)));
    if (track.aims) points.push(track.target.position.clone().add(shift));
    if (track.pull && track.newtons) points.push(track.pull.end.clone().add(shift));
    if (WHOLE) for (const frame of track.frames) for (const back of [6, 3])
      points.push(new T.Vector3(...track.vector(frame, back)).add(shift));
  }
  softdyn.axes.object.visible = CARD;
  fitCamera(softdyn.viewer, points, ROOM, SHIFT);
  return points.length;
})()
"""


def still(browser: Browser, page: Path, shot: Shot) -> Image:
    """The picture of a replay at its moment, with the arm as large as the picture.

    Raises
    ------
    InputError
        The moment is after the end of the run.
    """
    from PIL import Image

    from softdyn import InputError

    state = f"t={shot.t:g}&run={shot.run}" + ("" if shot.card else "&bare")
    browser.open(f"{page.resolve().as_uri()}#{state}", *SIZE)
    end = browser.run("softdyn.duration")
    if not 0 <= shot.t <= end:
        raise InputError(page.name, f"a moment of the run, up to {end:g} s", shot.t)
    room, shift = ("[0.7, 0.86]", "[0.26, 0.04]") if shot.card else ("[0.9, 0.9]", "[0, 0]")
    fit = FIT.replace("WHOLE", str(shot.whole).lower()).replace("ROOM", room)
    fit = fit.replace("CARD", str(shot.card).lower())
    browser.run(fit.replace("SHIFT", shift))
    picture = Image.fromarray(browser.pixels().astype(np.uint8))
    return picture.resize(SHOWN, Image.Resampling.LANCZOS)


main = cli.program(parser, command, __name__)
