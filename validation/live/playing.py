"""A robot to play with: a session with its pages and its clock."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from time import perf_counter, sleep
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.controllers.safety_filter import with_barriers
from softdyn.safety import Surroundings
from softdyn.tasks.task import Task
from softdyn.validation.live.menu import Make, menu_of
from softdyn.validation.live.session import Session
from softdyn.validation.loop.arguments import name_of
from softdyn.validation.twin.rig import Rig
from softdyn.view.live.channel import Channel
from softdyn.view.live.messages import OPEN_LOOP, SetController
from softdyn.view.live.pacing import IDLE, RATE, Clock, ClockStatistics
from softdyn.view.live.page import open_live_page
from softdyn.view.scene import Figure

HELD, ROOM = 0.95, 0.9  # pace of a period that is held; share of the time that work may take
LONG = 5e-3  # s; if messages take longer, the clock starts anew


def open_play_page(session: Session, port: int | None = None, origin: str | None = None) -> Channel:
    """Serve the page of a session until the channel is closed.

    Parameters
    ----------
    session : Session
        The session that will run.
    port : int, optional
        By default a free one from 7000 on.
    origin : str, optional
        As of `Channel`.
    """
    model = session.model
    return open_live_page(
        figure_of(session), "play", title=model.bundled or model.name,
        limits=session.limits, port=port, period=session.period, pull=session.pull,
        estimates=session.estimates, origin=origin,
    )  # fmt: skip


def figure_of(session: Session) -> Figure:
    """The robot of a session with its tasks and the obstacles around it."""
    figure = Figure.of(session.model, session.limits.marks)
    return figure.with_scenery(session.surroundings)


def period_note(period: float, clock: ClockStatistics) -> str:
    """A note about a control period (s) that the machine cannot hold, with one that it can hold."""
    if clock.pace >= HELD:
        return ""
    step = 1e-6 * clock.step_us["median"]
    plant = 1 / clock.pace - step / period  # s of work in a simulated second
    text = f"{clock.pace:.2f} of real time at a control period of {1e3 * period:g} ms"
    longer = math.ceil(1e3 * step / (ROOM - plant)) if plant < ROOM else 0
    if longer <= 1e3 * period:
        return f"{text}: no longer period helps, a second of the plant alone takes {plant:.2f} s"
    return f"{text}: this machine holds --period {longer / 1e3:g}"


def drive(
    session: Session,
    channel: Channel,
    clock: Clock,
    over: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] | None = None,
) -> None:
    """Run a session until `over`, at the pace of its clock; pages never delay it.

    Parameters
    ----------
    session : Session
        The session.
    channel : Channel
        Channel to its pages.
    clock : Clock
        The clock that sets its pace.
    over : callable
        Asked once a period, and at least every 20 ms.
    say : callable, optional
        Gets the traceback of an error in a user's own code, and `period_note` where there is one,
        after the periods that the clock keeps.

    Raises
    ------
    SoftdynError
        The pages' server has ended.
    """
    clock.begin()
    while not over():
        channel.check()
        began = perf_counter()
        heard = _listen(session, channel)
        if say is not None and session.trace:
            say(f"an error in your own code pauses the robot\n{session.trace}")
            session.trace = ""
        if session.changed:
            session.changed = False
            clock.speed = session.shown.speed
            channel.state(asdict(session.shown))
        if session.shown.paused:
            if clock.frame(RATE) or heard:
                channel.frame(session.frame(misses=clock.misses, pace=0.0))
            sleep(IDLE)
            clock.begin()
            continue
        if heard and perf_counter() - began > LONG:
            clock.begin()  # the time to make a controller or a plant is no control step
        if not clock.wait(IDLE):
            continue
        clock.done(session.step())
        if say is not None and clock.periods == clock.keep:
            note = period_note(session.period, clock.statistics())
            if note:
                say(note)
        if clock.frame(RATE):
            channel.frame(
                session.frame(
                    misses=clock.misses, pace=clock.pace, step_us=clock.worst_step,
                    wake_us=clock.worst_wake,
                )
            )  # fmt: skip
            clock.worst_step = clock.worst_wake = 0.0


def _listen(session: Session, channel: Channel) -> bool:
    """Obey the pages' messages since the last call; return True if there were any."""
    heard = False
    for message in channel.messages():
        heard = True
        try:
            if isinstance(message, SetController):
                # it may compile, so the robot stands still and the page says why
                busy = f"starting {message.name}: the robot stands still meanwhile"
                channel.state({**asdict(session.shown), "busy": busy})
                session.changed = True
            session.apply(message)
        except InputError as error:
            channel.error(str(error))
            session.changed = True  # the page shows the refused value: send the true one
        except Exception as error:  # a user's class may fail in its constructor
            channel.error(f"{type(error).__name__}: {error}"[:300])
            session.changed = True
    return heard


class Play:
    """A robot that runs in the background, with a page to play with it.

    A notebook displays its page. A context manager; `stop` ends it.

    Parameters
    ----------
    model : SoftModel
        The robot.
    controller : Controller, optional
        Any controller; by default the menu's `law`.
    name : str, optional
        Its name in the menu; its own name or its class by default.
    law : str
        The first entry of the menu, if no controller is given.
    period : float, optional
        Control period (s).
    target : array_like, (3,), optional
        The first target (m).
    rig : Rig or str, optional
        The rig between controller and plant, as in `ClosedLoop`.
    tasks : sequence of Task
        Tasks of links' frames to drag, which the menu's controllers get; by default the tip's
        position. A `controller` has its own.
    surroundings : Surroundings, optional
        Obstacles in plant and page, of which all controllers keep clear.
    port : int, optional
        By default a free one from 7000 on.
    """

    def __init__(
        self,
        model: SoftModel,
        controller: Any = None,
        *,
        name: str | None = None,
        law: str | None = None,
        period: float | None = None,
        target: Any = None,
        rig: Rig | str | None = None,
        tasks: Sequence[Task] = (),
        surroundings: Surroundings | None = None,
        port: int | None = None,
    ) -> None:
        own: dict[str, Make] = {}
        if controller is not None:
            law = name or name_of(controller)
            own[law] = with_barriers(lambda _model, **_tasks: controller, surroundings)
        menu = menu_of(model, own, surroundings)
        self.session = Session(
            model, menu, law or OPEN_LOOP, period=period, target=target, rig=rig, tasks=tasks,
            surroundings=surroundings,
        )  # fmt: skip
        self._channel = open_play_page(self.session, port)
        self.url = self._channel.url
        self._over, self._closed = threading.Event(), False
        self._thread: threading.Thread | None = None
        self.start()

    def __enter__(self) -> Play:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def __reduce__(self) -> Any:
        raise TypeError("a running robot cannot be copied: call play again")

    def start(self) -> None:
        """Let the robot run; no effect if it runs.

        Raises
        ------
        InputError
            It was closed, so there is no page.
        """
        if self._closed:
            raise InputError("start", "a robot whose page is still served", "one that is closed")
        if self._thread is None or not self._thread.is_alive():
            self._over.clear()
            clock = Clock(self.session.period)
            self._thread = threading.Thread(
                target=drive, args=(self.session, self._channel, clock, self._over.is_set),
                name="play", daemon=True,
            )  # fmt: skip
            self._thread.start()

    def stop(self) -> None:
        """Pause the robot; `start` continues."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """Stop, and end the page's server."""
        self.stop()
        self._closed = True
        self._channel.close()

    def _repr_html_(self) -> str:
        """The page inside a notebook."""
        return f'<iframe src="{self.url}" style="width:100%;height:720px;border:0"></iframe>'


def play(model: SoftModel, controller: Any = None, **options: Any) -> Play:
    """A robot in real time with a page to play with it; see `Play` for the arguments.

    Returns
    -------
    Play
        It runs until its `close`. A notebook shows its page as a cell's value.
    """
    return Play(model, controller, **options)
