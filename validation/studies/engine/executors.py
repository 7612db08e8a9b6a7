"""Tasks on the processes of this machine: answers as they come."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from tqdm.auto import tqdm

from softdyn.validation.processes import WorkerKilled, in_order, in_processes, numbered
from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.store import Executor
from softdyn.validation.studies.engine.worker import Answer, Task

DIED = "its worker process died"


def strict(jobs: int) -> Executor:
    """Processes of this machine, one thread each, -1 for one per core; stops at what is wrong.

    The executor raises `WorkerKilled` and what `worker.run` does.
    """

    def execute(order: list[Task]) -> Iterator[tuple[int, Answer]]:
        calls = ((index, worker.run, (task,)) for index, task in enumerate(order))
        return in_processes(numbered, calls, jobs)

    return execute


def patient(jobs: int) -> Executor:
    """The same, going on whatever goes wrong: it is in the answer, a killed process too."""

    def execute(order: list[Task]) -> Iterator[tuple[int, Answer]]:
        left = dict(enumerate(order))
        while left:
            sent: list[int] = []
            try:
                for index, answer in in_processes(numbered, _feed(left, sent), jobs):
                    del left[index]
                    yield index, answer
            except WorkerKilled:
                # one of those under way killed its process: each gets a process of its own
                for index in [i for i in sent if i in left]:
                    yield index, _alone(left.pop(index))

    return execute


def run_all(cases: Sequence[Case], jobs: int = -1) -> list[dict[str, Any]]:
    """The figures of each case, in the order given, nothing kept; a bar on a terminal."""
    answers = in_order(worker.run, ((task,) for task in worker.tasks(cases)), jobs)
    return [answer.result | {"step_us": answer.step_us} for answer in answers]


def follow(steps: Iterable[tuple[Task, Answer | None]], tasks: Sequence[Task]) -> int:
    """Go through the steps of `Store.run`; returns how many tasks ran.

    A bar on a terminal counts work, not cases.
    """
    ran = done = troubled = 0
    layout = "{desc} |{bar}| {percentage:3.0f} % [{elapsed} < {remaining}]"
    with tqdm(
        total=sum(task.cost for task in tasks),
        disable=None,  # silent where stderr is no terminal
        leave=False,
        smoothing=0,
        bar_format=layout,
    ) as bar:
        for task, answer in steps:
            done, ran = done + 1, ran + (answer is not None)
            troubled += answer is not None and answer.result["outcome"] != "done"
            if answer is None and not bar.disable:
                bar.initial += task.cost  # took no time: not a measure of the speed
            reused = f", {done - ran} of them before" if done > ran else ""
            failed = f", {troubled} failed" if troubled else ""
            bar.set_description_str(f"{done} of {len(tasks)} runs{reused}{failed}", refresh=False)
            bar.update(task.cost)
    return ran


def _feed(left: dict[int, Task], sent: list[int]) -> Iterator[tuple[Any, ...]]:
    for index, task in list(left.items()):
        sent.append(index)
        yield index, worker.attempt, (task,)


def _alone(task: Task) -> Answer:
    """Run a task that may kill its process; with two of them, for one would be this process."""
    try:
        (answer,) = in_processes(worker.attempt, [(task,)], 2)
    except WorkerKilled:
        return worker.not_run(DIED)
    return answer
