"""Trajectories of one's own: the tip's path in a CSV file, or a class."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import SoftModel
from softdyn.checks import number
from softdyn.controllers.registry import find_controller, is_own, one_line_errors
from softdyn.exceptions import InputError, errors_in
from softdyn.tasks import read_path
from softdyn.validation.loop.arguments import checked
from softdyn.validation.loop.experiment import SET_POINT_DURATION

CYCLES = 2  # of a periodic reference, for which it runs
TRIED = 101  # times at which a class's trajectory is tried before it runs


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A reference for the tip, and how long it takes.

    Attributes
    ----------
    reference : Callable[[float], Reference]
        Of t (s), as it is, so that a record can say what makes it.
    duration : float
        Length of a run (s).
    """

    reference: Callable[[float], Any]
    duration: float


def read_trajectory(
    source: str | Path, model: SoftModel, *, periodic: bool = False,
    make: Callable[..., Any] | None = None,
) -> Trajectory:  # fmt: skip
    """The trajectory of a CSV file, or of a class in FILE.py:CLASS.

    Parameters
    ----------
    source : str or Path
        A file with the columns ``t`` (s), ``x``, ``y``, ``z`` (m), see `read_path`. Or a class:
        it is built as CLASS(model) and called with t (s), and gives a `Reference`. An attribute
        `duration` (s) is the length of a run, 10 s without one.
    model : SoftModel
    periodic : bool
        Whether a file's path repeats. It then runs for two cycles, otherwise once.
    make : Callable, optional
        The class of the source, if it is known already.

    Raises
    ------
    InputError
        A file or class that cannot be used, or that gives anything else than a finite `Reference`;
        the error names it, and the time or the file's line.
    """
    text = str(source)
    if not is_own(text):
        path = read_path(source, periodic=periodic)
        return Trajectory(path, float(path.times[-1]) * (CYCLES if periodic else 1))
    if periodic:
        expected = "a CSV file; a class repeats by itself, and has a duration"
        raise InputError("periodic", expected, text)
    make = find_controller(text) if make is None else make
    with errors_in(text), one_line_errors(text, "a trajectory"):
        reference = make(model)
        duration = number("duration", getattr(reference, "duration", SET_POINT_DURATION), above=0.0)
        found = checked(reference)
        for t in np.linspace(0.0, duration, TRIED):
            found(float(t))
    return Trajectory(reference, duration)
