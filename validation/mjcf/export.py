"""Robots written in the other format, read back, and compared with where they came from."""

from __future__ import annotations

import time
from pathlib import Path

from softdyn.description.library import find
from softdyn.description.urdf import parse
from softdyn.description.urdf_writer import write
from softdyn.validation.files import write_text
from softdyn.validation.mjcf.comparison.comparison import compare_neutral
from softdyn.validation.mjcf.comparison.from_urdf import from_urdf
from softdyn.validation.mjcf.comparison.neutral import Neutral
from softdyn.validation.mjcf.comparison.result import Comparison
from softdyn.validation.mjcf.comparison.side import neutral
from softdyn.validation.mjcf.to_mjcf import lost, to_mjcf
from softdyn.validation.mjcf.to_urdf import to_urdf

Outcome = tuple[Comparison, tuple[str, ...]]


def write_mjcf(
    source: str | Path,
    target: str | Path,
    *,
    annotations: str | Path | None = None,
    floating: bool = False,
    repair_inertia: bool = False,
    shapes: bool = True,
    contacts: bool = False,
) -> Outcome:
    """Write a URDF as MJCF.

    Parameters
    ----------
    source : str or Path
        What `softdyn.load` takes; so are `annotations`, `floating` and `repair_inertia`.
    target : str or Path
        The file to write.
    shapes : bool
        Whether to write what the robot looks like.
    contacts : bool
        Whether its collision shapes touch.

    Returns
    -------
    tuple[Comparison, tuple[str, ...]]
        How the written file compares, and what it does not say.

    Raises
    ------
    UrdfError
        For a file that cannot be used.
    """
    robot = parse(
        find(source), annotations=annotations, floating=floating, repair_inertia=repair_inertia
    )
    write_text(str(target), to_mjcf(robot, shapes=shapes, contacts=contacts))
    return _compared(from_urdf(robot), neutral(target)), tuple(lost(robot))


def write_urdf(source: str | Path, target: str | Path) -> Outcome:
    """Write an MJCF, or a URDF, as an annotated URDF; arguments and result as `write_mjcf`.

    Parameters
    ----------
    source, target : str or Path
        The file to read, and the one to write.

    Raises
    ------
    UrdfError
        For a file that cannot be used, or a robot that is no URDF's: the message says why.
    """
    robot = neutral(source)
    converted = to_urdf(robot, Path(find(source)).stem)
    write_text(str(target), write(converted.robot))
    floating = any(part.kind == "free" for part in robot.parts)
    return _compared(robot, neutral(target, floating=floating)), converted.lost


def _compared(one: Neutral, other: Neutral) -> Comparison:
    return compare_neutral(
        one, other, mapping=None, strict=False, samples=4, seed=0, begin=time.perf_counter()
    )
