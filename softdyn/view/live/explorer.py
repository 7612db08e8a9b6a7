"""Explore a robot's equilibria by slider: set the joints, or set inputs and see the equilibrium.

Nothing is simulated. New inputs lead to the equilibrium on the same branch as the one before. If
that branch has lost its stability, the page shows the equilibrium that the robot snaps to, and the
unstable one beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from time import sleep
from typing import Any

import numpy as np

from softdyn import statics
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError, SoftdynError
from softdyn.statics import Equilibrium
from softdyn.statics.branch import follow
from softdyn.statics.equilibria import ramp
from softdyn.view.live import messages
from softdyn.view.live.channel import PATIENCE, Channel
from softdyn.view.live.frames import Columns
from softdyn.view.live.messages import Limits, Message
from softdyn.view.live.pacing import IDLE
from softdyn.view.live.page import open_live_page
from softdyn.view.scene import Figure

PARTS = 4  # steps along the branch for one move of the sliders


class Explorer:
    """The pose that the sliders set.

    Parameters
    ----------
    model : SoftModel
        The robot.

    Attributes
    ----------
    q, u : ndarray, (nq,), (nu,)
        The pose and the inputs on the page.
    rest : Equilibrium or None
        The equilibrium under u; None while the user sets the joints.
    unstable : Equilibrium or None
        The equilibrium on the former branch, if it is unstable.
    notice : str
        The last error.
    """

    def __init__(self, model: SoftModel) -> None:
        self.model, self.columns = model, Columns(model, Figure.with_stated_tasks(model).numbers)
        self.q, self.u, self.notice = model.q0, np.zeros(model.nu), ""
        self.rest: Equilibrium | None = None
        self.unstable: Equilibrium | None = None
        self._poses = 0
        with suppress(SoftdynError):  # without an equilibrium the user can set joints only
            self._show(statics.rest(model))

    def apply(self, message: Message) -> None:
        """Carry out a message of a page.

        Raises
        ------
        InputError
            For a message that only a robot in motion can do.
        """
        self._poses += 1
        self.notice = ""
        if isinstance(message, messages.SetJoints):
            self.q, self.u = self.model.configuration(message.x), np.zeros(self.model.nu)
            self.rest = self.unstable = None
        elif isinstance(message, messages.SetInputs):
            try:
                self._load(message.u)
            except SoftdynError as error:
                self.notice = str(error)
        else:
            raise InputError("do", "joints or inputs", messages.NAMES[type(message)])

    def frame(self) -> np.ndarray:
        """The pose as a frame; its time counts the poses."""
        model, rest, other = self.model, self.rest, self.unstable
        y = model.state(self.q, np.zeros(model.nv)).y
        values: dict[str, Any] = {"t": self._poses, "q": model.coordinates(self.q), "u": self.u}
        values |= {"y": y, "y_ref": y}
        if rest is not None:
            values |= {"stable": rest.stable, "compliance": rest.tip_compliance.ravel()}
        if other is not None:
            gap = np.linalg.norm(other.y - y)
            values |= {"ghost": model.coordinates(other.q), "gap": gap}
        return self.columns.frame(**values)

    def _load(self, u: np.ndarray) -> None:
        """Go to the equilibrium under u (nu,), starting from the last one."""
        before = statics.rest(self.model) if self.rest is None else self.rest
        near = _along(before, u)
        other = near if self.unstable is None else _along(self.unstable, u)
        if near is None or not near.stable:
            near, _ = ramp(self.model, u, before)
        self._show(near)
        self.unstable = None if other is None or other.stable else other

    def _show(self, rest: Equilibrium) -> None:
        self.q, self.u, self.rest = rest.q, rest.u, rest


def _along(here: Equilibrium, u: np.ndarray) -> Equilibrium | None:
    """The equilibrium under u (nu,) on the branch of `here`; None if the branch ends before."""
    found: Equilibrium | None = here
    for part in np.linspace(0, 1, PARTS + 1)[1:]:
        if found is not None:
            found = follow(found, here.u + part * (u - here.u))
    return found


def open_explorer_page(
    model: SoftModel, port: int | None = None, origin: str | None = None
) -> Channel:
    """Serve the page of an explorer until the channel is closed; `origin` as of `Channel`."""
    figure, title = Figure.with_stated_tasks(model), model.bundled or model.name
    limits = Limits.of(model, (), figure.size)
    return open_live_page(figure, "explore", title=title, limits=limits, port=port, origin=origin)


def explore(model: SoftModel, channel: Channel, over: Callable[[], bool] = lambda: False) -> None:
    """Carry out the messages of an explorer's pages until `over()`, called many times a second."""
    explorer = Explorer(model)
    channel.frame(explorer.frame())
    while not over():
        channel.check()
        said = tuple(channel.messages())
        for i, message in enumerate(said):
            if i + 1 < len(said) and type(said[i + 1]) is type(message):
                continue  # only the last message of a drag counts
            try:
                explorer.apply(message)
            except InputError as error:
                channel.error(str(error))
        if said:
            channel.state({"notice": explorer.notice})
            channel.frame(explorer.frame(), PATIENCE)
        sleep(IDLE)
