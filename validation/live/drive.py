"""A session on a clock, in front of pages: the loop of `softdyn play`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from time import perf_counter, sleep

from softdyn import InputError
from softdyn.validation.live.channel import Channel
from softdyn.validation.live.pacing import Clock
from softdyn.validation.live.session import Session

RATE = 40.0  # frames a second of a clock
LONG = 5e-3  # s that messages may take before the clock starts anew
IDLE = 0.02  # s between two looks at the messages while the robot is paused


def drive(
    session: Session, channel: Channel, clock: Clock, over: Callable[[], bool] = lambda: False
) -> None:
    """Run a session until `over`, as fast as its clock says; pages never delay it.

    Parameters
    ----------
    session : Session
        What runs.
    channel : Channel
        To its pages.
    clock : Clock
        Its pace.
    over : callable
        Asked once a period.
    """
    clock.begin()
    while not over():
        heard, began = False, perf_counter()
        try:
            for message in channel.messages():
                heard = True
                session.apply(message)
        except InputError as error:
            channel.error(str(error))
        except Exception as error:  # a user's class that cannot even be made
            channel.error(f"{type(error).__name__}: {error}"[:300])
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
            clock.begin()  # making a controller or a plant is no control step
        clock.wait()
        clock.done(session.step())
        if clock.frame(RATE):
            channel.frame(
                session.frame(
                    misses=clock.misses, pace=clock.pace, step_us=clock.worst_step,
                    wake_us=clock.worst_wake,
                )
            )  # fmt: skip
            clock.worst_step = clock.worst_wake = 0.0
