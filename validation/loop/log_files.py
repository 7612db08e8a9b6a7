"""A log's files: NPZ, and CSV with units in its header. Both have all channels and settings."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import FormatError, InputError, SoftModel
from softdyn.arrays import read_npz
from softdyn.controllers.channels import LogChannel
from softdyn.csv_table import CsvTable
from softdyn.description.library import bundled_file
from softdyn.description.robot import input_unit
from softdyn.description.task_mark import TaskMark
from softdyn.files import is_stream
from softdyn.formats import KEY, check_format
from softdyn.validation.channels import every_run
from softdyn.validation.files import atomic, read_json, write_json, write_text
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.log_checks import FORMAT, OLDER, check
from softdyn.validation.loop.log_data import LogData
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.provenance import found as placed
from softdyn.validation.loop.provenance import name_shown, path_from, path_shown, written
from softdyn.validation.loop.repeat import record_for, record_in, whole_record

Channels = dict[str, LogChannel]
DECLARED = ("columns", "units", "held", "title", "text")  # fields of a channel besides its values
RECORD = ".json"  # after the name of a CSV: its record
SETTINGS = "log"  # the column of a CSV with the settings
CELL = 32_000  # characters of a cell; a spreadsheet cuts longer ones off


def save_npz(path: str | Path, log: LogData) -> None:
    """Write a compressed NPZ file, complete or not at all."""
    arrays: dict[str, Any] = {name: channel.values for name, channel in log.channels.items()}
    with atomic(path) as file:
        about = _settings(log, Path(path).parent, log.record)
        np.savez_compressed(file, about=np.array(about), **arrays)


def load_npz(path: str | Path) -> dict[str, Any]:
    """The fields of the log in an NPZ file.

    Raises
    ------
    InputError
        The file cannot be read, or is not a complete, consistent log of this version.
    """
    arrays: dict[str, Any] = {**read_npz(path, f"a log of format {FORMAT}", "log")}
    try:
        text = arrays.pop("about").item()
    except (KeyError, ValueError) as error:
        raise FormatError(str(path), f"a log of format {FORMAT}", error) from None
    found, about = _declared(str(path), text)
    if set(found) != set(arrays):
        raise FormatError(str(path), f"arrays {', '.join(found)}", ", ".join(arrays))
    channels = {name: channel.filled(arrays[name]) for name, channel in found.items()}
    return _checked(path, channels, about)


def save_csv(path: str | Path, log: LogData) -> None:
    """Write a CSV file, complete or not at all; see `csv_text`. Its record is in ``PATH.json``."""
    folder = Path(path).parent
    write_text(path, csv_text(log, folder))
    if log.record and not is_stream(Path(path)):
        write_json(f"{path}{RECORD}", record_for(whole_record(log), folder))


def csv_text(log: LogData, folder: str | Path = Path()) -> str:
    """Every sample of a run as a row, every column of every channel as a column.

    The last row is the final state, which repeats the last of all values that are held. A channel
    without a value is left out. The last column, ``log``, has the settings in its first rows.

    Raises
    ------
    InputError
        The log has no control step.
    """
    samples = len(log.t)
    if samples < 2:
        raise InputError("log", "at least one control step", "none")
    titles, cells = list[str](), list[list[Any]]()
    for channel in log.channels.values():
        values = channel.values
        known = values != "" if channel.text else np.isfinite(values)
        if values.size and known.any():
            titles += channel.titles
            rows = np.concatenate([values, values[-1:]])[:samples].reshape(samples, -1)
            cells += rows.T.tolist()
    text = _settings(log, Path(folder), {})
    size = max(CELL, -(-len(text) // samples))
    parts = [text[k * size : (k + 1) * size] for k in range(samples)]
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow([*titles, SETTINGS])
    table.writerows(zip(*cells, parts, strict=True))
    return written.getvalue()


def load_csv(path: str | Path) -> dict[str, Any]:
    """The fields of the log in a CSV file that `save_csv` wrote.

    Raises
    ------
    InputError
        The file cannot be read, or is no consistent log of this version.
    """
    file = CsvTable(path)
    if SETTINGS not in file.titles:
        expected = f"a column {SETTINGS!r}, as a log has it, or the robot of a recording"
        raise InputError(f"{path}: header", expected, "neither")
    found, about = _declared(str(path), "".join(file.cells(SETTINGS)))
    beside = f"{path}{RECORD}"
    if os.path.isfile(beside):
        about["record"] = record_in(read_json(beside, "the record of a run"), beside)
    channels = {}
    for name, channel in found.items():
        values = channel.empty(len(file)).reshape(len(file) - channel.held, len(channel.titles))
        for k, title in enumerate(channel.titles):
            if title in file.titles:
                cells = file.cells(title)[: len(values)]
                try:
                    values[:, k] = cells if channel.text else [float(x or "nan") for x in cells]
                except ValueError:
                    raise InputError(f"{path}: column {title}", "numbers", "others") from None
        shaped = values if channel.columns is not None else values[:, 0]
        channels[name] = channel.filled(shaped.astype(str) if channel.text else shaped)
    return _checked(path, channels, about)


def is_log(path: str | Path) -> bool:
    """Whether a CSV file has a log's settings."""
    return SETTINGS in CsvTable(path).titles


def load_recording(path: str | Path, model: SoftModel) -> dict[str, Any]:
    """The fields of a log, from a CSV file that a rig recorded.

    It has ``t`` (s) and ``q.JOINT`` for every joint, and may have ``v.JOINT``, ``u.INPUT``,
    ``target.x``, ``.y`` and ``.z``, and the commands, acting inputs and readings of a rig. Missing
    velocities are differences, missing inputs the ones nearest to 0.

    Raises
    ------
    InputError
        The file cannot be read, lacks a column, or has numbers that no run has.
    """
    file, found = CsvTable(path), {channel.name: channel for channel in every_run(model)}
    t = file.numbers(["t"])[:, 0]
    if len(t) < 2 or not (np.diff(t) > 0).all():
        raise InputError(f"{path}: column t", "two increasing times or more", "others")
    q = file.numbers(found["q"].names)
    rest = np.tile(model.relaxed, (len(t), 1))
    usual = {"u": rest, "y_ref": np.full((len(t), 3), np.nan)}
    if model.nq == model.nv:
        usual["v"] = np.gradient(q, t, axis=0)
    given = {}
    for name in ("u", "v", "y_ref"):
        there = {*found[name].names} <= {*file.names}
        given[name] = file.numbers(found[name].names) if there or name not in usual else usual[name]
    y = np.array([model.state(*state).y for state in zip(q, given["v"], strict=True)])
    values = given | {"t": t - t[0], "q": q, "y": y, "error": y - given["y_ref"]}
    for prefix in ("command", "acting", "measured"):
        names = [name for name in file.names if name.startswith(f"{prefix}.")]
        if names:
            columns = ((name.partition(".")[2], "") for name in names)
            found[prefix] = LogChannel.of(prefix, columns, held=prefix == "command")
            values[prefix] = file.numbers(names, (f"{prefix}.",))
    channels = {}
    for name, channel in found.items():
        array = values.get(name, channel.empty(len(t) + channel.held))
        array = array[: len(t) - channel.held]
        channels[name] = channel.filled(array.astype(str) if channel.text else array)
    period, aims = float(np.median(np.diff(t))), bool(np.isfinite(given["y_ref"]).all())
    about = {
        "u_min": model.u_min.tolist(), "u_max": model.u_max.tolist(),
        "u_unit": input_unit(model.robot), "robot": model.bundled or model.name,
        "controller": Path(path).name, "kind": None if aims else ROLLOUT, "theta": None,
        "omega": None, "duration": float(t[-1] - t[0]), "period": period, "timestep": period,
        "length": model.robot.length or None, "contacts": False, "complete": True, "failed": False,
        "reason": None, "not_solved": 0, "fallbacks": 0, "max_bound_violation": 0.0, "gains": None,
        "versions": {}, "source": LoggedRobot.of(model).table, "plant": Path(path).name,
        "marks": [], "obstacles": None, "start": "", "record": {},
    }  # fmt: skip
    return _checked(path, channels, about)


def _settings(log: LogData, folder: Path, record: Mapping[str, Any]) -> str:
    """The settings and the channels' declarations as JSON, for a file in a folder."""
    declared = {
        name: {field: getattr(channel, field) for field in DECLARED}
        for name, channel in log.channels.items()
    }
    about = {f.name: getattr(log, f.name) for f in fields(LogData) if f.name != "channels"}
    about |= {
        "u_min": log.u_min.tolist(), "u_max": log.u_max.tolist(),
        "source": log.source.table | {"path": path_shown(log.source.path, folder)},
        "marks": [mark.table for mark in log.marks], "record": written(record, folder),
        "controller": name_shown(log.controller),
    }  # fmt: skip
    return json.dumps({KEY: FORMAT, "channels": declared, **about})


def _checked(path: str | Path, channels: Channels, about: dict[str, Any]) -> dict[str, Any]:
    """The fields of a log, from its channels and its settings as plain data."""
    check(str(path), channels, about)
    source, folder = about["source"], Path(path).parent
    robot = str(bundled_file(source["bundled"] or "") or path_from(source["path"], folder))
    return about | {
        "channels": channels, "u_min": np.array(about["u_min"]), "u_max": np.array(about["u_max"]),
        "source": LoggedRobot(**about["source"] | {"path": robot}),
        "record": placed(about["record"], folder),
        "marks": tuple(TaskMark.of(table) for table in about["marks"]),
    }  # fmt: skip


def _declared(where: str, text: Any) -> tuple[Channels, dict[str, Any]]:
    """The channels without values, and the settings, of JSON."""
    try:
        about = json.loads(text)
    except (ValueError, TypeError, RecursionError) as error:
        raise FormatError(where, f"a log of format {FORMAT}", error) from None
    said = about.pop(KEY, None) if isinstance(about, dict) else None
    if said in OLDER:
        about |= OLDER[said]
    else:
        check_format(said, FORMAT, where, "a log")
    found = {}
    try:
        for name, table in about.pop("channels").items():
            named, units = table.pop("columns"), tuple(table.pop("units"))
            named = None if named is None else tuple(named)
            words, flags = (*(named or ()), *units, table["title"]), (table["held"], table["text"])
            each = [isinstance(w, str) for w in words] + [isinstance(f, bool) for f in flags]
            count = 1 if named is None else len({*named})
            if not all(each) or len(units) not in (0, count) or count < len(named or ()):
                raise ValueError(name)
            found[name] = LogChannel(name, named, units, **table)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FormatError(where, "the channels of a log", error) from None
    return found, about
