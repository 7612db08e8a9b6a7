"""Jobs on processes of this machine; results come as they finish."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from tqdm.auto import tqdm

from softdyn.validation.processes import WorkerKilled, in_order, in_processes, numbered
from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.store import Executor
from softdyn.validation.studies.engine.worker import CaseJob, CaseResult

DIED = "its worker process died"


def strict(processes: int) -> Executor:
    """Processes of this machine with one thread each, -1 for one per core; stops at an error.

    The executor raises `WorkerKilled` and the errors of `worker.run`.
    """

    def execute(order: list[CaseJob]) -> Iterator[tuple[int, CaseResult]]:
        calls = ((index, worker.run, (job,)) for index, job in enumerate(order))
        return in_processes(numbered, calls, processes)

    return execute


def patient(processes: int) -> Executor:
    """The same, but it continues after errors and killed processes, which are in the results."""

    def execute(order: list[CaseJob]) -> Iterator[tuple[int, CaseResult]]:
        left = dict(enumerate(order))
        while left:
            sent: list[int] = []
            try:
                for index, result in in_processes(numbered, _feed(left, sent), processes):
                    del left[index]
                    yield index, result
            except WorkerKilled:
                # one of the running jobs killed its process: each gets a separate process
                for index in [i for i in sent if i in left]:
                    yield index, _alone(left.pop(index))

    return execute


def run_all(cases: Sequence[Case], processes: int = -1) -> list[dict[str, Any]]:
    """Run cases without a store, with a bar on a terminal; their figures in the given order."""
    results = in_order(worker.run, ((job,) for job in worker.jobs_of(cases)), processes)
    return [result.figures | {"step_us": result.step_us} for result in results]


def follow(steps: Iterable[tuple[CaseJob, CaseResult | None]], jobs: Sequence[CaseJob]) -> int:
    """Go through the steps of `Store.run`; return the number of jobs that ran.

    A bar on a terminal counts work, not cases.
    """
    ran = done = troubled = 0
    layout = "{desc} |{bar}| {percentage:3.0f} % [{elapsed} < {remaining}]"
    with tqdm(
        total=sum(job.cost for job in jobs),
        disable=None,  # silent where stderr is no terminal
        leave=False,
        smoothing=0,
        bar_format=layout,
    ) as bar:
        for job, result in steps:
            done, ran = done + 1, ran + (result is not None)
            troubled += result is not None and result.figures["outcome"] != "done"
            if result is None and not bar.disable:
                bar.initial += job.cost  # these took no time and do not measure the speed
            reused = f", {done - ran} of them before" if done > ran else ""
            failed = f", {troubled} failed" if troubled else ""
            bar.set_description_str(f"{done} of {len(jobs)} runs{reused}{failed}", refresh=False)
            bar.update(job.cost)
    return ran


def _feed(left: dict[int, CaseJob], sent: list[int]) -> Iterator[tuple[Any, ...]]:
    for index, job in list(left.items()):
        sent.append(index)
        yield index, worker.attempt, (job,)


def _alone(job: CaseJob) -> CaseResult:
    """Run a job that may kill its process. Two workers: a pool of one runs in this process."""
    try:
        (result,) = in_processes(worker.attempt, [(job,)], 2)
    except WorkerKilled:
        return worker.not_run(DIED)
    return result
