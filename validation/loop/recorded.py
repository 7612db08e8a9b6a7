"""A recorded run from a file: a log, or a case of a sweep."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.validation.files import read_json
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.logged_robot import OPTIONAL, LoggedRobot
from softdyn.validation.loop.provenance import found, path_from
from softdyn.validation.loop.repeat import Repetition, compare_runs, found_file, record_in

CASE = "a log, or a case of a sweep, with the record of its run"
MOTION = "q_sha256"  # of a case: the digest of q


@dataclass(frozen=True)
class RecordedRun:
    """A run that may be repeated.

    Attributes
    ----------
    record : mapping
        Its record, with absolute paths.
    source : LoggedRobot
        Its robot.
    log : Log or None
        Its log; None for a case without one.
    motion : str or None
        The `motion_of` a case.
    """

    record: Mapping[str, Any]
    source: LoggedRobot
    log: Log | None
    motion: str | None = None

    @classmethod
    def read(cls, path: str | Path) -> RecordedRun:
        """Read a log (NPZ or CSV), or the JSON file of a case, maybe with its log beside it.

        Raises
        ------
        InputError
            The file cannot be read, or has no record.
        """
        path = Path(path)
        if path.suffix != ".json":
            log = Log.from_csv(path) if path.suffix == ".csv" else Log.load(path)
            if not log.record:
                raise InputError(str(path), CASE, "a log of an older version, without a record")
            return cls(log.record, log.source, log)
        content = read_json(path, CASE)
        whole: Any = content.get("record")
        try:
            said = whole["robot"]
            names = (n for n in LoggedRobot.__match_args__ if n not in OPTIONAL or n in said)
            robot = {name: said[name] for name in names}
            robot["path"] = path_from(robot["path"], path.parent)
            source, record = LoggedRobot(**robot), found(record_in(whole, str(path)), path.parent)
        except (KeyError, TypeError):
            raise InputError(str(path), CASE, "a JSON file without one") from None
        beside = path.with_suffix(".npz")
        kept = Log.load(beside) if beside.is_file() else None
        return cls(record, source, kept, content.get(MOTION))

    @property
    def certified(self) -> bool:
        """Whether its log has the true rate of V."""
        return self.log is not None and "Vdot" in self.log

    def controller(self, folder: str | Path | None = None) -> str:
        """The controller's name, or FILE.py:CLASS with the path of its file; see `found_file`."""
        made = self.record["controller"]
        while "controller" in made.get("with", {}):  # a filter of its input
            made = made["with"]["controller"]
        if "file" in made:
            return f"{found_file(made['file'], folder)}:{made.get('class') or made['function']}"
        return str(self.record["settings"]["name"])

    def compared(self, log: Log) -> Repetition:
        """This run beside its repetition."""
        if self.log is not None:
            return compare_runs(self.log, log)
        same = self.motion == motion_of(log)
        return Repetition(None if same else "q", float("nan"), float("nan"), ())


def motion_of(log: Log) -> str:
    """The SHA-256 of a run's q."""
    return hashlib.sha256(np.ascontiguousarray(log.q).tobytes()).hexdigest()
