"""Early ends of a run, failures, and whether the run reached its reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from softdyn.checks import number
from softdyn.exceptions import one_line
from softdyn.references import Reference
from softdyn.tasks import StackedReference
from softdyn.validation.loop.log_data import LogData
from softdyn.validation.loop.metrics import CM, RESOLUTION, mean_square, moves

DIVERGED = 2.0  # ‖e‖ in robot lengths
TOLERANCE = 0.01  # of the robot's length
STEADY = 0.1  # last part of a run, in which transients have decayed
AT_BOUND = 1e-9  # of an input's range
INSIDE = 1e-4  # m: contacts give way by less, and sampled barriers do


def not_finite(t: float) -> str:
    """The reason text of a run that ended because the plant's state is not finite at `t` (s)."""
    return f"the plant diverged at t = {t:.4g} s: a state that is not finite"


def plant_stopped(t: float, warning: str) -> str:
    """The reason text of a run that ended because MuJoCo stopped with a `warning` at `t` (s)."""
    return f"the plant diverged at t = {t:.4g} s: {warning}"


def no_input(t: float, fault: str) -> str:
    """The reason text of a run that ended because the input was unusable at `t` (s)."""
    return f"the controller failed at t = {t:.4g} s: {fault}"


def stopped_by(t: float, error: BaseException) -> str:
    """The reason text of a run that an exception ended at `t` (s)."""
    interrupted = isinstance(error, KeyboardInterrupt)
    what = "interrupted" if interrupted else one_line(f"{type(error).__name__}: {error}")
    return f"the run ended at t = {t:.4g} s: {what}"


def tip_diverged(t: float, distance: float, length: float) -> str | None:
    """The reason text of a run that ends because its tip is too far away, else None.

    Parameters
    ----------
    t : float
        Time (s).
    distance : float
        ‖e‖ (m).
    length : float
        The robot's length (m); 0 switches the check off.
    """
    if distance <= (DIVERGED * length if length > 0 else math.inf):
        return None
    return (
        f"the tip diverged at t = {t:.4g} s: {distance:.3g} m from its reference, "
        f"more than twice the length of {length:.3g} m"
    )


def not_converged(
    first: np.ndarray, last: np.ndarray, target: Reference, horizon: float = 0.0
) -> str | None:
    """The reason text of a complete run that failed, from its first and last e (3,) (m), else None.

    It names the horizon τ (s) of the controller's dynamics, if one is on.
    Paths of tasks usually begin at the robot, so they are judged by the verdict alone.
    """
    initial, final = float(np.linalg.norm(first)), float(np.linalg.norm(last))
    if isinstance(target, StackedReference) or final < initial or final <= RESOLUTION:
        return None
    over = f", with a horizon of {1e3 * horizon:.3g} ms" if horizon else ""
    return (
        f"no convergence: the final error of {100 * final:.3g} cm is not below "
        f"the initial {100 * initial:.3g} cm{over}"
    )


@dataclass(frozen=True)
class Verdict:
    """The assessment of a run.

    Attributes
    ----------
    reached : bool
        The run did not fail, and both its steady error and, at a set point, its final one are
        within the tolerance. In a run of tasks with errors in m or rad, these errors count instead
        of the tip's.
    tolerance : float
        Tolerance (m).
    steady_error : float
        Root mean square of ‖e‖ (m) over the last tenth of the run, or over the last cycle of a
        trajectory. NaN for a run that ended early.
    settling_time : float or None
        Time (s) from which ‖e‖ stays within the tolerance; None if it is outside at the end.
    overshoot : float or None
        Distance of the tip beyond a set point along the line from start to set point, relative to
        that line's length. None for a trajectory.
    activity : float or None
        Rate of change of the inputs: the mean over the inputs of Σ|Δu| per second, relative to
        their range (1/s).
    effort : float or None
        Root mean square of the inputs, each relative to its larger bound.
    at_bound : float or None
        Share of the steps at which an input is at a bound, mean over the inputs.
    missed : int or None
        Number of steps that took longer than the period; None without recorded times.
    missed_tasks : tuple[str, ...]
        The tasks whose own steady or final error is beyond the tolerance, see `missed_tasks`.
    by_tasks : bool
        Whether tasks count instead of the tip.
    inside : dict of str to float
        How deep (m) the guarded part of the robot is inside obstacles, or links in each other, by
        their names, if that is more than 0.1 mm and, of tiny robots, than the tolerance. At the end
        of a set point's run, or at the worst in the last cycle of a trajectory. Such a run has
        reached nothing.
    """

    reached: bool
    tolerance: float
    steady_error: float
    settling_time: float | None
    overshoot: float | None
    activity: float | None
    at_bound: float | None
    effort: float | None
    missed: int | None
    missed_tasks: tuple[str, ...] = ()
    by_tasks: bool = False
    inside: dict[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """The same figures with the keys of the commands' JSON."""
        return {
            "reached": self.reached,
            "tolerance_cm": CM * self.tolerance,
            "steady_error_cm": CM * self.steady_error,
            "settling_time_s": self.settling_time,
            "overshoot": self.overshoot,
            "input_activity": self.activity,
            "share_at_bound": self.at_bound,
            "input_effort": self.effort,
            "missed_deadlines": self.missed,
            **({"inside_mm": {k: 1e3 * m for k, m in self.inside.items()}} if self.inside else {}),
        }

    @property
    def inside_text(self) -> str:
        """Where the robot is inside an obstacle and how deep; empty without any."""
        return ", ".join(f"{1e3 * m:.3g} mm inside {name!r}" for name, m in self.inside.items())


def judge(log: LogData, tolerance: float | None = None) -> Verdict:
    """Whether the run reached its reference, with settling time, effort and missed deadlines.

    Parameters
    ----------
    log : LogData
        The run.
    tolerance : float, optional
        Tolerance (m); 1 % of the robot's length by default.

    Raises
    ------
    InputError
        For a tolerance that is no number > 0.
    """
    wanted = tolerance_of(log.length, log.error, tolerance)
    cycle = 2 / log.omega if log.omega else None
    within, since, steady = not log.failed, None, math.nan
    off: tuple[str, ...] | None = None
    if log.complete:
        moving = log.moving
        steady = steady_error(log.t, log.error, moving, cycle)
        columns = [] if log.tasks is None else [np.outer(e, [1, 0, 0]) for e in log.tasks.T]
        each = [
            max(steady_error(log.t, e, moving, cycle), 0.0 if moving else e[-1, 0]) for e in columns
        ]
        off = missed_tasks(log.columns("tasks"), each, wanted, log.length)
        since = settling_time(log.t, log.error, wanted)
        if off is None:
            within &= steady <= wanted and (since is not None or moving)
        else:
            within &= not off
    known = np.isfinite(log.step_us).all()
    last, inside = log.finite_samples, _inside(log, wanted, cycle)
    return Verdict(
        log.complete and within and not inside,
        wanted,
        steady,
        since,
        overshoot(log.y[:last], log.y_ref[:last]) if last else None,
        *activity(log.t, log.u, log.u_min, log.u_max),
        int((log.step_us > 1e6 * log.period).sum()) if known else None,
        off or (),
        off is not None,
        inside,
    )


def _inside(log: LogData, tolerance: float, cycle: float | None) -> dict[str, float]:
    """The depths (m) of `Verdict.inside`."""
    around = log.surroundings
    if log.reserve is None or around is None or not log.complete:
        return {}
    since = steady_from(log.t, True, cycle) if log.moving else log.t[-1]
    rows = log.t >= since
    found = around.depths(log.reserve[rows], log.y[rows])
    least = min(INSIDE, tolerance)
    return {name: depth for name, depth in found.items() if depth > least}


def missed_tasks(
    tasks: Sequence[tuple[str, str]],
    errors: Sequence[float],
    tolerance: float,
    length: float | None,
) -> tuple[str, ...] | None:
    """The names of the tasks whose error is beyond the tolerance; None if no task is judged.

    An error in m has the tip's tolerance. An error in rad has the angle by which a straight robot
    turns when its tip moves by that tolerance. Errors in other units are not judged.

    Parameters
    ----------
    tasks : sequence of (str, str)
        The tasks' names and the units of their errors.
    errors : sequence of float
        The larger of their steady error and, at a set point, their final one.
    tolerance : float
        Tolerance of the tip (m).
    length : float or None
        The robot's length (m).
    """
    allowed = {"m": tolerance, "rad": tolerance / length if length else TOLERANCE}
    if not any(unit in allowed for _, unit in tasks):
        return None
    return tuple(
        name
        for (name, unit), error in zip(tasks, errors, strict=True)
        if unit in allowed and not error <= allowed[unit]
    )


def tolerance_of(length: float | None, error: np.ndarray, asked: float | None = None) -> float:
    """The tolerance (m): the given one, else a share of the robot's length or of the first error.

    Raises
    ------
    InputError
        For a tolerance that is no number > 0.
    """
    if asked is not None:
        return number("tolerance", asked, above=0.0)
    return TOLERANCE * (length or float(np.linalg.norm(error[0]))) or RESOLUTION


def steady_error(t: np.ndarray, error: np.ndarray, moving: bool, cycle: float | None) -> float:
    """Root mean square of ‖e‖ (m) over the last `cycle` (s), or the last tenth of the run.

    Without a cycle, a reference that moves is judged over the last half.
    """
    return math.sqrt(mean_square(t, error, start=steady_from(t, moving, cycle)))


def steady_from(t: np.ndarray, moving: bool, cycle: float | None) -> float:
    """Time (s) from which a run counts as steady, see `steady_error`."""
    share = 0.5 if moving else STEADY
    span = share * t[-1] if cycle is None else min(cycle, float(t[-1]))
    return max(0.0, float(t[-1]) - span)


def settling_time(t: np.ndarray, error: np.ndarray, tolerance: float) -> float | None:
    """Time (s) from which ‖e‖ stays within the tolerance; None if it is outside at the end."""
    outside = np.flatnonzero(~(np.linalg.norm(error, axis=1) <= tolerance))
    if not len(outside):
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None


def overshoot(y: np.ndarray, y_ref: np.ndarray) -> float | None:
    """Overshoot beyond a set point, relative to the way there; None for a trajectory."""
    way = y_ref[0] - y[0]
    length = float(np.linalg.norm(way))
    if moves(y_ref) or length < RESOLUTION:
        return None
    return max(0.0, float(((y - y_ref) @ way).max()) / length**2)


def activity(
    t: np.ndarray, u: np.ndarray, u_min: np.ndarray, u_max: np.ndarray
) -> tuple[float | None, float | None, float | None]:
    """`Verdict`'s activity, at_bound and effort of inputs (N, nu) held from t (N + 1,) on."""
    free = u_max > u_min
    if len(u) == 0 or not free.any():
        return None, None, None
    u, low, high = u[:, free], u_min[free], u_max[free]
    with np.errstate(all="ignore"):  # a damaged log may state a range of 1e-310
        effort = np.sqrt(np.mean((u / np.maximum(np.abs(low), np.abs(high))) ** 2))
        share = (u - low) / (high - low)
        changes = np.abs(np.diff(share, axis=0)).sum(axis=0).mean() / t[-1]
    held = (share <= AT_BOUND) | (share >= 1 - AT_BOUND)
    return float(changes), float(held.mean()), float(effort)
