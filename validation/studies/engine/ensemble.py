"""The same closed loop from starts that differ by 1e-9, so that cells become distributions.

A chaotic loop has no unique figure. Every cell runs from rest, then a few times with tiny random
initial velocities. Cells whose printed figure varies run as often as requested. A cell with a rig
that draws something, the noise or bias of states or the noise of the sensors that an observer
reads, always runs that often, each time with another seed of the rig.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.engine.case import MOVING, NAMES, Case
from softdyn.validation.studies.engine.distribution import Distribution, value
from softdyn.validation.studies.engine.executors import follow
from softdyn.validation.studies.engine.store import Executor, Store

NUDGE = 1e-9  # rad/s, m/s: standard deviation of each initial velocity
SCREEN = 2  # nudged runs of every cell; more only if the figure varies
FIGURE = dict.fromkeys(NAMES, "final_error_cm") | dict.fromkeys(MOVING, "mse_cm2")
# figure beside it → its name in a result, and the kinds of cases that have it
BESIDE = {
    "second_cycle": ("second_cycle_mse_cm2", {"tracking"}),
    "input_change": ("input_change_percent", {"set_point", "point"}),
}
NOISE_SEEDS = 1000  # seeds of the noise between two seeds of an ensemble


def is_noisy(case: Case) -> bool:
    """Whether what the controller gets depends on the seed of the rig."""
    rig = case.options.get("rig")
    if rig is None:
        return False
    drawn = isinstance(rig, Mapping) and max(rig.get("noise", 0.0), rig.get("bias", 0.0)) > 0
    return drawn or case.options.get("observer") is not None


def members(case: Case, count: int, seed: int) -> list[Case]:
    """Copies of a case with `count` random starts of this seed, and as many seeds of its rig.

    Noisy states make tiny differences of the start needless.
    """
    starts = [replace(case, nudge=NUDGE, draw=(seed, k)) for k in range(count)]
    if not is_noisy(case):
        return starts
    rig = case.options["rig"]
    said = dict(rig) if isinstance(rig, Mapping) else {}  # "file" has no changes
    copies = [case] * count if said.get("noise", 0.0) > 0 else starts
    first = NOISE_SEEDS * seed + 1
    return [
        replace(copy, options={**case.options, "rig": {**said, "seed": first + k}})
        for k, copy in enumerate(copies)
    ]


def run(
    cells: Mapping[str, Case],
    store: Store,
    execute: Executor,
    count: int = 0,
    seed: int = 1,
    known: Mapping[str, Distribution] | None = None,
    folder: Path = Path(),
    depends: Sequence[str] = (),
) -> dict[str, Distribution]:
    """The distribution of every cell; results in `store` are used again.

    Parameters
    ----------
    cells : mapping
        Label → case.
    store : Store
    execute : Executor
    count : int
        Number of nudged runs of a cell whose printed figure varies in the first `SCREEN` runs,
        and of runs with other seeds of the rig.
    seed : int
        Seed of the nudges and of the rigs' seeds.
    known : mapping, optional
        Cells from other seeds. A cell that varies there runs `count` times, too.
    folder : Path
        Relative paths of robots and controllers are relative to it.
    depends : sequence of str
        Files that classes of one's own read, see `worker.jobs_of`.
    """

    def results(cases: Iterable[Case]) -> dict[str, dict[str, Any]]:
        distinct = [*{case.name: case for case in cases}.values()]
        jobs = worker.jobs_of(distinct, folder=folder, depends=depends)
        follow(store.run(jobs, execute), jobs)
        return {job.name: store.result(job.name) or {} for job in jobs}

    def distribution(case: Case, count: int) -> Distribution:
        nudged = members(case, count, seed)
        runs = [found[one.name] for one in (case, *nudged)]
        failed = {"nominal": int(_failed(runs[0])), str(seed): sum(map(_failed, runs[1:]))}
        lost = {key: number for key, number in failed.items() if number}

        def of(figure: str) -> Distribution:
            nominal, *values = (value(run.get(figure)) for run in runs)
            return Distribution(nominal, {str(seed): tuple(values)})

        beside: dict[str, Any] = {
            name: of(figure)
            for name, (figure, kinds) in BESIDE.items()
            if case.kind in kinds and any(run.get(figure) is not None for run in runs)
        }
        return replace(of(FIGURE[case.kind]), failed=lost, **beside)

    few = min(SCREEN, count)
    found = results(each for case in cells.values() for each in (case, *members(case, few, seed)))
    first = {label: distribution(case, few) for label, case in cells.items()}
    moving = {label for of in (known or {}, first) for label, cell in of.items() if cell.moves}
    moving |= {label for label, case in cells.items() if is_noisy(case)}
    often = [label for label in cells if label in moving]
    found |= results(each for label in often for each in members(cells[label], count, seed))
    every = first | {label: distribution(cells[label], count) for label in often}
    return {label: cell if label in moving else cell.constant() for label, cell in every.items()}


def _failed(result: Mapping[str, Any]) -> bool:
    return bool(result.get("failed", True))
