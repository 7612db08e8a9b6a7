"""The paper's experiments and its results (section Validation), as data.

Set points last 10 s, the loop's default and the paper's duration. A robot that is not in the paper
has the loop's default period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, OutOfReach, SoftModel
from softdyn.checks import array
from softdyn.description.library import bundled_file
from softdyn.description.urdf import parse
from softdyn.exceptions import errors_in
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.metrics import CM, mean_square
from softdyn.validation.loop.setups import CYCLES, setup, setup_of
from softdyn.validation.loop.trajectories import TRIED, Trajectory, read_trajectory
from softdyn.validation.loop.verdict import DIVERGED

THETAS = (0.0, 0.5, 1.0, 1.5)  # set points, in multiples of π
OMEGAS = (0.1, 0.2, 0.3, 0.4, 0.5)  # tracking rates, in multiples of π rad/s


def experiment(
    model: SoftModel,
    *,
    theta: float | None = None,
    omega: float | None = None,
    target: Any = None,
    period: float | None = None,
) -> Experiment:
    """The set point at `theta`, the trajectory at `omega` or the point `target`, for any robot.

    Parameters
    ----------
    model : SoftModel
        The robot. If it is not in the paper, the ellipse is scaled to its size.
    theta, omega : float, optional
        In multiples of π (rad, rad/s).
    target : array, (3,), optional
        A point of the world (m).
    period : float, optional
        Control period (s); that of `setup_of` by default.

    Raises
    ------
    InputError
        None of the three is given, a number is not finite, or the robot's length is unknown.
    """
    found = setup_of(model)
    if period is not None:
        found = replace(found, period=period)
    if target is not None:
        check_reach(model, target)
        return found.target(target)
    if theta is not None:
        return found.set_point(theta)
    if omega is None:
        raise InputError("experiment", "theta, omega or target", "none of them")
    return found.tracking(omega)


def trajectory(
    model: SoftModel, source: str | Path, *, periodic: bool = False, period: float | None = None
) -> Experiment:
    """A trajectory of one's own, for any robot: a CSV file's, or a class's in FILE.py:CLASS.

    Parameters
    ----------
    model : SoftModel
    source, periodic
        See `read_trajectory`.
    period : float, optional
        Control period (s); that of `setup_of` by default.

    Raises
    ------
    InputError
        A file or class that cannot be used, or a point far outside the robot's reach; the error
        names the time.
    """
    found = setup_of(model)
    if period is not None:
        found = replace(found, period=period)
    return found.trajectory(within_reach(model, source, periodic=periodic))


def within_reach(model: SoftModel, source: str | Path, *, periodic: bool = False) -> Trajectory:
    """A trajectory of one's own, as `read_trajectory`, refused where it leaves the robot's reach.

    Raises
    ------
    InputError
        As `trajectory`.
    """
    found = read_trajectory(source, model, periodic=periodic)
    for t in np.linspace(0.0, found.duration, TRIED):
        with errors_in(f"{source}: at {t:g} s"):
            check_reach(model, found.reference(float(t)).y)
    return found


def check_reach(model: SoftModel, target: Any) -> None:
    """Refuse a target (3,) (m) far outside the robot's reach; `statics` judges closer ones.

    Raises
    ------
    OutOfReach
        The error names the reach, and the likely unit of the target.
    InputError
        The target is not three finite numbers.
    """
    chain = model.robot.chain(model.robot.task)
    slides = (max(abs(j.lower), abs(j.upper)) for j in chain if j.kind == "prismatic")
    reach = model.robot.length + sum(slides)
    within = f"three finite numbers in m, within the robot's reach of {reach:.3g} m"
    try:
        away = float(np.linalg.norm(array("target", target, (3,))))
    except InputError as error:
        raise InputError("target", within, error.got) from None
    if model.robot.floating or not reach > 0 or away <= DIVERGED * reach:
        return
    units = {"cm": 100, "mm": 1000}
    fits = [name for name, factor in units.items() if away / factor <= reach]
    unit = f": in {fits[0]}?" if fits else ""
    raise OutOfReach("target", within, f"one {away:.3g} m from the base{unit}")


def set_point(robot: str, theta: float) -> Experiment:
    """The paper's set point at `theta`, in multiples of π, for one of its robots."""
    return setup(robot).set_point(theta)


def tracking(robot: str, omega: float) -> Experiment:
    """The paper's trajectory at `omega`, in multiples of π rad/s, for one of its robots."""
    return setup(robot).tracking(omega)


def second_cycle_mse_cm2(log: Log) -> float:
    """Time-mean of ‖e‖² (cm²) over the second of a trajectory's two cycles; NaN as `Log.mse_cm2`.

    Raises
    ------
    InputError
        The run is not a complete tracking experiment, so that it has no cycles.
    """
    if log.omega is None or not math.isclose(log.duration, 2 * CYCLES / log.omega):
        raise InputError("log", "a tracking experiment of two cycles", log.kind)
    if not log.complete:
        return math.nan
    return CM**2 * mean_square(log.t, log.error, start=log.duration / CYCLES)


@dataclass(frozen=True)
class Published:
    """A row of the paper's table: mean and standard deviation, None for "Failed Convergence".

    Attributes
    ----------
    sp_mean_cm, sp_std_cm : float, optional
        Final error over the four set points (cm).
    tt_mean_cm2, tt_std_cm2 : float, optional
        Mean squared error over the five trajectories (cm²).
    """

    sp_mean_cm: float | None
    sp_std_cm: float | None
    tt_mean_cm2: float | None
    tt_std_cm2: float | None


_FAILED = Published(None, None, None, None)

# The paper's "ID-CLF-QP (ours)" is the soft variant; the paper has no results of the hard one.
TABLE = {
    ("finger", "clf-qp"): Published(0.75, 1.05, 6.90, 0.80),
    ("finger", "soft-id-clf-qp"): Published(0.08, 0.09, 0.53, 0.26),
    ("finger", "ic"): Published(0.08, 0.14, 1.26, 0.73),
    ("finger", "uic"): Published(0.22, 0.39, 1.00, 0.51),
    ("finger", "ic-qp"): Published(0.07, 0.12, 1.26, 0.71),
    ("helix", "clf-qp"): _FAILED,
    ("helix", "soft-id-clf-qp"): Published(2.48, 1.20, 24.14, 9.04),
    ("helix", "ic"): Published(2.66, 1.40, 21.89, 6.08),
    ("helix", "uic"): Published(3.39, 2.12, 31.70, 7.48),
    ("helix", "ic-qp"): Published(2.48, 1.20, 24.14, 9.04),
    ("spirob", "clf-qp"): Published(4.23, 3.98, 255.33, 186.38),
    ("spirob", "soft-id-clf-qp"): Published(3.50, 3.71, 19.51, 5.66),
    ("spirob", "ic"): _FAILED,
    ("spirob", "uic"): _FAILED,
    ("spirob", "ic-qp"): Published(8.93, 7.80, 157.64, 6.48),
}


def published(robot: str, controller: str) -> Published | None:
    """The paper's row of a robot and a controller (its command-line name), None if it has none."""
    return TABLE.get((robot, controller))


def beside(log: Log) -> dict[str, str]:
    """The paper's results for a run's robot and controller, for `Log.summary`.

    Empty for another robot that only has the name of one of the paper's.
    """
    row = published(log.robot, log.controller)
    file = bundled_file(log.robot)
    if row is None or file is None or parse(file).digest != log.source.digest:
        return {}
    if log.theta is not None:
        sp = spread(row.sp_mean_cm, row.sp_std_cm)
        return {"final_error_cm": f"paper, over its set points: {sp} cm"}
    if log.omega is not None:
        tt = spread(row.tt_mean_cm2, row.tt_std_cm2)
        return {"mse_cm2": f"paper, over its trajectories: {tt} cm²"}
    return {}


def spread(mean: float | None, std: float | None) -> str:
    """A published figure as the paper prints it."""
    return "failed" if mean is None else f"{mean:.2f} ± {std:.2f}"
