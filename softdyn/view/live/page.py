"""The page of a live robot; all its assets are inside, so it works without a network."""

from __future__ import annotations

import pickle
from functools import partial

import numpy as np

from softdyn.view.live.channel import Channel
from softdyn.view.live.frames import Columns
from softdyn.view.live.messages import OPEN_LOOP, Limits
from softdyn.view.live.recording import Recording
from softdyn.view.page import asset, scene_page
from softdyn.view.scene import TENSION, Figure


def open_live_page(
    figure: Figure, mode: str, *, title: str, limits: Limits | None = None,
    port: int | None = None, period: float = 0.0, pull: float = 1.0,
    path: np.ndarray | None = None, estimates: bool = False, origin: str | None = None,
) -> Channel:  # fmt: skip
    """Serve the page of a live robot until the channel is closed.

    Parameters
    ----------
    figure : Figure
        The robot.
    mode : str
        ``play``, ``watch`` (a run without control by the page) or ``explore`` (joints and inputs).
    title : str
        The heading, and the title of recordings.
    limits : Limits, optional
        Limits of the messages, and the menu of controllers; without, the page only watches.
    port : int, optional
        By default a free one from 7000 on.
    period : float
        Control period (s).
    pull : float
        Force (N) of the longest arrow.
    path : ndarray, (K, 3), optional
        The reference's path.
    estimates : bool
        Whether the ghost is an observer's estimate, and not the model beside the plant.
    origin : str, optional
        As of `Channel`.

    Raises
    ------
    InputError
        If Meshcat is not installed, the port is taken or the server does not start.
    """
    model = figure.model
    columns, drawn = Columns(model, figure.numbers), figure.data
    scene = {
        "title": title,
        "mode": mode,
        "tension": [[stop, *rgb] for stop, rgb in TENSION],
        "figure": drawn,
        "links": figure.links,
        "columns": columns.data,
        "laws": [] if limits is None else list(limits.laws),
        "open": OPEN_LOOP,
        "unit": ", ".join(dict.fromkeys(one["unit"] for one in drawn["inputs"])),
        "period": period,
        "pull": pull,
        "ghost": "estimate" if estimates else "model",
        "path": None if path is None else np.round(path, 5).tolist(),
    }
    own = partial(asset, room="softdyn.view.live")
    shared = (asset("figure.js"), asset("chart.js"))
    parts = (*shared, own("handle.js"), own("live.js"))
    style = asset("style.css") + own("live.css")
    page = scene_page(own("live.html"), style, "\n</script>\n<script>\n".join(parts), scene)
    recording = Recording(pickle.dumps(figure), columns.replayed, title)
    return Channel(page, limits, recording, port, origin)
