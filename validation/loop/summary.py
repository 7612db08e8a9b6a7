"""The figures of a run as text and as the commands' JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from softdyn.validation.loop import verdict as judged
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.metrics import CM
from softdyn.validation.loop.verdict import Verdict

if TYPE_CHECKING:
    from softdyn.validation.loop.log import Log


def summary_text(log: Log, beside: Mapping[str, str] | None, tolerance: float | None) -> str:
    """Several lines, see `Log.summary`."""
    if log.kind == ROLLOUT:
        text = judged.rollout_text(log.robot, log.t[-1], log.y[-1], log.reason)
        return text + (f"\nstart: {log.start}" if log.start else "")
    sp, tt = (
        f"   {beside[name]}" if beside and name in beside else ""
        for name in ("final_error_cm", "mse_cm2")
    )
    lines = [
        f"{log.robot}{f' in {log.plant}' if log.plant else ''}, {log.controller}, "
        f"{judged.goal_text(log.theta, log.omega, log.y_ref)}: {log.t[-1]:g} s of "
        f"{log.duration:g} s, period {1e3 * log.period:g} ms",
        *([f"start          {log.start}"] if log.start else []),
        f"final error    {log.final_error_cm:.3f} cm{sp}",
        f"mean |e|^2     {log.mse_cm2:.3f} cm²{tt}",
    ]
    if log.steps:
        parts = ", ".join(f"{name} {value:.0f}" for name, value in log.step_times_us.items())
        lines.append(f"step time      {parts} us over {log.steps} steps")
    if log.missed is not None and log.steps:
        parts = ", ".join(f"{name} {value:.0f}" for name, value in log.jitter_us.items())
        lines.append(
            f"clock          periods began late by {parts} us; "
            f"{np.nansum(log.missed):.0f} deadlines missed"
        )
    beyond = log.max_bound_violation
    lines.append(
        f"solver         {log.not_solved} not solved, {log.fallbacks} fallbacks, "
        + (
            f"answers up to {beyond:.2g} beyond the bounds, clipped"
            if beyond
            else "inputs in bounds"
        )
    )
    lines += judged.task_lines(log.task_figures)
    found = log.verdict(tolerance)
    if found.activity is not None:
        lines.append(
            f"inputs         change by {found.activity:.3g} of their range a second, "
            f"{found.at_bound:.0%} of the time at a bound"
        )
    if found.overshoot is not None and found.overshoot > 1e-3:
        lines.append(f"overshoot      {found.overshoot:.1%} of the way")
    if found.missed:
        lines.append(
            f"deadlines      MISSED {found.missed} of {log.steps}: steps longer than the "
            f"period of {1e3 * log.period:g} ms"
        )
    for name, (value, half, unit) in log.disturbance_figures.items():
        lines.append(f"estimated      {name} {value:.3g} ± {half:.2g} {unit}".rstrip())
    if log.least_reserve:
        parts = ", ".join(f"{name} {1e3 * m:.2f}" for name, m in log.least_reserve.items())
        lines.append(f"least reserve  {parts} mm")
    return "\n".join([*lines, _verdict_text(log, found)])


def _verdict_text(log: Log, found: Verdict) -> str:
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
    return ("reached: " if found.reached else "not reached: ") + what


def report(log: Log, tolerance: float | None) -> dict[str, Any]:
    """The figures as JSON, see `Log.report`."""
    found, least = log.verdict(tolerance), log.least_reserve
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
