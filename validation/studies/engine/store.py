"""The results of a study: files in a folder, each complete or missing.

``runs/NAME.json`` is the result of a case, with a fingerprint of everything on which it depends and
the hash of its log. ``runs/NAME.npz`` is its log, if logs are kept. ``times/NAME.json`` has its
step times, if they are kept. Only these differ between two runs of a case; all other files have the
same bytes. The result is written last, so that a killed run leaves no result. Results and step
times contain a hash of their content. A damaged or edited file counts as missing, and the case runs
again. Only this process writes, so that workers on other machines need no common folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from softdyn import InputError
from softdyn.files import remove_left_over
from softdyn.validation.files import atomic, read_json, to_json, write_json
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.metrics import STEP_TIMES
from softdyn.validation.loop.repeat import record_for
from softdyn.validation.plain_data import to_plain_data
from softdyn.validation.studies.engine import case as cases
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.fingerprint import has_digest
from softdyn.validation.studies.engine.worker import CaseJob, CaseResult

# Yields (position in the list, result) as jobs end, in any order.
Executor = Callable[[list[CaseJob]], Iterator[tuple[int, CaseResult]]]
OUTCOMES = ("done", "failed", "raised", "not_run")
SEAL = "sha256"  # key of the hash of all other content of a file


@dataclass(frozen=True)
class Store:
    """A folder with a file per case.

    Attributes
    ----------
    folder : Path
    runs : str
        The subfolder with results and logs.
    times : str, optional
        The subfolder with step times; None if they are not kept.
    """

    folder: Path
    runs: str = "runs"
    times: str | None = None

    def result_path(self, name: str) -> Path:
        """The path of a case's result."""
        return self.folder / self.runs / f"{name}.json"

    def log_path(self, name: str) -> Path:
        """The path of a case's log."""
        return self.folder / self.runs / f"{name}.npz"

    def result(self, name: str) -> dict[str, Any] | None:
        """The result of a case, up to date or not; None if it is missing or damaged."""
        found = _read(self.result_path(name))
        whole = found is not None and found.get("outcome") in OUTCOMES and "fingerprint" in found
        return found if whole else None

    def figures(self, case: Case, name: str) -> dict[str, Any] | None:
        """The result of a case, with the figures of its log if there is one.

        Raises
        ------
        InputError
            The log is damaged, or belongs to another result.
        """
        found = self.result(name)
        if found is None or "log_sha256" not in found:
            return found
        path = self.log_path(name)
        if not has_digest(path, found["log_sha256"]):
            raise InputError(str(path), f"the log of {self.result_path(name)}", "another, or none")
        log = Log.load(path)
        figures = json.loads(to_json(cases.figures(case, log)))
        return found | {key: figures[key] for key in figures if key != "step_us"}

    def step_times(self, name: str) -> dict[str, Any] | None:
        """Step times of a case (µs): median, p99, p999, max; None if they are missing."""
        found = _read(self.folder / (self.times or "") / f"{name}.json")
        return found if found is None or set(found) <= {*STEP_TIMES} else None

    def load(self, job: CaseJob) -> dict[str, Any] | None:
        """The result of a case; None unless its fingerprint matches and its files are complete."""
        found = self.result(job.name)
        if found is None or found["fingerprint"] != job.fingerprint:
            return None
        if self.times and self.step_times(job.name) is None:
            return None
        ran = found["outcome"] in ("done", "failed")
        if job.log and ran and not has_digest(self.log_path(job.name), found.get("log_sha256")):
            return None
        return found

    def missing(self, jobs: Iterable[CaseJob]) -> list[CaseJob]:
        """Jobs without an up-to-date result."""
        return [job for job in jobs if self.load(job) is None]

    def save(self, job: CaseJob, result: CaseResult) -> None:
        """Write the files of a case.

        Raises
        ------
        InputError
            When they cannot be written.
        """
        path = self.result_path(job.name)
        ran = result.figures["outcome"] != "not_run"  # otherwise it runs again the next time
        mark = job.fingerprint if ran else None
        inputs = to_plain_data(job.case.inputs)
        content = {"fingerprint": mark, "inputs": inputs, **result.figures}
        if result.record:
            record = record_for(result.record["record"], path.parent)
            content |= {**result.record, "record": record}
        _make_folder(path.parent)
        if result.log is not None:
            with atomic(self.log_path(job.name)) as file:
                file.write(result.log)
            content["log_sha256"] = sha256(result.log).hexdigest()
        if self.times:
            times = self.folder / self.times / f"{job.name}.json"
            _make_folder(times.parent)
            _write(times, result.step_us)
        _write(path, content)

    def run(
        self, jobs: Sequence[CaseJob], executor: Executor
    ) -> Iterator[tuple[CaseJob, CaseResult | None]]:
        """Run the missing jobs and write their results; yield None for jobs that are up to date.

        The latter come first. Then the longest jobs run first, so that no core idles at the end.
        Jobs of one fingerprint run once: the result stands in the files of each, and None is also
        yielded for all but the first. Without missing jobs, the executor is not called.

        Raises
        ------
        InputError
            A file cannot be written. Errors of the executor are passed on.
        """
        missing = self.missing(jobs)
        names = {job.name for job in missing}
        yield from ((job, None) for job in jobs if job.name not in names)
        if not missing:
            return
        remove_left_over(self.folder)
        alike: dict[str, list[CaseJob]] = {}
        for job in sorted(missing, key=lambda job: job.cost, reverse=True):
            alike.setdefault(job.fingerprint, []).append(job)
        order = [first for first, *_ in alike.values()]
        with closing(executor(order)) as results:  # type: ignore[type-var]
            for index, result in results:
                first, *others = alike[order[index].fingerprint]
                for job in (first, *others):
                    self.save(job, result)
                yield first, result
                yield from ((job, None) for job in others)


def _write(path: Path, content: Mapping[str, Any]) -> None:
    """Write `content` with its hash, so that an edited file does not count as a result."""
    kept = json.loads(to_json(dict(content), indent=None))
    write_json(path, {**kept, SEAL: _seal(kept)})


def _read(path: Path) -> dict[str, Any] | None:
    """The content that `_write` wrote; None if the file is missing or has other content."""
    try:
        content = read_json(path, "a result")
    except InputError:
        return None
    return content if content.pop(SEAL, None) == _seal(content) else None


def _seal(content: dict[str, Any]) -> str:
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(str(path), "a folder to write to", error.strerror) from None
