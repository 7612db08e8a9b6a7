"""The page of a live robot, with all its assets inside: it works without a network."""

from __future__ import annotations

import html
import json
from functools import cache
from importlib.resources import files
from string import Template

import numpy as np

from softdyn.description.robot import input_unit
from softdyn.view import page
from softdyn.view.live.frames import Columns
from softdyn.view.live.messages import OPEN_LOOP
from softdyn.view.scene import TENSION, Figure

# what three.js's own controls expect, and what they make
BEFORE, AFTER = "const DRAGGING = (THREE => {\n", "\nreturn THREE;\n})({...MeshCat.THREE});\n"


def live_page(
    figure: Figure,
    mode: str,
    *,
    title: str,
    laws: tuple[str, ...] = (),
    period: float = 0.0,
    pull: float = 1.0,
    path: np.ndarray | None = None,
) -> str:
    """The page as text.

    Parameters
    ----------
    figure : Figure
        The robot.
    mode : str
        ``play``, ``watch`` (a run that is only looked at) or ``explore`` (joints and inputs).
    title : str
        Its heading.
    laws : tuple of str
        The menu.
    period : float
        Of the control (s).
    pull : float
        Force (N) of the longest arrow.
    path : ndarray, (K, 3), optional
        The reference's.

    Raises
    ------
    InputError
        When Meshcat is not installed.
    """
    model = figure.model
    data = figure.data
    scene = {
        "title": title,
        "mode": mode,
        "tension": [[stop, *rgb] for stop, rgb in TENSION],
        "figure": data,
        "links": figure.links,
        "columns": Columns(model).data,
        "laws": list(laws),
        "open": OPEN_LOOP,
        "unit": input_unit(model.robot),
        "period": period,
        "pull": pull,
        "path": None if path is None else np.round(path, 5).tolist(),
    }
    text = json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    controls = BEFORE + _asset("transform_controls.js") + AFTER
    parts = (page.asset("figure.js"), controls, _asset("uplot.js"), _asset("live.js"))
    library = page.library_file().read_text(encoding="utf-8")
    return Template(_asset("live.html")).substitute(
        title=html.escape(title),
        style=page.asset("style.css") + _asset("uplot.css") + "\n" + _asset("live.css"),
        library=f"<script>\n{library}\n</script>",
        script="\n</script>\n<script>\n".join(parts),
        scene=text,
    )


@cache
def _asset(name: str) -> str:
    return (files("softdyn.view.live") / "web" / name).read_text(encoding="utf-8")
