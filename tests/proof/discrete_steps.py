"""Steps of `softdyn.dynamics.discrete_step`: Jacobians against differences, and violent steps.

First come A and B on random robots, every second one behind winches with lags and their states,
against central differences of fourth order. A column counts if its four neighbours hold the same
joints and have the same cables slack. Then come random steps at full inputs, from random shapes
with an eighth of the joints at each stop, with speeds up to 100 ranges a second, over 1 to 10 ms.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from time import perf_counter

import numpy as np

import softdyn
from softdyn import SoftModel
from softdyn.actuation import CommandKind, Winches
from softdyn.commands import cli
from softdyn.dynamics import StepError, discrete_step
from softdyn.dynamics.motors import Motors
from tests.support.arms import EVERYTHING, PROJECTIONS, loaded
from tests.support.random_robots import write_robot
from tests.support.robots import WALKER, WINCHED, write
from tests.support.step_differences import differences
from tests.support.wrapped_robots import wrapped_robot

EPILOG = "exit codes: 0 no step failed; 1 one failed; 2 bad input; 130 interrupted.\n"
PERIOD = 0.005
SMALL = 1e-3  # a block's numbers below this count as this

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", type=cli.count, default=20, metavar="N")
parser.add_argument("--states", type=cli.count, default=50, metavar="N")
parser.add_argument("--steps", type=cli.count, default=1000, metavar="N", help="of each robot")


def main(argv: Sequence[str] | None = None) -> int:
    """Print both tables; returns the exit code."""
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        _jacobians(Path(folder), arguments.robots, arguments.states)
        failures = 0
        print(f"{'robot':22}{'steps':>8}{'failed':>8}{'ms a step':>11}  steps by sub-steps")
        for name, model in _violent(Path(folder)):
            failures += _violently(name, model, arguments.steps)
    return cli.FAILED if failures else cli.PASSED


def _jacobians(folder: Path, robots: int, states: int) -> None:
    """The largest error of each robot, relative to the largest number of its block."""
    compared = left = 0
    worst = np.zeros(robots)
    for seed in range(robots):
        model = softdyn.load(write_robot(seed, folder))
        winched = seed % 2 == 1 and model.nu > 0
        if winched:
            model = _behind_winches(model)
        rng = np.random.default_rng(seed)
        for _ in range(states):
            low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
            q, v = model.configuration(rng.uniform(low, high)), rng.normal(size=model.nv)
            u = rng.uniform(np.maximum(model.u_min, -5), np.minimum(model.u_max, 5))
            acting = None
            if winched:
                u = Winches(model).commands(model.state(q, v), u)
                acting = Motors(model).settled(q, v, u) + 1e-3 * rng.normal(size=model.nu)
            found = discrete_step(model, q, v, u, PERIOD, motors=winched, acting=acting)
            right = np.hstack((found.A, found.B))
            expected = differences(model, q, v, u, PERIOD, found, acting)
            kept = np.isfinite(expected).all(0)
            compared, left = compared + int(kept.sum()), left + int((~kept).sum())
            worst[seed] = max(worst[seed], _error(model.nv, right, expected, kept))
    print(f"A and B: {robots} random robots, {states} states each, {compared} columns compared,")
    print(
        f"{left} have neighbours that hold other joints or slack cables; largest relative errors:"
    )
    print(*(f"{one:.1e}" for one in worst), "\n")


def _error(n: int, right: np.ndarray, expected: np.ndarray, kept: np.ndarray) -> float:
    """The largest error of the kept columns, relative to its block of A or B."""
    size, worst = len(right), 0.0
    cuts = [0, n, 2 * n, size, right.shape[1]]
    for rows in (slice(0, n), slice(n, 2 * n), slice(2 * n, size)):
        for first, last in pairwise(cuts):
            block, use = right[rows, first:last], kept[first:last]
            if block.size and use.any():
                scale = max(np.abs(block).max(), SMALL)
                worst = max(worst, np.abs(block - expected[rows, first:last])[:, use].max() / scale)
    return float(worst)


def _behind_winches(model: SoftModel) -> SoftModel:
    """The robot with a winch in place of each motor; one in two lags."""
    winches = tuple(
        replace(
            one, gear=-abs(one.gear), lower=0.0, upper=10.0, command=CommandKind.LENGTH,
            stiffness=500.0, damping=2.0, lag=0.01 * (k % 2),
        )
        for k, one in enumerate(model.robot.actuators)
    )  # fmt: skip
    return softdyn.build(replace(model.robot, actuators=winches))


def _violent(folder: Path) -> Iterator[tuple[str, SoftModel]]:
    """The robots of the violent steps."""
    for name in ("finger", "helix", "spirob"):
        yield name, softdyn.load(name)
    yield "arm of everything", loaded(EVERYTHING, folder)
    for name, make in PROJECTIONS.items():
        yield name, make(folder)
    yield "winched arm", softdyn.load(write(folder, WINCHED))
    yield "wrapped arm", softdyn.build(wrapped_robot(3, bodies=2))
    yield "walker, floating", softdyn.load(write(folder, WALKER), floating=True)


def _violently(name: str, model: SoftModel, steps: int) -> int:
    """Take violent steps and print a row; the number of those without a solution."""
    rng, counts, failed, n = np.random.default_rng(0), Counter[int](), 0, model.nv
    low, high = np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0)
    u_min, u_max = np.maximum(model.u_min, -10.0), np.minimum(model.u_max, 10.0)
    begin = perf_counter()
    for _ in range(steps):
        share, at_stop = rng.random((2, n))
        share = np.where(at_stop < 0.125, 0.0, np.where(at_stop < 0.25, 1.0, share))
        q = model.configuration(low + share * (high - low))
        v = 10 ** rng.uniform(-1, 2) * (high - low) * rng.normal(size=n)
        u, period = np.where(rng.random(model.nu) < 0.5, u_min, u_max), 10 ** rng.uniform(-3, -2)
        try:
            counts[discrete_step(model, q, v, u, period).substeps] += 1
        except StepError as error:
            failed += 1
            print(f"{name}: {error}")
    spent = 1e3 * (perf_counter() - begin) / steps
    some = ", ".join(f"{k}: {count}" for k, count in sorted(counts.items())[:6])
    most = f", up to {max(counts)}" if len(counts) > 6 else ""
    print(f"{name:22}{steps:8}{failed:8}{spent:11.2f}  {some}{most}", flush=True)
    return failed
