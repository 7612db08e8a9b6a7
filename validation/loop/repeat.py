"""The record of a run, from which the run can be repeated, and the comparison of two runs."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.dynamics.forces import numbers_of
from softdyn.dynamics.reduced import rebuild
from softdyn.formats import KEY, RECORD, check_format
from softdyn.validation.loop.arguments import nowhere
from softdyn.validation.loop.log_data import LogData
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.provenance import (
    digest_of,
    file_of,
    files_in,
    path_shown,
    surroundings,
    written,
)
from softdyn.validation.loop.recipe import RIG, ROBOT, NotRecorded, Remaking, Statement
from softdyn.validation.loop.settings import RunOptions, declarations
from softdyn.validation.twin.rig import rig_of

TIMES = ("step_us", "clock", "stamps", "missed")  # channels that no run repeats
OF_LOG = ("versions", "gains")  # what a log states beside its record
ROBOT_KEYS = ("name", "file", "digest", "forces")
PARTS = ("settings", "controller", "reference")  # of a record, of which the run is made again


def record_of(
    model: SoftModel, controller: Any, reference: Any, options: RunOptions, observer: Any = None
) -> dict[str, Any]:
    """The record of a run, as plain data with absolute paths.

    Parameters
    ----------
    model, controller, reference, options
        Those of `ClosedLoop`.
    observer : Observer, optional
        The observer that the settings mean.

    Returns
    -------
    dict
        ``settings`` (as given, with the defaults of the others), ``controller``, ``reference``,
        ``robot``, ``used`` (the motors and sensors of the rig, the observer's parameters),
        ``processor`` and ``git``.
    """
    robot, statement = model.robot, Statement(model, options)
    rig = rig_of(options.rig)
    real = getattr(options.plant, "real_time", False)
    used = robot if rig is None else rig.robot(robot)
    inner = getattr(observer, "inner", observer)
    parameters = getattr(inner, "parameters", None)
    return {
        "settings": statement.settings(options),
        "controller": statement.of(controller),
        "reference": None if reference is nowhere else statement.of(reference),
        "robot": dict(zip(ROBOT_KEYS, (
            model.bundled or model.name, None if model.bundled else file_of(robot.path),
            robot.digest, [
                {"force": statement.of(force), "numbers": statement.of(numbers_of(force))}
                for force in robot.forces
            ],
        ), strict=True)),
        "used": {
            "motors": [_plain(one, statement) for one in used.actuators] if rig or real else None,
            "sensors": [_plain(one, statement) for one in used.sensors] if rig or real else None,
            "observer": None if inner is None else {
                "class": type(inner).__name__,
                "parameters": _plain(parameters, statement) if is_dataclass(parameters) else None,
                "disturbances": [*getattr(inner, "disturbance_units", {})],
            },
        },
        **surroundings(),
    }  # fmt: skip


def _plain(value: Any, statement: Statement) -> dict[str, Any]:
    """The fields of a dataclass."""
    found = {field.name: getattr(value, field.name) for field in fields(value)}
    return {
        name: statement.of(one.value if isinstance(one, Enum) else one)
        for name, one in found.items()
    }


def whole_record(log: LogData) -> dict[str, Any]:
    """The record of a log with the robot's text, gains and versions, and with absolute paths."""
    robot = {**log.record.get("robot", {}), **log.source.table}
    return {**log.record, **{name: getattr(log, name) for name in OF_LOG}, "robot": robot}


def record_for(whole: Mapping[str, Any], folder: str | Path) -> dict[str, Any]:
    """A `whole_record` for a file in a folder, with its format: no path leads out of it."""
    found: dict[str, Any] = {KEY: RECORD, **written(whole, Path(folder))}
    robot = found["robot"]
    return found | {"robot": robot | {"path": path_shown(robot["path"], Path(folder))}}


def record_in(whole: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The record of a log in a `whole_record` of a file: without what the log itself has.

    Raises
    ------
    InputError
        It is of another version.
    """
    check_format(whole.get(KEY, RECORD), RECORD, where, "a record")
    robot = whole.get("robot")
    kept = {key: robot[key] for key in ROBOT_KEYS if key in robot} if robot else robot
    return {key: one for key, one in whole.items() if key not in (KEY, *OF_LOG)} | {"robot": kept}


def experiment_of(
    record: Mapping[str, Any], source: LoggedRobot, folder: str | Path | None = None
) -> tuple[dict[str, Any], list[str]]:
    """The arguments of `simulate` that repeat a run, and what they assume, in sentences.

    Parameters
    ----------
    record : mapping
        The record of the run.
    source : LoggedRobot
        Its robot.
    folder : str or Path, optional
        Files that are not where the record says are searched here.

    Returns
    -------
    dict, list of str
        ``model``, ``controller``, ``reference`` and the settings that are given. A part that the
        record cannot make again is a `NotRecorded`, which `simulate` refuses by its name.

    Raises
    ------
    InputError
        The record is empty, or a file is missing.
    """
    if not record:
        raise InputError("log", "the record of a run", "a log of an older version, without one")
    model = source.model()
    models, settings = {ROBOT: model}, record["settings"]
    remaking = Remaking(models, partial(found_file, folder=folder))
    model = models[ROBOT] = model.with_forces(*_forces(record, remaking))
    rig = rig_of(RunOptions.of({"rig": remaking.of(settings["rig"])}).rig)
    models[RIG] = model if rig is None else rebuild(model, rig.robot(model.robot))
    made = {name: remaking.of(value) for name, value in settings.items() if value is not None}
    return {
        "model": model, "controller": remaking.of(record["controller"]),
        "reference": remaking.of(record["reference"]), **made,
    }, remaking.assumed  # fmt: skip


def _forces(record: Mapping[str, Any], remaking: Remaking) -> Iterator[Any]:
    """The forces of one's own that acted on the robot of a record.

    Raises
    ------
    InputError
        One that the record cannot make again.
    """
    for k, said in enumerate(record.get("robot", {}).get("forces", ())):
        force = remaking.of(said["force"])
        if isinstance(force, NotRecorded):
            raise InputError(f"forces[{k}]", "a force that can be made again", repr(force))
        for name, value in remaking.of(said["numbers"]).items():
            object.__setattr__(force, name, value)
        yield force


def found_file(file: Mapping[str, Any], folder: str | Path | None = None) -> str:
    """The path of a file of a record.

    Raises
    ------
    InputError
        It is neither where the record says nor in `folder`.
    """
    name = file.get("name") or os.path.basename(file["path"])
    places = [file["path"]] if "path" in file else []
    places += [] if folder is None else [os.path.join(folder, name)]
    for place in places:
        if os.path.isfile(place):
            return str(place)
    got = f"none at {places[-1]}" if places else "a name alone"
    raise InputError(name, "the file of the record; --in DIR, or folder=, says where it is", got)


def changed_files(record: Mapping[str, Any], folder: str | Path | None = None) -> list[str]:
    """The names of the record's files whose content differs now, or that are missing."""
    found = dict[str, None]()
    for file in files_in(record):
        name = file.get("name") or os.path.basename(file["path"])
        try:
            digest = digest_of(found_file(file, folder))
        except InputError:
            digest = None
        if digest != file["sha256"]:
            found[f"{name} {'is missing' if digest is None else 'has changed'}"] = None
    return [*found]


def lost_parts(record: Mapping[str, Any]) -> list[str]:
    """The parts of a run that its record cannot make again, by their places."""
    parts = [(part, record.get(part)) for part in PARTS]
    parts.append(("forces", (record.get("robot") or {}).get("forces", [])))
    return [f"{place} ({name})" for part, said in parts for place, name in _lost(part, said)]


def _lost(place: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        if "other" in value:
            yield place, value["other"]
        else:
            for key, one in value.items():
                yield from _lost(place if key == "with" else f"{place}.{key}", one)
    elif isinstance(value, list):
        for k, one in enumerate(value):
            yield from _lost(f"{place}[{k}]", one)


@dataclass(frozen=True)
class Repetition:
    """A run beside its repetition.

    Attributes
    ----------
    channel : str or None
        The first channel that differs; None if the runs are equal to the bit.
    difference : float
        The largest difference of an element of q in the common samples, NaN if there are none.
    at : float
        Its time (s).
    causes : tuple of str
        What differs between the records: versions, files, the processor, settings.
    """

    channel: str | None
    difference: float
    at: float
    causes: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Whether the runs are equal to the bit, apart from times of computing."""
        return self.channel is None

    def to_dict(self) -> dict[str, Any]:
        """The comparison for JSON."""
        return {"equal": self.equal, **asdict(self)}

    def __str__(self) -> str:
        if self.equal:
            return "equal to the bit"
        known = not math.isnan(self.difference)
        said = f"largest difference of q {self.difference:.3g}, at {self.at:.4g} s"
        said = said if known else "other samples"
        where = "" if self.channel == "q" else f"; {self.channel} differs"
        causes = "; ".join(self.causes) or "nothing in the record, so softdyn's own code"
        return f"not equal: {said}{where}; what differs: {causes}"


def compare_runs(before: LogData, after: LogData) -> Repetition:
    """Compare a run with its repetition, in all channels but times of computing."""
    names = [name for name in before.channels if name not in TIMES]
    names = ["q", *(name for name in names if name != "q")]
    differs = next((name for name in names if not _same(before, after, name)), None)
    differs = differs or next((name for name in after.channels if name not in before), None)
    difference, at = 0.0, 0.0
    if differs is not None:
        difference = at = math.nan
        common = min(len(before.t), len(after.t))
        one, other = before.q[:common], after.q[:common]
        if one.shape == other.shape and np.allclose(before.t[:common], after.t[:common]):
            away = np.abs(np.nan_to_num(one) - np.nan_to_num(other)).max(axis=1, initial=0.0)
            difference, at = float(away.max()), float(before.t[int(away.argmax())])
    return Repetition(differs, difference, at, tuple(differences(before, after)))


def _same(before: LogData, after: LogData, name: str) -> bool:
    if name not in after:
        return False
    one, other = before[name], after[name]
    return one.shape == other.shape and one.dtype.kind == other.dtype.kind and (
        bool((one == other).all()) if one.dtype.kind == "U" else one.tobytes() == other.tobytes()
    )  # fmt: skip


def differences(before: LogData, after: LogData) -> Iterator[str]:
    """The differences between the records of two runs, in words."""
    for name in dict.fromkeys((*before.versions, *after.versions)):
        one, other = before.versions.get(name), after.versions.get(name)
        if one != other:
            yield f"{name} {one or 'unknown'} → {other or 'unknown'}"
    first, second = before.record, after.record
    if first.get("processor") != second.get("processor"):
        yield f"processor {first.get('processor')} → {second.get('processor')}"
    if before.source.digest != after.source.digest:
        yield "the robot"
    if first and second:
        for name, declared in declarations().items():
            pair = [one["settings"].get(name) for one in (first, second)]
            if declared.of and declared.table and None in pair and pair[0] != pair[1]:
                usual = json.loads(json.dumps(declared.table(declared.of({}))))
                pair = [usual if one is None else one for one in pair]
                yield f"{name} {'none → given' if pair[0] is usual else 'given → none'}"
            yield from _differing(name, *pair)
        yield from _differing("forces", *(
            (one.get("robot") or {}).get("forces", []) for one in (first, second)
        ))  # fmt: skip
        for part in PARTS[1:]:
            yield from _differing(part, first.get(part), second.get(part))


def _differing(place: str, one: Any, other: Any) -> Iterator[str]:
    """The places where two plain values differ; of files only their content counts."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        if "sha256" in one and "sha256" in other:
            if one["sha256"] != other["sha256"]:
                name = one.get("name") or os.path.basename(one["path"])
                yield f"{name} has changed"
            return
        for key in dict.fromkeys((*one, *other)):
            below = place if key == "with" else f"{place}.{key}"
            yield from _differing(below, one.get(key), other.get(key))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from _differing(f"{place}[{k}]", a, b)
    elif one != other:
        yield f"{place} {_short(one)} → {_short(other)}"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
