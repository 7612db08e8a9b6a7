"""Conformance of an observer: `softdyn.estimation.Observer`."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from softdyn import SoftModel
from softdyn.testing import samples
from softdyn.testing.report import Checks, Conformance, copies, expect, numbers, timed

PERIOD = 0.005  # s, between two steps where no period is given
CALL = "observer.step(t, measurements, u)"


def check_observer(
    observer: Any, model: SoftModel, *, period: float | None = None, count: int = 10
) -> Conformance:
    """RuleResult an observer: any class with ``step(t, measurements, u)``, and maybe ``reset()``.

    It reads the file's sensors of a robot that hangs at rest at q = 0.

    Parameters
    ----------
    observer : Any
        A class that is built as ``CLASS(model)``, a function that builds one, or an object.
    model : SoftModel
        The robot, with sensors.
    period : float, optional
        Time (s) between two steps; the median of a call must be shorter.
    count : int
        Number of steps.
    """
    checks = Checks(observer, model)
    if not checks.run("it is built", lambda: type(checks.make()).__name__):
        return checks.report("observer")
    state = samples.states(model, 1, 0)[0]
    u = model.relaxed
    times = (period or PERIOD) * np.arange(count)

    def readings() -> np.ndarray:
        return np.array(model.measure(state, u).values)

    if not checks.run("the robot has sensors", lambda: f"{len(readings())} readings"):
        return checks.report("observer")
    measured = readings()

    def begun() -> Any:
        one = checks.make()
        if hasattr(one, "reset"):
            one.reset()
        return one

    def estimates(one: Any, begin: int = 0) -> list[np.ndarray]:
        found = []
        for t in times[begin:]:
            estimate = one.step(float(t), measured.copy(), u.copy())
            q = numbers(f"{CALL}.q", estimate.q, (model.nq,))
            found.append(np.concatenate((q, numbers(f"{CALL}.v", estimate.v, (model.nv,)))))
        return found

    def hostile() -> str:
        one, tried = begun(), 0
        estimates(one)
        for k, value in enumerate((*samples.HOSTILE, np.nan)):
            bad = measured.copy()
            bad[k % len(bad)] = value
            if k == len(samples.HOSTILE):
                bad[:] = np.nan  # nothing new
            t, tried = float(times[-1] + (k + 1) * (period or PERIOD)), tried + 1
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                estimate = one.step(t, bad, u)
            call = f"{CALL} with measurements {bad}"
            numbers(f"{call}: q", estimate.q, (model.nq,))
            numbers(f"{call}: v", estimate.v, (model.nv,))
        return f"{tried} calls"

    def starts_again() -> str:
        one = begun()
        first = estimates(one)
        if not hasattr(one, "reset"):
            return "it has no reset"
        one.reset()
        _equal(first, estimates(one), "after reset()")
        return ""

    def copied() -> None:
        half, one = count // 2, begun()
        whole = estimates(begun())
        for t in times[:half]:
            one.step(float(t), measured.copy(), u.copy())
        for name, twin in copies(one).items():
            _equal(whole[half:], estimates(twin, half), f"{name}(observer) after {half} steps")

    def quick() -> str:
        one = begun()
        steps = [lambda t=t: one.step(float(t), measured.copy(), u.copy()) for t in times]
        again = begun()
        return timed([lambda: again.step(-1.0, measured.copy(), u), *steps][1:], period, CALL)

    checks.run("estimates are finite and of the robot's size", lambda: _none(estimates(begun())))
    checks.run("equal calls give equal answers", lambda: _equal(
        estimates(begun()), estimates(begun()), "two new objects, the same calls"))  # fmt: skip
    checks.run("reset begins anew", starts_again)
    checks.run("copies and pickles go on alike", copied)
    checks.run("hostile readings give finite estimates", hostile)
    checks.run("a step is shorter than the period", quick)
    return checks.report("observer")


def _none(_: Any) -> None:
    """No detail."""


def _equal(one: list[np.ndarray], other: list[np.ndarray], call: str) -> None:
    for k, (first, second) in enumerate(zip(one, other, strict=True)):
        expect(np.array_equal(first, second), f"{call}, step {k}: q, v", f"{first}", second)
