"""The tip near an obstacle: the published controller, that over a horizon, that with barriers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from softdyn import SetPoint, SoftModel
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.controllers.barriers import JointLimits
from softdyn.safety import KeepOutSphere, Surroundings
from softdyn.validation.loop import setups
from softdyn.validation.loop.log import Log
from softdyn.validation.simulate import simulate
from softdyn.validation.studies.study_targets import points

BALL = 0.08  # radius of the ball, as a share of the robot's length
OFFSET = 0.6  # of its radius: distance of its centre from the path


@dataclass(frozen=True)
class Encounters:
    """Runs near obstacles.

    Attributes
    ----------
    ball : KeepOutSphere
        The obstacle beside the path to the set point.
    logs : dict[str, Log]
        The three runs to the set point by name. The last has the ball as a barrier.
    report : dict
        The figures of these and of the random runs, with the keys of the command's JSON.
    """

    ball: KeepOutSphere
    logs: dict[str, Log]
    report: dict[str, Any]

    def __str__(self) -> str:
        """One line per run, and one for all random runs."""
        lines = [f"{'':16} error cm  clearance mm  violation  gave way  step us"]
        rows, random = self.report["runs"][:3], self.report["runs"][3:]
        lines += [
            f"{row['name']:16} {row['final_error_cm']:8.2f} {row['clearance_mm']:13.2f} "
            f"{row['violation']:10.2f} {row['relaxed']:9d} {row['step_us']:8.0f}"
            for row in rows
        ]
        if random:
            lines.append(
                f"{len(random)} random runs: worst violation "
                f"{max(row['violation'] for row in random):.2f} mm or 0.01 rad, "
                f"{sum(row['relaxed'] > 0 for row in random)} in which rows gave way, "
                f"{sum(row['fallbacks'] for row in random)} fallbacks, "
                f"{sum(row['failed'] for row in random)} that did not approach the target"
            )
        guarded = self.report["runs"][2:]
        steps, states = (sum(row[key] for row in guarded) for key in ("relaxed", "outside"))
        if steps:
            lines.append(f"rows gave way at {steps} steps: no input within its bounds met them all")
        if not self.report["passed"]:
            lines.append(
                f"a barrier was violated by {self.report['worst_violation']:.2f} mm or 0.01 rad; "
                f"{states} states lie outside of what the rows keep (b < 0 or db/dt + alpha b < 0)"
            )
        return "\n".join(lines)


def meet(
    model: SoftModel,
    theta: float = 0.0,
    duration: float = 3.0,
    limits: bool = False,
    random: int = 0,
    seed: int = 0,
    gains: Gains | None = None,
    target: Any = None,
) -> Encounters:
    """Run the three controllers to a set point past a ball, then runs past random balls.

    Parameters
    ----------
    model : SoftModel
        The robot.
    theta : float
        The set point, in multiples of π.
    duration : float
        Duration of each run (s).
    limits : bool
        Whether the file's joint limits are barriers too.
    random, seed : int
        Number of runs to random targets beside random balls, all with barriers, and their seed.
    gains : Gains, optional
        The published ones of a bundled robot by default.
    target : array_like, (3,), optional
        The set point (m) instead of `theta`. For a robot that is not in the paper, the default is
        an equilibrium.

    Returns
    -------
    Encounters
        It is passed when no barrier was violated by more than 1 mm or 0.01 rad.
    """
    setup = setups.setup_of(model)
    plain = SoftIdClfQp(model, gains)
    radius, tau = BALL * setup.length, plain.gains.eps

    def run(law: SoftIdClfQp, goal: Any, *balls: KeepOutSphere) -> Log:
        around = Surroundings(balls) if balls else None
        return simulate(model, law, goal, duration=duration, period=setup.period,
                        surroundings=around)  # fmt: skip

    def barriers(ball: KeepOutSphere) -> SoftIdClfQp:
        walls = [JointLimits(model)] if limits else []
        return SoftIdClfQp(model, gains, horizon=tau, barriers=[ball, *walls])

    if target is None and model.bundled not in setups.ROBOTS:
        target = points(model, 1)[0]
    goal = setup.set_point(theta) if target is None else setup.target(target)
    laws = {"published": plain, "with a horizon": SoftIdClfQp(model, gains, horizon=tau)}
    logs = {name: run(law, goal) for name, law in laws.items()}
    ball = in_the_way([log.y for log in logs.values()], radius)
    laws["with barriers"] = barriers(ball)
    logs["with barriers"] = run(laws["with barriers"], goal, ball)
    rows = [figures(name, law, logs[name], ball) for name, law in laws.items()]

    rng = np.random.default_rng(seed)
    start = model.state(model.q0, np.zeros(model.nv)).y
    for k in tqdm(range(random), disable=None, leave=False):
        target, other = draw(model, rng, start, radius)
        law = barriers(other)
        rows.append(figures(f"random {k}", law, run(law, target, other), other))
    worst = max(row["violation"] for row in rows[2:])
    report = {
        "robot": model.name, "horizon_s": tau, "limits": limits, "seed": seed, "radius_m": radius,
        "worst_violation": worst, "passed": worst <= 1.0, "runs": rows,
    }  # fmt: skip
    return Encounters(ball, logs, report)


def in_the_way(paths: Sequence[np.ndarray], radius: float) -> KeepOutSphere:
    """The ball beside a path (samples, 3) of the tip into which all paths enter the deepest."""

    def depth(ball: KeepOutSphere) -> float:
        return min(ball.radius - np.linalg.norm(y - ball.centre, axis=1).min() for y in paths)

    # balls cut their own path alike: of those as deep, to the thousandth, the one nearest half-way
    balls = list(_beside(paths, radius))
    deepest = max(map(depth, balls))
    return next(ball for ball in balls if depth(ball) > deepest - 1e-3 * radius)


def _beside(paths: Sequence[np.ndarray], radius: float) -> Iterable[KeepOutSphere]:
    for path in paths:
        left = np.linalg.norm(path - path[-1], axis=1)
        for share in (0.5, 0.4, 0.6, 0.3, 0.7):  # half-way first
            k = max(int(np.argmax(left < left[0] * share)), 1)
            along = path[k + 1] - path[k - 1]
            # normal to the path in the xz-plane, or normal to the path and z where that fails
            beside = np.array([-along[2], 0.0, along[0]])
            if np.linalg.norm(beside) < 0.1 * np.linalg.norm(along):
                beside = np.array([-along[1], along[0], 0.0])
            beside = beside / np.linalg.norm(along)
            for side in (-OFFSET, OFFSET):
                yield KeepOutSphere(path[k] + side * radius * beside, radius, contact=False)


def draw(
    model: SoftModel, rng: np.random.Generator, start: np.ndarray, radius: float
) -> tuple[SetPoint, KeepOutSphere]:
    """A target that a random configuration reaches, and a ball near the line to it."""
    while True:
        low, high = np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0)
        y = model.state(model.configuration(0.6 * rng.uniform(low, high)), np.zeros(model.nv)).y
        centre = start + rng.uniform(0.3, 0.7) * (y - start) + OFFSET * radius * rng.normal(size=3)
        if min(np.linalg.norm(start - centre), np.linalg.norm(y - centre)) > 1.2 * radius:
            return SetPoint(y), KeepOutSphere(centre, radius, contact=False)


def figures(name: str, law: SoftIdClfQp, log: Log, ball: KeepOutSphere) -> dict[str, Any]:
    """The figures of a run; `violation` is the worst, in mm or (joint limits) in 0.01 rad."""
    clearance = 1e3 * float((np.linalg.norm(log.y - ball.centre, axis=1) - ball.radius).min())
    rows = law.barrier_rows
    return {
        "name": name,
        "final_error_cm": 100 * float(np.linalg.norm(log.error[-1])),
        "clearance_mm": clearance,
        "violation": rows.violation if rows is not None else -clearance,
        "relaxed": rows.relaxed if rows is not None else 0,
        "outside": rows.outside if rows is not None else 0,
        "fallbacks": log.fallbacks,
        "failed": log.failed,
        "step_us": float(np.median(log.step_us)),
    }
