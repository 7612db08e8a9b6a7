"""Show a robot from Python: `softdyn.show`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from softdyn.checks import array
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.view.live.channel import PATIENCE, Channel
from softdyn.view.page import Page, PlayedRun, Track, frames
from softdyn.view.scene import Figure


class View:
    """One robot in one pose: in a notebook below its cell, as a file, or live in the browser.

    Parameters
    ----------
    model : SoftModel
        The robot, at first at q = 0 without input.

    Attributes
    ----------
    model : SoftModel
        The robot.
    q, u : ndarray, (nq,), (nu,)
        The displayed configuration and input.
    url : str or None
        Address of the live page; None before `open`.

    Raises
    ------
    InputError
        If `model` is no model.
    UrdfError
        If a shape in the robot's file has an invalid number.
    """

    def __init__(self, model: SoftModel) -> None:
        self.model, self._figure = check_model(model), Figure.with_stated_tasks(model)
        self._server: Channel | None = None
        self._shown = 0
        self.display()

    def display(self, q: Any = None, u: Any = None) -> View:
        """Show the robot at q (nq,) with the cable tensions of the input u (nu,).

        The default is q = 0 without input. A page shown by `open` is updated at once.

        Raises
        ------
        InputError
            For arrays of another size and numbers that are not finite.
        """
        model = self.model
        self.q = model.q0 if q is None else array("q", q, (model.nq,))
        self.u = array("u", np.zeros(model.nu) if u is None else u, (model.nu,))
        self._push()
        return self

    @property
    def page(self) -> Page:
        """The displayed robot as a page that needs no server."""
        return self._page(self._frame(0.0), live=False)

    @property
    def url(self) -> str | None:
        """Address of the live page; None before `open` and after `close`."""
        return None if self._server is None else self._server.url

    def save(self, path: str | Path) -> None:
        """Write the page to a file, which needs neither a server nor a network.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        self.page.save(path)

    def open(self, port: int | None = None, browser: bool = True) -> View:
        """Serve the page on this machine only, and show it in the browser; `display` updates it.

        Parameters
        ----------
        port : int, optional
            Port of the page; by default a free one from 7000 on.
        browser : bool
            Whether to open the user's browser; `url` is the page's address.

        Raises
        ------
        InputError
            If the port is not free or not allowed.
        """
        if self._server is None:
            none = self._frame(0.0)[:0]
            self._server = Channel(self._page(none, live=True).html(), port=port)
            self._push()
        if browser:
            self._server.open()
        return self

    def close(self) -> None:
        """End the server; an open page keeps its last pose."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def __reduce_ex__(self, _protocol: Any) -> tuple[Any, ...]:
        return _restored, (self.model, self.q, self.u)  # a server cannot be copied

    def __repr__(self) -> str:
        y = self.model.state(self.q, np.zeros(self.model.nv)).y
        tip = " ".join(f"{x:.4f}" for x in y)
        ways = "open() shows it in the browser, save('FILE.html') writes it"
        return f"<view of {self.model.name!r}, tip at {tip} m: {ways}>"

    def _repr_html_(self) -> str:
        return self.page._repr_html_()

    def _page(self, rows: np.ndarray, live: bool) -> Page:
        run = PlayedRun("", (Track(0, rows, "", aims=False),))
        return Page(
            self.model.bundled or self.model.name, (self._figure,), (run,), live, sliders=True
        )

    def _push(self) -> None:
        """Send the pose to the live page, a little later on its timeline than the one before."""
        if self._server is not None:
            self._shown += 1
            self._server.frame(self._frame(0.1 * self._shown), PATIENCE)

    def _frame(self, t: float) -> np.ndarray:
        y = self.model.state(self.q, np.zeros(self.model.nv)).y[None]
        none = np.full((1, self._figure.numbers), np.nan)
        return frames(self.model, [t], self.q[None], self.u[None], y, y, none)


def show(model: SoftModel, q: Any = None, u: Any = None) -> View:
    """A view of a robot at q (nq,) with the input u (nu,): see `View`.

    Raises
    ------
    InputError
        If `model` is no model, for arrays of another size, and for numbers that are not finite.
    """
    return View(model).display(q, u)


def _restored(model: SoftModel, q: np.ndarray, u: np.ndarray) -> View:
    return View(model).display(q, u)
