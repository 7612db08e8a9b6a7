"""Many runs of one twin on all cores, by MuJoCo's own rollout in threads.

The steps are those of `Twin.advance`, so a run has the same numbers to the last bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.rollout import Rollout
from tqdm.auto import tqdm

from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.twin.twin import Twin

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
MOST = 256_000_000  # bytes of the states and controls of the runs that are integrated at once
SHOWN = 16  # runs for each core between two looks of the bar


def fits(twin: Twin, grid: TimeGrid) -> bool:
    """Whether MuJoCo can integrate a run alone, and keep every plant step of it in memory.

    Cables that rub on their guides have a friction that changes with their pull.
    """
    robot = twin.robot
    if robot.forces or robot.balls or twin.memory or twin.areas is not None:  # not MuJoCo's own
        return False
    rubs = any(tendon.rubs for tendon in robot.tendons)
    return not rubs and _bytes(twin, grid) <= MOST


@dataclass(frozen=True, eq=False)
class Starts:
    """The states of MuJoCo from which runs begin.

    Attributes
    ----------
    states, warmstarts : np.ndarray, (runs, sizes)
        Full physics states, and the solver's warm starts.
    """

    states: np.ndarray
    warmstarts: np.ndarray

    @classmethod
    def of(cls, twin: Twin, begin: Callable[[int], None], runs: int) -> Starts:
        """Those of a twin after each call of `begin`, with the number of the run."""
        states = np.empty((runs, mujoco.mj_stateSize(twin.model, STATE)))
        warm = np.empty((runs, twin.model.nv))
        for k in range(runs):
            begin(k)
            mujoco.mj_getState(twin.model, twin.data, states[k], STATE)
            warm[k] = twin.data.qacc_warmstart
        return cls(states, warm)


def integrate(
    twin: Twin, grid: TimeGrid, u: np.ndarray, starts: Starts | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray] | None]:
    """Integrate runs, as many at a time as fit in memory.

    Parameters
    ----------
    twin : Twin
        The plant, without a rig.
    grid : TimeGrid
        Its steps.
    u : np.ndarray, (runs, steps, nu)
        The inputs of each period.
    starts : Starts, optional
        The state of each run, by default the twin's present one.

    Yields
    ------
    qpos (steps + 1, nq) and qvel (steps + 1, nv) of each run, or None for one that diverged.
    """
    model, nq = twin.model, twin.model.nq
    if starts is None:
        starts = Starts.of(twin, lambda _: None, len(u))
    sizes = [grid.plant_steps(k) for k in range(grid.steps)]
    samples = np.cumsum(sizes) - 1
    at_once = max(1, min(MOST // _bytes(twin, grid), SHOWN * (os.cpu_count() or 1)))
    threads = min(os.cpu_count() or 1, len(u), at_once)
    datas = [mujoco.MjData(model) for _ in range(threads)]
    with (
        Rollout(nthread=0 if threads == 1 else threads) as rollout,
        tqdm(
            total=len(u), disable=None if len(u) > at_once else True, leave=False, unit="run"
        ) as bar,
    ):
        for k in range(0, len(u), at_once):
            chunk = np.repeat(u[k : k + at_once], sizes, axis=1)
            control = np.zeros((*chunk.shape[:2], model.nu))
            control[..., : twin.nu] = chunk
            states, _ = rollout.rollout(
                model, datas if threads > 1 else datas[0], starts.states[k : k + at_once], control,
                initial_warmstart=starts.warmstarts[k : k + at_once],
            )  # fmt: skip
            bar.update(len(chunk))
            for start, run in zip(starts.states[k : k + at_once], states[:, samples], strict=True):
                # after a warning MuJoCo repeats the last state
                if not (np.isfinite(run).all() and np.diff(run[:, 0]).min(initial=1.0) > 0):
                    yield None
                    continue
                full = np.concatenate((start[None], run))
                yield full[:, 1 : 1 + nq], full[:, 1 + nq : 1 + nq + model.nv]


def _bytes(twin: Twin, grid: TimeGrid) -> int:
    steps = (grid.steps - 1) * grid.substeps + grid.last
    return 8 * steps * (mujoco.mj_stateSize(twin.model, STATE) + 2 * twin.model.nu)
