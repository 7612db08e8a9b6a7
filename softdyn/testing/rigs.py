"""Conformance of a plant and of a rig's driver."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from softdyn import SoftModel
from softdyn.controllers.channels import checked_values
from softdyn.testing import samples
from softdyn.testing.report import Checks, Conformance, Unmet, expect, numbers
from softdyn.validation.bench import driver as drivers

PLANT = ("start", "state", "sample", "see", "advance")
SLOW = 0.1  # s; a read or a send that takes longer waits for something


def check_plant(plant: Any, model: SoftModel, *, steps: int = 5, periods: int = 5) -> Conformance:
    """RuleResult a plant: `softdyn.validation.Plant`, which a loop moves instead of the twin.

    Parameters
    ----------
    plant : Any
        A class that is built as ``CLASS(model)``, a function that builds one, or an object.
    model : SoftModel
        The robot.
    steps : int
        Steps of the plant in a period.
    periods : int
        Periods of a run.
    """
    checks = Checks(plant, model)
    if not checks.run("it is built", lambda: type(checks.make()).__name__):
        return checks.report("plant")
    start = samples.states(model, 1, 0)[0]
    u = np.clip(0.1 * np.nan_to_num(model.u_max), model.u_min, model.u_max)

    def methods() -> None:
        one = checks.make()
        missing = [name for name in PLANT if not callable(getattr(one, name, None))]
        expect(not missing, "plant", f"the methods {', '.join(PLANT)}", f"no {missing[:1]}")
        for name, kind in (("channels", tuple), ("real_time", bool), ("alters_states", bool)):
            value = getattr(one, name)
            expect(isinstance(value, kind), f"plant.{name}", f"a {kind.__name__}", value)
        dict(one.settings)

    def run() -> list[np.ndarray]:
        one = checks.make()
        one.start(start.q.copy(), start.v.copy())
        numbers("plant.sent after start(q, v)", one.sent, np.shape(one.sent))
        found = []
        for _ in range(periods):
            at = one.state()
            if at is not None:
                q = numbers("plant.state()[0]", at[0], (model.nq,))
                found.append(np.concatenate((q, numbers("plant.state()[1]", at[1], (model.nv,)))))
            seen = start if at is None else one.see(model.state(*at))
            given = {**one.sample(), **one.advance(u.copy(), steps, seen)}
            checked_values(one.channels, given, "plant.sample(), plant.advance(u, steps, seen)")
        return found

    def repeats() -> str:
        if checks.make().real_time:
            return "a plant in real time"
        for k, (one, other) in enumerate(zip(run(), run(), strict=True)):
            expect(np.array_equal(one, other), f"two runs, period {k}: q, v", f"{one}", other)
        return ""

    def begins() -> None:
        one = checks.make()
        one.start(start.q.copy(), start.v.copy())
        at = one.state()
        if at is not None and not np.allclose(at[0], start.q, atol=1e-9):
            raise Unmet(f"plant.start(q, v); plant.state()[0]: expected {start.q}, got {at[0]}")

    checks.run("methods and attributes", methods)
    checks.run("it begins in the given state", begins)
    checks.run("states and readings of a run", lambda: f"{len(run())} states")
    checks.run("equal runs are equal", repeats)
    return checks.report("plant")


def check_driver(driver: Any, model: SoftModel, *, reads: int = 5) -> Conformance:
    """RuleResult a rig's driver: `softdyn.validation.Driver`. The motors only get relaxed commands.

    Parameters
    ----------
    driver : Any
        A class that is built as ``CLASS(model)``, a function that builds one, or an object.
    model : SoftModel
        The robot, with the rig's sensors.
    reads : int
        Number of readings.
    """
    checks = Checks(driver, model)
    if not checks.run("it is built", lambda: type(checks.make()).__name__):
        return checks.report("driver")
    relaxed = model.relaxed
    state = samples.states(model, 1, 0)[0]
    size = len(model.measure(state, relaxed).values) if model.robot.sensors else None
    one = checks.make()
    if not checks.run("it has the methods", lambda: _none(drivers.check_driver(one))):
        return checks.report("driver")

    def read() -> str:
        fresh = 0
        for _ in range(reads):
            begin = time.monotonic()
            values, stamps = (np.asarray(part, dtype=float) for part in one.read())
            took = time.monotonic() - begin
            expect(took < SLOW, "driver.read()", "no wait", f"{took:.3f} s")
            wanted = values.shape if size is None else (size,)
            expect(values.ndim == 1 and values.shape == wanted, "driver.read()[0]",
                   f"shape {wanted}", f"shape {values.shape}")  # fmt: skip
            expect(stamps.shape == values.shape, "driver.read()[1]",
                   f"shape {values.shape}", f"shape {stamps.shape}")  # fmt: skip
            there = np.isfinite(values)
            fresh += int(there.any())
            newest = stamps[there].max(initial=-np.inf)
            ahead = newest - time.monotonic()
            expect(ahead <= drivers.FUTURE, "driver.read()[1]", "times of time.monotonic()",
                   f"{ahead:.3g} s ahead of it")  # fmt: skip
            begin = time.monotonic()
            one.send(relaxed.copy())
            took = time.monotonic() - begin
            expect(took < SLOW, "driver.send(commands)", "no wait", f"{took:.3f} s")
        return f"{fresh} of {reads} reads had a value; none needs one, because read() never waits"

    checks.run("stop() before start()", lambda: one.stop())
    try:
        if checks.run("start()", lambda: one.start()):
            checks.run("read() and send(commands)", read)
    finally:
        checks.run("stop()", lambda: one.stop())
        checks.run("stop() again", lambda: one.stop())
    return checks.report("driver")


def _none(_: Any) -> None:
    """No detail."""
