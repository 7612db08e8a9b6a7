"""A run in words and figures: the summary, and the figures of the commands' JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.log_data import LogData
from softdyn.validation.loop.metrics import CM, moves
from softdyn.validation.loop.verdict import Verdict, judge

ROUNDING = 1e-9  # a solver's answer at a bound is beyond it by 1e-15 to 1e-12: no fault of the law


def report(log: LogData, tolerance: float | None = None) -> dict[str, Any]:
    """The run's figures with the keys of the commands' JSON; `tolerance` is in m."""
    found, least = judge(log, tolerance), log.least_reserve
    made = {
        "robot": log.robot,
        "controller": log.controller,
        "kind": log.kind,
        "final_error_cm": log.final_error_cm,
        "mse_cm2": log.mse_cm2,
        "failed": log.failed,
        "reason": log.reason,
        "steps": log.steps,
        "step_us": log.step_times_us,
        "not_solved": log.not_solved,
        "fallbacks": log.fallbacks,
        "max_bound_violation": log.max_bound_violation,
        "start": log.start or None,
        "verdict": "failed" if log.failed else ("reached" if found.reached else "not reached"),
        **found.to_dict(),
    }
    if log.missed is not None:
        made |= {"missed": int(np.nansum(log.missed)), "jitter_us": log.jitter_us}
    if least:
        made["reserve_mm"] = {name: 1e3 * m for name, m in least.items()}
    if log.disturbance_names:
        made["disturbances"] = log.disturbance_figures
    if log.task_names:
        made |= {"tasks": log.task_figures, "missed_tasks": [*found.missed_tasks]}
    return made


def summary(
    log: LogData, beside: Mapping[str, str] | None = None, tolerance: float | None = None
) -> str:
    """The same figures as several lines of text.

    Parameters
    ----------
    log : LogData
        The run.
    beside : Mapping[str, str], optional
        Text after a figure, by the figure's key in `report`: ``final_error_cm``, ``mse_cm2``.
    tolerance : float, optional
        Tolerance of the `verdict` (m).
    """
    if log.kind == ROLLOUT:
        text = rollout_text(log.robot, log.t[-1], log.y[-1], log.reason)
        inside = judge(log, tolerance).inside_text
        text += f"\n{inside}" if inside else ""
        return text + (f"\nstart: {log.start}" if log.start else "")
    sp, tt = (
        f"   {beside[name]}" if beside and name in beside else ""
        for name in ("final_error_cm", "mse_cm2")
    )
    lines = [
        f"{log.robot}{f' in {log.plant}' if log.plant else ''}, {log.controller}, "
        f"{goal_text(log.theta, log.omega, log.y_ref)}: {log.t[-1]:g} s of "
        f"{log.duration:g} s, period {1e3 * log.period:g} ms",
        *([f"start          {log.start}"] if log.start else []),
    ]
    if log.complete:
        lines.append(f"final error    {log.final_error_cm:.3f} cm{sp}")
        lines.append(f"mean |e|^2     {log.mse_cm2:.3f} cm²{tt}")
    elif log.finite_samples:  # it ended early, so it has no figures of the whole run
        last = log.finite_samples - 1
        error = CM * float(np.linalg.norm(log.error[last]))
        lines.append(f"last error     {error:.3f} cm at {log.t[last]:.4g} s, where it ended")
    if parts := _stated(log.step_times_us):
        lines.append(f"step time      {parts} us over {log.steps} steps")
    if log.missed is not None and (parts := _stated(log.jitter_us)):
        lines.append(
            f"clock          periods began late by {parts} us; "
            f"{np.nansum(log.missed):.0f} deadlines missed"
        )
    beyond = log.max_bound_violation
    lines.append(
        f"solver         {log.not_solved} not solved, {log.fallbacks} fallbacks, "
        + (
            f"answers up to {beyond:.2g} beyond the bounds, clipped"
            if beyond > ROUNDING
            else "inputs in bounds"
        )
    )
    lines += task_lines(log.task_figures)
    found = judge(log, tolerance)
    if found.activity is not None:
        lines.append(
            f"inputs         change by {found.activity:.3g} of their range a second, "
            f"{found.at_bound:.0%} of the time at a bound"
        )
    if found.overshoot is not None and found.overshoot > 1e-3:
        lines.append(f"overshoot      {found.overshoot:.1%} of the way")
    if found.missed:
        lines.append(
            f"deadlines      {found.missed} of {log.steps} steps took longer than the period of "
            f"{1e3 * log.period:g} ms"
            + (", which a simulation bears" if log.missed is None else "")
        )
    for name, (value, half, unit) in log.disturbance_figures.items():
        lines.append(f"estimated      {name} {value:.3g} ± {half:.2g} {unit}".rstrip())
    if log.least_reserve:
        parts = ", ".join(f"{name} {1e3 * m:.2f}" for name, m in log.least_reserve.items())
        lines.append(f"least reserve  {parts} mm")
    return "\n".join([*lines, _verdict_line(log, found)])


def _verdict_line(log: LogData, found: Verdict) -> str:
    """The last line of a summary."""
    if log.failed:
        return f"failed: {log.reason}"
    if not log.complete:
        return "not reached: the run is not over"
    first, last = (CM * math.dist(log.y[i], log.y_ref[i]) for i in (0, -1))
    wanted, steady = (f"{CM * x:.3g} cm" for x in (found.tolerance, found.steady_error))
    if found.by_tasks:
        missed = ", ".join(found.missed_tasks)
        what = f"beyond their tolerance: {missed}" if missed else "all tasks within their tolerance"
    elif log.moving:
        what = f"rms error of {steady} over the last cycle, tolerance {wanted}"
    else:
        what = f"|e| fell from {first:.3f} to {last:.3f} cm, tolerance {wanted}"
        if found.settling_time is not None:
            what += f", within it since {found.settling_time:.3g} s"
    if found.inside:
        return f"not reached: {found.inside_text}; {what}"
    return ("reached: " if found.reached else "not reached: ") + what


def goal_text(theta: float | None, omega: float | None, y_ref: np.ndarray) -> str:
    """A run's target in words."""
    if theta is not None:
        return f"set point at {theta:g} pi"
    if omega is not None:
        return f"tracking at {omega:g} pi rad/s"
    first, last = (
        " ".join(f"{round(x, 6) + 0.0:g}" for x in point) for point in (y_ref[0], y_ref[-1])
    )
    return f"path from {first} to {last} m" if moves(y_ref) else f"set point at {first} m"


def rollout_text(robot: str, t: float, y: np.ndarray, reason: str | None) -> str:
    """The summary of a rollout: its length (s), its last tip (3,) (m), why it failed."""
    text = f"{robot}, rollout of {t:g} s\ntip at the end {' '.join(f'{x:.6g}' for x in y)} m"
    return f"{text}\nfailed: {reason}" if reason else text


def task_lines(figures: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """A line of a summary for each task."""
    return [
        f"{name:14} error from {one['first']:.3f} to {one['last']:.3f} {one['unit']}".rstrip()
        for name, one in figures.items()
    ]


def _stated(times: Mapping[str, float | None]) -> str:
    """Times (µs) in one line; empty where none is known."""
    return ", ".join(f"{name} {value:.0f}" for name, value in times.items() if value is not None)
