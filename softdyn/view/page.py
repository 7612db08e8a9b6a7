"""One HTML page that shows robots in motion, with its own timeline, cables, trails and legend.

The page needs no network: Meshcat's script is either inside it or a file beside it.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import Any, Protocol

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.files import write_text
from softdyn.view.scene import TENSION, FigureData

HEAD = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>
{style}
</style>
</head>
"""


def head(title: str, style: str) -> str:
    """The beginning of every page: document type, title, style sheet."""
    return HEAD.format(title=html.escape(title), style=style)


def scene_page(
    template: str, style: str, script: str, scene: Mapping[str, Any], library: str | None = None
) -> str:
    """A page that draws a scene in the browser.

    Parameters
    ----------
    template : str
        Text with the placeholders ``head``, ``library`` (Meshcat's script), ``script``, ``scene``.
    style, script : str
        The page's style sheet and script.
    scene : mapping
        Plain data for the script; ``title`` is the page's title.
    library : str, optional
        URL of Meshcat's script; by default the script is inside the page.

    Raises
    ------
    InputError
        If Meshcat is not installed.
    """
    if library is None:
        meshcat = f"<script>\n{library_file().read_text(encoding='utf-8')}\n</script>"
    else:
        meshcat = f'<script src="{html.escape(library)}"></script>'
    # "</script>" in a robot's name must not end the script that holds it
    text = json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    places = {"head": head(scene["title"], style), "library": meshcat, "script": script}
    return Template(template).substitute(places, scene=text)


@dataclass(frozen=True, eq=False)
class Series:
    """Values along a track, which the page shows in a chart.

    Attributes
    ----------
    titles : tuple of str
        Name and unit of each column.
    values : ndarray, (N, columns)
        Numbers or texts of each frame of the track. Numbers that are not finite are gaps.
    """

    titles: tuple[str, ...]
    values: np.ndarray

    @property
    def data(self) -> dict[str, Any]:
        """The series as JSON."""
        text = self.values.dtype.kind == "U"
        values = self.values.ravel().tolist() if text else _packed(self.values)
        return {"titles": self.titles, "text": text, "values": values}


@dataclass(frozen=True, eq=False)
class Track:
    """One robot's motion.

    Attributes
    ----------
    figure : int
        Index of the robot among the page's figures.
    frames : ndarray, (N, 1 + nv + nu + numbers + 6)
        Rows from `frames`; empty for a live robot.
    label, note : str
        Text in the legend; `note` says, for example, why the run failed.
    colour : str or None
        CSS colour of the trail and in the legend; the page's own by default.
    tint : bool
        Whether the robot is drawn in that colour too.
    opacity : float
        Opacity of the robot.
    offset : tuple of float, (3,)
        Position of its base on the page (m).
    aims : bool
        Whether it has a target, an error and a trail.
    path : ndarray or None, (K, 3)
        The reference's path, None if there is none.
    failed : bool
        Whether it ended before its time.
    full : ndarray or None, (nu,)
        Input at which cables have the colour of full tension; by default its bound.
    series : tuple of Series
        Values at its frames besides those in `frames`, such as a controller's own channels.
    pulls : ndarray or None, (N, 6)
        Force (N) of a pull in each frame and the point (m) where it acts, NaN where there is none.
    """

    figure: int
    frames: np.ndarray
    label: str
    note: str = ""
    colour: str | None = None
    tint: bool = False
    opacity: float = 1.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    aims: bool = True
    path: np.ndarray | None = None
    failed: bool = False
    full: np.ndarray | None = None
    pulls: np.ndarray | None = None
    series: tuple[Series, ...] = ()

    @property
    def data(self) -> dict[str, Any]:
        """The track as JSON."""
        return vars(self) | {
            "frames": _packed(self.frames),
            "pulls": None if self.pulls is None else _packed(self.pulls),
            "series": [one.data for one in self.series],
            "tint": self.colour if self.tint else None,
            "path": None if self.path is None else np.round(self.path, 5).tolist(),
            "full": None if self.full is None else np.asarray(self.full).tolist(),
        }


@dataclass(frozen=True, eq=False)
class PlayedRun:
    """Tracks that are shown together; `notes` are pairs (time (s), text shown from then on)."""

    title: str
    tracks: tuple[Track, ...]
    duration: float = 0.0
    loop: bool = False
    notes: tuple[tuple[float, str], ...] = ()

    @property
    def data(self) -> dict[str, Any]:
        """The run as JSON."""
        return vars(self) | {"tracks": [track.data for track in self.tracks]}


class Drawn(Protocol):
    """Anything that a page can show: a `Figure`, or another class with the same method."""

    @property
    def data(self) -> FigureData:
        """The robot as JSON."""
        ...


@dataclass(frozen=True, eq=False)
class Page:
    """Robots and their runs; a live page connects to its server.

    `rows` are a table beside the robots, its title first. With `sliders` the user moves the joints.
    """

    title: str
    figures: Sequence[Drawn]
    runs: tuple[PlayedRun, ...]
    live: bool = False
    rows: tuple[tuple[str, ...], ...] = ()
    sliders: bool = False

    def html(self, library: str | None = None) -> str:
        """The page as text; `library` is the URL of Meshcat's script, by default inside the page.

        Raises
        ------
        InputError
            If Meshcat is not installed.
        """
        scene = {
            "title": self.title,
            "tension": [[stop, *rgb] for stop, rgb in TENSION],
            "figures": [figure.data for figure in self.figures],
            "runs": [run.data for run in self.runs],
            "live": self.live,
            "rows": self.rows,
            "sliders": self.sliders,
        }
        script = asset("figure.js") + asset("chart.js") + asset("player.js")
        return scene_page(asset("page.html"), asset("style.css"), script, scene, library)

    def save(self, path: str | Path) -> None:
        """Write the page to a file that needs neither a server nor a network.

        Raises
        ------
        InputError
            If the file cannot be written, or Meshcat is not installed.
        """
        write_text(path, self.html())

    def _repr_html_(self) -> str:
        """The page inside a notebook."""
        inside = html.escape(self.html())
        return f'<iframe srcdoc="{inside}" style="width:100%;height:520px;border:0"></iframe>'


def frames(
    model: SoftModel,
    t: Sequence[float] | np.ndarray,
    q: np.ndarray,
    u: np.ndarray,
    y: np.ndarray,
    y_ref: np.ndarray,
    targets: np.ndarray | None = None,
) -> np.ndarray:
    """Frames (N, 1 + nv + nu + numbers + 6): time (s), coordinates, input, targets of tasks, tip,
    reference (m).

    Parameters
    ----------
    q : ndarray, (N, nq)
        Configurations; the other arrays have one row for each of them.
    targets : ndarray, (N, numbers), optional
        The numbers of the targets of the figure's `marks`; none by default.
    """
    coordinates = np.array([model.coordinates(row) for row in q]).reshape(len(q), model.nv)
    goals = np.zeros((len(q), 0)) if targets is None else targets
    columns = (np.reshape(t, (-1, 1)), coordinates, u, goals, y, y_ref)
    return np.concatenate(columns, axis=1, dtype=np.float32)


def _packed(rows: np.ndarray) -> str:
    return base64.b64encode(rows.astype("<f4").tobytes()).decode()


@cache
def library_file() -> Path:
    """Find the file of Meshcat's script without importing Meshcat.

    Raises
    ------
    InputError
        If Meshcat is not installed.
    """
    spec = find_spec("meshcat")
    for folder in (spec and spec.submodule_search_locations) or ():
        script = Path(folder) / "viewer" / "dist" / "main.min.js"
        if script.is_file():
            return script
    raise InputError("viewer", "the package meshcat", "none")


@cache
def asset(name: str, room: str = "softdyn.view") -> str:
    """The text of a file in a package's folder ``web``."""
    return (files(room) / "web" / name).read_text(encoding="utf-8")
