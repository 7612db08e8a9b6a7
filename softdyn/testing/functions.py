"""Conformance of tasks, barriers and references, whose derivatives are held against differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.safety.clearance import Values
from softdyn.tasks import Target, TaskError
from softdyn.tasks.targets import StackedReference
from softdyn.testing import samples
from softdyn.testing.report import (
    STEP,
    Checks,
    Conformance,
    Unmet,
    close,
    copies,
    expect,
    numbers,
)


def check_task(
    task: Any, model: SoftModel, *, target: Any = None, count: int = 5, seed: int = 0
) -> Conformance:
    """RuleResult a task: ``evaluate(state, target) -> TaskError`` of a `softdyn.tasks.Task`.

    Parameters
    ----------
    task : Any
        A task, a class that is built as ``CLASS(model)``, or a function that builds one.
    model : SoftModel
        The robot.
    target : Any, optional
        A constant target or reference; by default the task's own, else the tip at q = 0.
    count, seed : int
        Number of random states, and their seed.
    """
    checks = Checks(task, model)
    if not checks.run("it is built", lambda: type(checks.make()).__name__):
        return checks.report("task")
    one, states = checks.make(), samples.states(model, count + 1, seed)[1:]

    tip = SetPoint(model.state(model.q0, np.zeros(model.nv)).y)
    goal: Reference = StackedReference({one.name: target or tip, "the tip of the log": tip})
    if target is None and getattr(one, "target", None) is not None:
        goal = tip  # its own target counts

    def at(state: State) -> TaskError:
        found = one(state, goal)
        rows = len(np.atleast_1d(found.error))
        shapes = ((rows,), (rows,), (rows, model.nv), (rows,))
        parts = zip(TaskError._fields, found, shapes, strict=True)
        return TaskError(
            *(numbers(f"evaluate(…).{name}", value, size) for name, value, size in parts)
        )

    def shapes() -> str:
        rows = {len(at(state).error) for state in states}
        expect(len(rows) == 1, "len(evaluate(…).error)", "the same at each state", sorted(rows))
        size = getattr(one, "size", None)
        plain = getattr(one, "axes", None) is None and size is not None
        expect(not plain or rows == {size}, "len(evaluate(…).error)", f"size = {size}", rows)
        return f"{rows.pop()} rows"

    def rate() -> str:
        return _worst(
            close("evaluate(…).rate", at(state).rate, along(model, state, lambda s: at(s).error))
            for state in states
        )

    def jacobian() -> str:
        return _worst(
            close("evaluate(…).jacobian", at(state).jacobian,
                  by_velocity(model, state, lambda s: at(s).rate))
            for state in states
        )  # fmt: skip

    def drift() -> str:
        return _worst(
            close("evaluate(…).drift", at(state).drift, along(model, state, lambda s: at(s).rate))
            for state in states
        )

    checks.run("shapes, and finite numbers", shapes)
    checks.run("rate is the error's derivative", rate)
    checks.run("jacobian is the rate's derivative by the velocity", jacobian)
    checks.run("drift is the rate's derivative without accelerations", drift)
    checks.run("equal calls give equal answers", lambda: _repeats(at, states[0]))
    checks.run("copies and pickles", lambda: _none(copies(one)))
    return checks.report("task")


def check_barrier(barrier: Any, model: SoftModel, *, count: int = 5, seed: int = 0) -> Conformance:
    """RuleResult a barrier: ``rate`` and ``__call__(state) -> Values`` of a `ControlBarrier`.

    Parameters
    ----------
    barrier : Any
        A barrier, a class that is built as ``CLASS(model)``, or a function that builds one.
    model : SoftModel
        The robot.
    count, seed : int
        Number of random states, and their seed.
    """
    checks = Checks(barrier, model)
    if not checks.run("it is built", lambda: type(checks.make()).__name__):
        return checks.report("barrier")
    one, states = checks.make(), samples.states(model, count + 1, seed)[1:]

    def at(state: State) -> Values:
        found = one(state)
        rows = len(np.atleast_1d(found[0]))
        shapes = ((rows,), (rows, model.nv), (rows,), (rows,))
        parts = zip(Values._fields, found, shapes, strict=True)
        return Values(
            *(numbers(f"barrier(state).{name}", value, size) for name, value, size in parts)
        )

    def shapes() -> str:
        rate = float(one.rate)
        expect(np.isfinite(rate) and rate > 0, "barrier.rate", "a number > 0 (1/s)", rate)
        rows = {len(at(state).b) for state in states}
        expect(len(rows) == 1, "len(barrier(state).b)", "the same at each state", sorted(rows))
        units = [float(at(state).unit.min(initial=1.0)) for state in states]
        expect(min(units) > 0, "barrier(state).unit", "units > 0", min(units))
        return f"{rows.pop()} rows, rate {rate:g} 1/s"

    def gradient() -> str:
        return _worst(
            close("barrier(state).gradient", at(state).gradient,
                  by_configuration(model, state, lambda s: at(s).b))
            for state in states
        )  # fmt: skip

    def drift() -> str:
        return _worst(
            close("barrier(state).drift", at(state).drift,
                  along(model, state, lambda s: at(s).gradient @ s.v))
            for state in states
        )  # fmt: skip

    checks.run("shapes, and finite numbers", shapes)
    checks.run("gradient is the derivative of b", gradient)
    checks.run("drift is the second derivative without accelerations", drift)
    checks.run("equal calls give equal answers", lambda: _repeats(at, states[0]))
    checks.run("copies and pickles", lambda: _none(copies(one)))
    return checks.report("barrier")


def check_reference(
    reference: Any, model: SoftModel, *, duration: float = 10.0, count: int = 50, seed: int = 0
) -> Conformance:
    """RuleResult a reference: ``__call__(t) -> Reference``, or targets of several tasks.

    Parameters
    ----------
    reference : Any
        A reference, or a class that is built as ``CLASS(model)``.
    model : SoftModel
        The robot.
    duration : float
        The times are random ones in [0, duration] (s).
    count, seed : int
        Number of times, and their seed.
    """
    checks = Checks(reference, model)
    if not checks.run("it is built", lambda: type(checks.make()).__name__):
        return checks.report("reference")
    one = checks.make()
    times = np.random.default_rng(seed).uniform(STEP, duration, count)

    def parts(t: float) -> dict[str, Any]:
        value = one(float(t))
        targets = getattr(value, "targets", None)
        return {"": value} if targets is None else dict(targets)

    def finite() -> None:
        for t in (0.0, *times):
            for name, part in parts(t).items():
                of = f"reference({t:g}){name and '.' + name}"
                expect(isinstance(part, Reference | Target) or hasattr(part, "y"), of,
                       "a Reference(y, ydot, yddot)", part)  # fmt: skip
                for kind in ("y", "ydot", "yddot"):
                    value = np.asarray(getattr(part, kind), dtype=float)
                    expect(bool(np.isfinite(value).all()), f"{of}.{kind}", "finite numbers", value)

    def derivative(value: str, of: str) -> str:
        details = []
        for t in times:
            for name, part in parts(t).items():
                found = np.asarray(getattr(part, value), dtype=float)
                before, after = (
                    np.asarray(getattr(parts(t + step)[name], of), dtype=float)
                    for step in (-STEP, STEP)
                )
                if found.shape == before.shape:  # a rotation has another rate
                    call = f"reference({t:g}).{value}"
                    details.append(close(call, found, (after - before) / (2 * STEP)))
        return _worst(details)

    checks.run("finite numbers", finite)
    checks.run("ydot is the derivative of y", lambda: derivative("ydot", "y"))
    checks.run("yddot is the derivative of ydot", lambda: derivative("yddot", "ydot"))

    def repeats() -> None:
        for t in (*times, *times[::-1]):
            for name, part in parts(t).items():
                again = parts(t)[name]
                expect(np.array_equal(part.y, again.y), f"reference({t:g}).y", f"{part.y}", again.y)

    checks.run("equal times give equal answers", repeats)
    checks.run("copies and pickles", lambda: _none(copies(one)))
    return checks.report("reference")


def along(model: SoftModel, state: State, value: Callable[[State], np.ndarray]) -> np.ndarray:
    """d/dt of a function of the state along a motion of constant velocity."""
    after, before = (
        value(model.state(model.integrate(state.q, step * state.v), state.v))
        for step in (STEP, -STEP)
    )
    return (after - before) / (2 * STEP)


def by_configuration(
    model: SoftModel, state: State, value: Callable[[State], np.ndarray]
) -> np.ndarray:
    """∂/∂q of a function of the state (rows, nv), by the tangent of q."""
    columns = []
    for direction in np.eye(model.nv):
        after, before = (
            value(model.state(model.integrate(state.q, step * direction), state.v))
            for step in (STEP, -STEP)
        )
        columns.append((after - before) / (2 * STEP))
    return np.stack(columns, axis=1)


def by_velocity(model: SoftModel, state: State, value: Callable[[State], np.ndarray]) -> np.ndarray:
    """∂/∂v of a function of the state (rows, nv); it may be of the second degree in v."""
    columns = [
        (value(model.state(state.q, state.v + one)) - value(model.state(state.q, state.v - one)))
        / 2
        for one in np.eye(model.nv)
    ]
    return np.stack(columns, axis=1)


def _repeats(at: Callable[[State], Any], state: State) -> None:
    for first, second in zip(at(state), at(state), strict=True):
        expect(np.array_equal(first, second), "the same call again", f"{first}", second)


def _none(_: Any) -> None:
    """No detail."""


def _worst(details: Any) -> str:
    """The largest of the distances."""
    found = list(details)
    if not found:
        raise Unmet("no values to compare")
    return max(found, key=lambda text: float(text.split()[0]))
