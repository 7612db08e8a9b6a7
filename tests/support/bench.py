"""The arm of the bench, its served rig on a clock of its own, and a driver without a socket."""

from __future__ import annotations

import json

import numpy as np

from softdyn import SoftModel
from softdyn.validation.bench.clock import TimeSource
from softdyn.validation.bench.served import ServedRig
from tests.support.robots import BENCH, build


def bench_arm() -> SoftModel:
    return build(BENCH)


class Hands:
    """A clock that moves only when somebody sleeps on it, or by `pass_`."""

    def __init__(self) -> None:
        self.time = 100.0
        self.source = TimeSource(lambda: self.time, self.pass_)

    def pass_(self, seconds: float) -> None:
        self.time += seconds


class Tower:
    """The clock and the served rig that all drivers of a test share."""

    hands: Hands
    rig: ServedRig
    stops = starts = 0


class NearDriver:
    """A driver that asks a `ServedRig` of this process; each test sets `tower`."""

    tower: Tower

    def __init__(self, model: SoftModel) -> None:
        self.open = False

    def start(self) -> None:
        self.open, self.tower.starts = True, self.tower.starts + 1

    def read(self):
        return self.tower.rig.advance()

    def send(self, commands: np.ndarray) -> None:
        assert self.open
        self.tell({"send": commands.tolist()})

    def stop(self) -> None:
        self.open, self.tower.stops = False, self.tower.stops + 1
        self.tell({"stop": True})

    def tell(self, message: object) -> None:
        assert self.tower.rig.obey(json.dumps(message)) is None


def tower(model: SoftModel) -> Tower:
    """A served rig whose clock moves by hand; drivers made from now on are its own."""
    made = Tower()
    made.hands = Hands()
    made.rig = ServedRig(model, clock=made.hands.source.now)
    NearDriver.tower = made
    return made
