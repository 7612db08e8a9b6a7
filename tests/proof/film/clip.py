"""A clip of `softdyn play`: the mouse drags the target, then a link, in a real page.

The page is the one that a user sees. Only its clock is replaced, so that the clip does not depend
on the speed of the machine.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from PIL import Image, ImageDraw

import softdyn
from softdyn.controllers.staged import Staged
from softdyn.validation import paper
from softdyn.validation.live.menu import menu_of
from softdyn.validation.live.playing import open_play_page
from softdyn.validation.live.session import Session
from softdyn.view.live import messages
from softdyn.view.live.channel import Channel
from tests.support.browser import Browser

SIZE = (960, 600)  # of the window (pixels)
SHOWN = (640, 400)  # of the picture
RATE = 6.0  # pictures a second
FRAMES = 5  # of the page for each of them
COLOURS = 200


def clip(robot: str = "finger") -> list[Image.Image]:
    """The pictures one after the other.

    Raises
    ------
    InputError
        Chromium is not installed.
    """
    model = softdyn.load(robot)
    session = Session(model, menu_of(model), Staged.name)
    start, end = (paper.setup_of(model).set_point(theta).reference(0.0).y for theta in (0.5, 1.0))
    session.apply(messages.SetTarget(start))
    for _ in range(round(1.5 / session.period)):
        session.step()
    with open_play_page(session) as channel, Browser() as browser:
        browser.open(channel.url, *SIZE)
        film = _Film(session, channel, browser)
        return list(film.scenes(np.asarray(start), np.asarray(end)))


class _Film:
    def __init__(self, session: Session, channel: Channel, browser: Browser) -> None:
        self._session, self._channel, self._browser = session, channel, browser
        self._mouse = [SIZE[0] / 2, SIZE[1] * 0.8]
        channel.state(vars(session.shown))
        browser.until("softdyn.leads")

    def scenes(self, start: np.ndarray, end: np.ndarray) -> Iterator[Image.Image]:
        """The scenes: the target is dragged and the tip follows; a link is pulled and released."""
        yield from self._wait(0.5)
        yield from self._drag(self._seen(start), self._seen(end), 1.2)
        yield from self._wait(1.5)
        link = self._browser.run("softdyn.scene.links.length - 3")
        place = f"new T.Vector3().setFromMatrixPosition(softdyn.figure.links[{link}].matrixWorld)"
        at = self._browser.run(f"softdyn.stage.worldToLocal({place}).toArray()")
        first, last = self._seen(at), self._seen(np.add(at, (0.16, 0.0, 0.05)))
        self._browser.key("o")  # open loop, so that no controller works against the pull
        yield from self._drag(first, last, 1.2, hold=0.8)
        yield from self._wait(1.5)

    def _wait(self, seconds: float) -> Iterator[Image.Image]:
        for _ in range(round(seconds * RATE)):
            yield self._picture()

    def _drag(
        self, first: list[float], last: list[float], seconds: float, hold: float = 0.0
    ) -> Iterator[Image.Image]:
        self._mouse = first
        self._browser.press(first)
        for part in np.linspace(0, 1, round(seconds * RATE)):
            self._mouse = [a + float(part) * (b - a) for a, b in zip(first, last, strict=True)]
            self._browser.move(self._mouse)
            yield self._picture()
        yield from self._wait(hold)
        self._browser.lift(self._mouse)

    def _picture(self) -> Image.Image:
        """The page a moment later, with the pointer."""
        time.sleep(0.05)  # messages of the page may still arrive
        session, steps = self._session, round(1 / RATE / FRAMES / self._session.period)
        for message in self._channel.messages():
            session.apply(message)
            self._channel.state(vars(session.shown))
        for _ in range(FRAMES):
            slowest = max(session.step() for _ in range(steps))
            self._channel.frame(session.frame(step_us=slowest, misses=0))
        here = f"softdyn.last && softdyn.one(softdyn.last, 't') > {session.t} - 1e-3"
        while not self._browser.run(here):  # the page drops frames that come too fast
            self._channel.frame(session.frame())
            time.sleep(0.02)
        self._browser.run("softdyn.plot()")
        picture = Image.fromarray(self._browser.pixels().astype(np.uint8))
        x, y = self._mouse
        pen = ImageDraw.Draw(picture)
        pen.polygon([(x, y), (x, y + 17), (x + 4, y + 13), (x + 12, y + 12)], "white", "black")
        return picture.resize(SHOWN, Image.Resampling.LANCZOS)

    def _seen(self, point: object) -> list[float]:
        """The place in the window of a point (3,) of the world."""
        found: list[float] = self._browser.run(
            "(p => [(p.x + 1) / 2 * innerWidth, (1 - p.y) / 2 * innerHeight])"
            f"(softdyn.stage.localToWorld(new T.Vector3(...{np.asarray(point).tolist()}))"
            ".project(softdyn.viewer.camera))"
        )
        return found
