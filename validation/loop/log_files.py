"""A log's files: NPZ, and CSV with units in its header. Both have all channels and settings."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.csv_table import CsvTable
from softdyn.description.robot import input_unit
from softdyn.validation.arrays import read_npz
from softdyn.validation.channels import LogChannel, every_run
from softdyn.validation.files import atomic, write_text
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.log_checks import FORMAT, check
from softdyn.validation.loop.logged_robot import LoggedRobot

Channels = dict[str, LogChannel]
DECLARED = ("columns", "units", "held", "title", "text")  # fields of a channel besides its values
SETTINGS = "log"  # the column of a CSV with the settings
CELL = 32_000  # characters of a cell; a spreadsheet cuts longer ones off


def save_npz(path: str | Path, channels: Mapping[str, LogChannel], about: dict[str, Any]) -> None:
    """Write a compressed NPZ file, complete or not at all."""
    arrays: dict[str, Any] = {name: channel.values for name, channel in channels.items()}
    with atomic(path) as file:
        np.savez_compressed(file, about=np.array(_settings(channels, about)), **arrays)


def load_npz(path: str | Path) -> tuple[Channels, dict[str, Any]]:
    """The channels and the settings of an NPZ file.

    Raises
    ------
    InputError
        The file cannot be read, or is not a complete, consistent log of this version.
    """
    arrays: dict[str, Any] = {**read_npz(path, f"a log of format {FORMAT}", "log")}
    try:
        text = arrays.pop("about").item()
    except (KeyError, ValueError) as error:
        raise InputError(str(path), f"a log of format {FORMAT}", error) from None
    found, about = _declared(str(path), text)
    if set(found) != set(arrays):
        raise InputError(str(path), f"arrays {', '.join(found)}", ", ".join(arrays))
    channels = {name: channel.filled(arrays[name]) for name, channel in found.items()}
    check(str(path), channels, about)
    return channels, about


def save_csv(path: str | Path, channels: Mapping[str, LogChannel], about: dict[str, Any]) -> None:
    """Write a CSV file, complete or not at all; see `csv_text`."""
    write_text(path, csv_text(channels, about))


def csv_text(channels: Mapping[str, LogChannel], about: dict[str, Any]) -> str:
    """Every sample of a run as a row, every column of every channel as a column.

    The last row is the final state, which repeats the last of all values that are held. A channel
    without a value is left out. The last column, ``log``, has the settings in its first rows.

    Raises
    ------
    InputError
        The log has no control step.
    """
    samples = len(channels["t"].values)
    if samples < 2:
        raise InputError("log", "at least one control step", "none")
    titles, cells = list[str](), list[list[Any]]()
    for channel in channels.values():
        values = channel.values
        known = values != "" if channel.text else np.isfinite(values)
        if values.size and known.any():
            titles += channel.titles
            rows = np.concatenate([values, values[-1:]])[:samples].reshape(samples, -1)
            cells += rows.T.tolist()
    text = _settings(channels, about)
    size = max(CELL, -(-len(text) // samples))
    parts = [text[k * size : (k + 1) * size] for k in range(samples)]
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow([*titles, SETTINGS])
    table.writerows(zip(*cells, parts, strict=True))
    return written.getvalue()


def load_csv(path: str | Path) -> tuple[Channels, dict[str, Any]]:
    """The channels and the settings of a CSV file that `save_csv` wrote.

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
    check(str(path), channels, about)
    return channels, about


def is_log(path: str | Path) -> bool:
    """Whether a CSV file has a log's settings."""
    return SETTINGS in CsvTable(path).titles


def load_recording(path: str | Path, model: SoftModel) -> tuple[Channels, dict[str, Any]]:
    """The channels and the settings of a CSV file that a rig recorded.

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
    rest = np.tile(np.clip(np.zeros(model.nu), model.u_min, model.u_max), (len(t), 1))
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
        "versions": {}, "source": asdict(LoggedRobot.of(model)), "plant": Path(path).name,
        "marks": [], "obstacles": None, "start": "",
    }  # fmt: skip
    check(str(path), channels, about)
    return channels, about


def _settings(channels: Mapping[str, LogChannel], about: dict[str, Any]) -> str:
    """The settings and the channels' declarations as JSON."""
    declared = {
        name: {field: getattr(channel, field) for field in DECLARED}
        for name, channel in channels.items()
    }
    return json.dumps({"format": FORMAT, "channels": declared, **about})


def _declared(where: str, text: Any) -> tuple[Channels, dict[str, Any]]:
    """The channels without values, and the settings, of JSON."""
    try:
        about = json.loads(text)
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(where, f"a log of format {FORMAT}", error) from None
    said = about.pop("format", None) if isinstance(about, dict) else None
    if said != FORMAT:
        got = f"{said}, of another version of softdyn" if said else "another format"
        raise InputError(where, f"a log of format {FORMAT}", got)
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
        raise InputError(where, "the channels of a log", error) from None
    return found, about
