"""A log's files: NPZ, and CSV with units in its header. Both have all channels and settings."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.csv_table import CsvTable
from softdyn.validation.arrays import read_npz
from softdyn.validation.channels import LogChannel
from softdyn.validation.files import atomic, write_text
from softdyn.validation.loop.log_checks import FORMAT, check

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
        raise InputError(f"{path}: header", f"a column {SETTINGS!r}, as a log has it", "none")
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
