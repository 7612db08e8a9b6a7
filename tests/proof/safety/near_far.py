"""Runs with an obstacle far away, beside the arm's end, and in it, beside the run without.

The obstacles are barriers of the controller only. The plant does not know them, so that nothing but
the barrier keeps the arm out.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

from softdyn import SoftdynError, SoftModel, statics
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.controllers.barriers import UnsafeStart
from softdyn.controllers.proposed_gains import propose
from softdyn.controllers.safety_filter import with_barriers
from softdyn.safety import KeepOutSphere, Surroundings
from softdyn.statics import Equilibrium
from softdyn.validation import Log, simulate
from softdyn.validation.loop.setups import setup_of

RADIUS = 0.08  # of the arm's length, like the next three
BESIDE = 0.01  # room between the ball and the free run's end
INSIDE = 0.015  # depth of the free run's end in the ball
AWAY = 4.0
THETA = 1.0  # set point of the paper's robots, in multiples of π
PERIOD = 0.005  # s, of other arms
LAST = 0.1  # s: the error is a mean over the last ones, because some runs chatter
FAR_SHARE, FAR_CM, NEAR_SHARE, DEEP_MM = 1.1, 0.02, 2.0, 0.1  # what a run may miss


def error_cm(log: Log) -> float:
    """The mean distance (cm) of the tip from its target at the end of a run."""
    last = max(round(LAST / log.period), 1)
    return 100 * float(np.linalg.norm(log.error[-last:], axis=1).mean())


def ball(model: SoftModel, free: Log, room: float) -> KeepOutSphere:
    """A ball ahead of the tip whose distance from the arm at the end of a run is `room` (m).

    It lies on the tip's way, beyond the end. The ball moves away from the arm until it has the
    room.
    """
    radius = RADIUS * model.robot.length
    last = int(np.argmax(np.linalg.norm(free.y - free.y[-1], axis=1) < 2 * radius))
    way = free.y[-1] - free.y[max(last - 1, 0)]
    state, low, high = model.state(free.q[-1], np.zeros(model.nv)), 0.0, 6 * radius
    make = partial(KeepOutSphere, radius=radius, links="all")
    for _ in range(40):
        middle = (low + high) / 2
        there = make(free.y[-1] + middle * way / np.linalg.norm(way))
        low, high = (low, middle) if there.reserve(state) > room else (middle, high)
    return make(free.y[-1] + high * way / np.linalg.norm(way))


def nearest(
    model: SoftModel, obstacle: KeepOutSphere, target: np.ndarray, ends: Sequence[Log]
) -> float:
    """The least distance (m) from the target of equilibria outside an obstacle, from runs' ends.

    Found by SLSQP over the inputs, whose equilibria follow one another. Infinite if none is found.
    """
    span, length, least = model.u_max - model.u_min, model.robot.length, np.inf
    for log in ends:
        known: dict[bytes, Equilibrium] = {}
        start = np.clip((log.u[-1] - model.u_min) / span, 0, 1)
        try:
            known[b""] = statics.settle(model, model.u_min + start * span, log.q[-1])
        except SoftdynError:
            continue

        def at(x: np.ndarray, known: dict[bytes, Equilibrium] = known) -> Equilibrium:
            if (key := x.tobytes()) not in known:
                last = known[next(reversed(known))]
                try:
                    u = model.u_min + np.clip(x, 0, 1) * span
                    known[key] = statics.settle(model, u, last.q)
                except SoftdynError:
                    known[key] = last
            return known[key]

        def reserve(x: np.ndarray, at: Any = at) -> float:
            return obstacle.reserve(model.state(at(x).q, np.zeros(model.nv))) / length

        def away(x: np.ndarray, at: Any = at) -> float:
            return float(np.linalg.norm(at(x).y - target)) / length

        found = minimize(
            lambda x, away=away: 1e4 * away(x) ** 2, start, bounds=[(0, 1)] * model.nu,
            constraints={"type": "ineq", "fun": lambda x, reserve=reserve: 1e2 * reserve(x)},
            method="SLSQP", options={"maxiter": 60},
        )  # fmt: skip
        if reserve(found.x) > -1e-5:
            least = min(least, away(found.x) * length)
    return least


def runs(model: SoftModel, target: Any = None, duration: float = 3.0) -> Iterator[dict[str, Any]]:
    """The figures of a robot's runs: without an obstacle, with a far one, and with near ones.

    Parameters
    ----------
    model : SoftModel
        The robot. One that is not bundled gets the gains of `propose`.
    target : array_like, (3,), optional
        The set point (m); by default the paper's at `THETA`, or an equilibrium of another arm.
    duration : float
        Duration of each run (s).
    """
    setup = setup_of(model)
    period = setup.period if model.bundled else PERIOD
    gains: Gains | None = None if model.bundled else propose(model, period).gains
    if target is None and not model.bundled:
        target = statics.spread_rests(model, 1)[0].y
    goal = setup.set_point(THETA) if target is None else setup.target(target)

    def run(*obstacles: KeepOutSphere) -> tuple[Log, SoftIdClfQp]:
        law = with_barriers(SoftIdClfQp, Surroundings(obstacles))(model, gains)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnsafeStart)
            return simulate(model, law, goal, duration=duration, period=period), law

    free, _ = run()
    length, least = model.robot.length, error_cm(free)
    end = np.asarray(free.y_ref[-1])
    row = {"robot": model.name, "free_cm": least}
    far = KeepOutSphere(end + AWAY * length, RADIUS * length, links="all")
    near = {
        "beside": ball(model, free, BESIDE * length), "inside": ball(model, free, -INSIDE * length),
    }  # fmt: skip
    for name, obstacle in {"far": far, **near}.items():
        log, law = run(obstacle)
        rows, error = law.barrier_rows, error_cm(log)
        states = [model.state(q, np.zeros(model.nv)) for q in log.q]
        reserves = [obstacle.reserve(state) for state in states]
        best = 0.0 if name == "far" else 100 * nearest(model, obstacle, end, [free, log])
        most = FAR_SHARE * least + FAR_CM if name == "far" else NEAR_SHARE * max(best, least)
        deep = -1e3 * min(reserves)
        yield row | {
            "obstacle": name, "start_mm": 1e3 * reserves[0], "error_cm": error, "depth_mm": deep,
            "best_cm": None if name == "far" else best, "relaxed": rows.relaxed if rows else 0,
            "activity": log.verdict(None).activity,
            "passed": bool(error <= most and deep <= DEEP_MM),
        }  # fmt: skip


COLUMNS = (
    ("robot", "robot", ""),
    ("error without (cm)", "free_cm", ".3f"),
    ("obstacle", "obstacle", ""),
    ("from the arm at the start (mm)", "start_mm", ".0f"),
    ("error (cm)", "error_cm", ".3f"),
    ("nearest equilibrium outside (cm)", "best_cm", ".3f"),
    ("depth, at most (mm)", "depth_mm", ".2f"),
    ("steps with relaxed rows", "relaxed", "d"),
    ("inputs change (ranges/s)", "activity", ".2f"),
    ("within the aim", "passed", ""),
)
