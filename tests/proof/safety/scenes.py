"""Runs of whole arms among obstacles, judged by MuJoCo's own distances in every plant step.

A scene has a half-space, a ball and a box where the free arm's links pass on their way to a target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from tqdm.auto import tqdm

from softdyn import Reference, SoftModel, State, statics
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.controllers.safety_filter import with_barriers
from softdyn.safety import HalfSpace, KeepOutBox, KeepOutSphere, Surroundings
from softdyn.safety.obstacles import Obstacle
from softdyn.validation import Log, Twin, simulate
from softdyn.validation.loop.setups import setup_of

DURATION, ARRIVAL = 3.0, 2.0  # s
CLEAR = 0.03  # of the arm's length: least distance of every obstacle at the start
FAR = 10.0  # m
TRIES = 100  # places of an obstacle; a target without a place is left out
DEEP = 1e-4  # m: a penetration that counts


class JudgedTwin(Twin):
    """A twin that keeps the least of MuJoCo's distances between links and obstacles."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.least = np.inf
        super().__init__(*arguments, **options)
        self.model.opt.ccd_tolerance = 1e-9
        walls = [self.model.geom(f"obstacle_{k}").id for k in range(len(self.obstacles))]
        of_links = np.setdiff1d(np.flatnonzero(self.model.geom_bodyid > 0), walls)
        self._pairs = [(wall, int(link)) for wall in walls for link in of_links]

    def advance(self, u: np.ndarray, steps: int = 1) -> None:
        """Advance one plant step at a time."""
        for _ in range(steps):
            super().advance(u)
            mujoco.mj_kinematics(self.model, self.data)
            for pair in self._pairs:
                found = mujoco.mj_geomDistance(self.model, self.data, *pair, FAR, None)
                self.least = min(self.least, found)


@dataclass(frozen=True, eq=False)
class Approach:
    """A straight way from `start` to `end` (3,) at rest at both ends, and then the end."""

    start: np.ndarray
    end: np.ndarray

    def __call__(self, t: float) -> Reference:
        """The quintic with zero rates at both ends."""
        s, way = min(t / ARRIVAL, 1.0), self.end - self.start
        rates = (s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / ARRIVAL,
                 60 * s * (1 - s) * (1 - 2 * s) / ARRIVAL**2)  # fmt: skip
        return Reference(self.start + rates[0] * way, rates[1] * way, rates[2] * way)


@dataclass(frozen=True)
class Scene:
    """Obstacles on the way of an arm to a target, and its run without barriers."""

    target: Approach
    around: Surroundings
    free: Log


def scenes(model: SoftModel, gains: Gains | None, count: int, seed: int) -> Iterator[Scene]:
    """Seeded scenes of three obstacles each; all are clear of the arm at rest.

    A target is the tip of a stable equilibrium under random inputs. Each obstacle is near a link
    at some time of the run without barriers. An arm that moves along itself leaves no clear place.
    """
    rng, start = np.random.default_rng(seed), statics.rest(model)
    state = model.state(start.q, np.zeros(model.nv))
    rests = (rest for k in range(TRIES) for rest in statics.spread_rests(model, count, seed + k))
    for rest in rests:
        target = Approach(state.y, rest.y)
        law = with_barriers(SoftIdClfQp, Surroundings(()))(model, gains)
        free = simulate(model, law, target, duration=DURATION, period=setup_of(model).period,
                        q0=start.q)  # fmt: skip
        found = [_placed(model, state, kind, free, rng) for kind in (wall, ball, crate)]
        made = [obstacle for obstacle in found if obstacle is not None]
        if len(made) == len(found):
            yield Scene(target, Surroundings(made), free)
            count -= 1
        if not count:
            return


def _placed(
    model: SoftModel, start: State, kind: Callable[..., Obstacle], free: Log,
    rng: np.random.Generator,
) -> Obstacle | None:  # fmt: skip
    """An obstacle in the way that is clear of the arm at the start; None if none is found."""
    length = model.robot.length
    for _ in range(TRIES):
        obstacle = kind(rng, *on_the_way(model, free, rng), length)
        if obstacle.reserve(start) > CLEAR * length:
            return obstacle
    return None


def on_the_way(
    model: SoftModel, free: Log, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A place that a link passes in a run, and the direction in which it passes."""
    names = [joint.child for joint in model.robot.chain(model.robot.task) if joint.moves]
    link = names[rng.integers(len(names) // 2, len(names))]
    last = free.finite_samples - 1
    gone = np.linalg.norm(free.y - free.y[0], axis=1)
    gone /= max(gone[: last + 1].max(), 1e-9)
    k = int(np.argmax(gone > rng.uniform(0.3, 0.9)))
    here, there = (model.link_poses(free.q[i])[link][:3, 3] for i in (0, k))
    way = there - here
    return there, way / max(float(np.linalg.norm(way)), 1e-9)


def wall(rng: np.random.Generator, at: np.ndarray, way: np.ndarray, length: float) -> Obstacle:
    """A half-space whose wall a link would pass."""
    normal = -way + 0.4 * rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    return HalfSpace(normal, float(normal @ at), links="all", contact=False)


def ball(rng: np.random.Generator, at: np.ndarray, way: np.ndarray, length: float) -> Obstacle:
    """A ball on the way of a link."""
    radius = rng.uniform(0.05, 0.1) * length
    beside = rng.normal(size=3)
    beside *= 0.7 * radius / np.linalg.norm(beside)
    return KeepOutSphere(at + radius * way + beside, radius, links="all", contact=False)


def crate(rng: np.random.Generator, at: np.ndarray, way: np.ndarray, length: float) -> Obstacle:
    """A box on the way of a link."""
    size = rng.uniform(0.08, 0.2, 3) * length
    centre = at + 0.5 * size.min() * way + 0.2 * size.min() * rng.normal(size=3)
    return KeepOutBox(centre, size, rpy=rng.uniform(-3, 3, 3), links="all", contact=False)


def run(model: SoftModel, gains: Gains | None, scene: Scene) -> dict[str, Any]:
    """The figures of a scene's run with barriers, beside those of the run without."""
    made: list[JudgedTwin] = []

    def twin(*arguments: Any, **options: Any) -> Twin:
        made.append(JudgedTwin(*arguments, **options))
        return made[-1]

    law = with_barriers(SoftIdClfQp, scene.around)(model, gains)
    log = simulate(model, law, scene.target, duration=DURATION, period=setup_of(model).period,
                   q0=scene.free.q[0], plant=twin, surroundings=scene.around)  # fmt: skip
    rows = law.barrier_rows
    assert rows is not None
    free = min(
        float(scene.around.reserve(model.state(q, v)).min())
        for q, v in zip(scene.free.q[::5], scene.free.v[::5], strict=True)
        if np.isfinite(q).all()
    )
    return {
        "free_mm": 1e3 * free, "least_mm": 1e3 * made[0].least, "relaxed": rows.relaxed,
        "braked": rows.braked,
        "reserve_mm": 1e3 * min(log.least_reserve.values()),
        "relaxation": rows.relaxation, "outside": rows.outside, "fallbacks": log.fallbacks,
        "error_cm": log.final_error_cm, "free_error_cm": scene.free.final_error_cm,
        "step_us": float(np.median(log.step_us)),
        "p99_us": float(np.percentile(log.step_us, 99)),
        "free_step_us": float(np.median(scene.free.step_us)), "failed": log.failed,
        "steps": log.steps,
        "reason": log.reason,
    }  # fmt: skip


def runs(
    model: SoftModel, count: int, seeds: Sequence[int], earlier: Sequence[dict[str, Any]] = ()
) -> Iterator[list[dict[str, Any]]]:
    """All runs so far of a robot's scenes, again after each run.

    Parameters
    ----------
    model : SoftModel
        The robot.
    count : int
        Number of scenes of each seed.
    seeds : sequence of int
        Seeds of scenes.
    earlier : sequence of dict
        Runs that are not run again.
    """
    gains, found = None if model.bundled else Gains(Kp=100.0, eps=0.1), list(earlier)
    if found:
        yield found
    known = {(one.get("seed"), one.get("scene")) for one in found}
    for seed in seeds:
        if all((seed, k) in known for k in range(count)):
            continue
        made = tqdm(scenes(model, gains, count, seed), total=count, desc=model.name, disable=None)
        for k, scene in enumerate(made):
            if (seed, k) not in known:
                found = [*found, {"seed": seed, "scene": k} | run(model, gains, scene)]
                yield found


COLUMNS = (
    ("robot", "robot", ""),
    ("seeds", "seeds", ""),
    ("scenes", "scenes", "d"),
    ("in the way by, median (mm)", "free_mm", ".0f"),
    ("runs without relaxed rows", "whole", "d"),
    ("of these deeper than 0.1 mm", "deeper", "d"),
    ("their depth, at most (mm)", "deepest_mm", ".2f"),
    ("runs with relaxed rows", "relaxed", "d"),
    ("their depth, at most (mm)", "relaxed_mm", ".2f"),
    ("steps without rows over the horizon (%)", "braked_percent", ".1f"),
    ("lost", "lost", "d"),
    ("error, median (cm)", "error_cm", ".2f"),
    ("free", "free_error_cm", ".2f"),
)


def summary(robot: str, runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """A row of the table. A depth is positive inside an obstacle."""
    whole = [-run["least_mm"] for run in runs if not run["relaxed"]]
    relaxed = [-run["least_mm"] for run in runs if run["relaxed"]]
    medians = {
        key: float(np.median([run[key] for run in runs if np.isfinite(run[key])]))
        for key in ("error_cm", "free_error_cm", "step_us", "free_step_us")
    }
    return {
        "robot": robot, "seeds": ", ".join(dict.fromkeys(str(run["seed"]) for run in runs)),
        "scenes": len(runs), "whole": len(whole), "relaxed": len(relaxed),
        "free_mm": float(np.median([-run["free_mm"] for run in runs])),
        "deeper": sum(depth > 1e3 * DEEP for depth in whole),
        "deepest_mm": max(whole, default=None), "relaxed_mm": max(relaxed, default=None),
        "braked_percent": 100 * float(np.mean([run["braked"] / run["steps"] for run in runs])),
        "lost": sum(not np.isfinite(run["error_cm"]) for run in runs), "runs": list(runs),
    } | medians  # fmt: skip
