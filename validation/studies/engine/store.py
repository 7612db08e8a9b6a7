"""The results of a study: files below a folder, each whole or not at all.

A case has ``runs/NAME.json``, its result, with a fingerprint of all that it depends on and the hash
of its log; where logs are kept ``runs/NAME.npz``; and where step times are ``times/NAME.json``,
the only part of a run that is not the same twice. The result is written last: a run that is killed
leaves nothing that is taken for one. Results and step times have a hash of their own content: what
is damaged or was edited counts as missing, and is run again. This process alone writes, so that
workers on other machines need no folder in common; two runs of one case write the same bytes.
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
from softdyn.validation.loop.log import STEP_TIMES, Log
from softdyn.validation.studies.engine import case as cases
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.fingerprint import has_digest
from softdyn.validation.studies.engine.worker import CaseJob, CaseResult

# Yields (position in the list, result) as jobs end, in any order.
Executor = Callable[[list[CaseJob]], Iterator[tuple[int, CaseResult]]]
OUTCOMES = ("done", "failed", "raised", "not_run")
SEAL = "sha256"  # of all else in a file


@dataclass(frozen=True)
class Store:
    """A folder with a file a case.

    Attributes
    ----------
    folder : Path
    runs : str
        The folder below it with results and logs.
    times : str, optional
        The one with step times, None where they are not kept.
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
        """The result of a case, up to date or not; None without a whole one."""
        found = _read(self.result_path(name))
        whole = found is not None and found.get("outcome") in OUTCOMES and "fingerprint" in found
        return found if whole else None

    def figures(self, case: Case, name: str) -> dict[str, Any] | None:
        """The result of a case, its figures those of its log where there is one.

        Raises
        ------
        InputError
            A log that is damaged, or not the result's.
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
        """Step times of a case (µs): median, p99, p999, max; None when they are not there."""
        found = _read(self.folder / (self.times or "") / f"{name}.json")
        return found if found is None or set(found) <= {*STEP_TIMES} else None

    def load(self, job: CaseJob) -> dict[str, Any] | None:
        """The result of a case; None without one of this fingerprint and all files whole."""
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
        """Tasks without an up-to-date result."""
        return [job for job in jobs if self.load(job) is None]

    def save(self, job: CaseJob, result: CaseResult) -> None:
        """Write the files of a case.

        Raises
        ------
        InputError
            When they cannot be written.
        """
        path = self.result_path(job.name)
        ran = result.figures["outcome"] != "not_run"  # else it is tried again the next time
        content = {"fingerprint": job.fingerprint if ran else None, **job.head, **result.figures}
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
        """Run what is missing and keep what comes; no result for what is up to date.

        Those come first, then the longest job, so that no core idles at the end. With nothing
        missing the executor is not asked.

        Raises
        ------
        InputError
            When a file cannot be written, and what the executor raises.
        """
        missing = self.missing(jobs)
        names = {job.name for job in missing}
        yield from ((job, None) for job in jobs if job.name not in names)
        if not missing:
            return
        remove_left_over(self.folder)
        order = sorted(missing, key=lambda job: job.cost, reverse=True)
        with closing(executor(order)) as results:  # type: ignore[type-var]
            for index, result in results:
                self.save(order[index], result)
                yield order[index], result


def _write(path: Path, content: Mapping[str, Any]) -> None:
    """`content` and a hash of it: what is changed by hand is not taken for a result."""
    kept = json.loads(to_json(dict(content)))
    write_json(path, {**kept, SEAL: _seal(kept)})


def _read(path: Path) -> dict[str, Any] | None:
    """The content that `_write` wrote; None where there is nothing, or anything else."""
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
