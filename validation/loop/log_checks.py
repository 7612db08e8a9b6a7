"""Checks of a log's file: its names, its shapes and the plausibility of its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.controllers.channels import LogChannel
from softdyn.description.task_mark import TaskMark
from softdyn.exceptions import errors_in
from softdyn.safety import Surroundings
from softdyn.validation.channels import goals
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.logged_robot import OPTIONAL
from softdyn.validation.plain_data import LARGEST

FORMAT = "softdyn-log-5"
# older formats that are read, and what they lack
OLDER: dict[str, dict[str, Any]] = {"softdyn-log-4": {"record": {}}}
FLOAT = np.dtype(float)
# channel of every log → whether it is held, and its number of columns: 0 for one number per row,
# None for any number
FORMS = {
    "t": (False, 0), "q": (False, None), "v": (False, None), "y": (False, 3), "y_ref": (False, 3),
    "error": (False, 3), "u": (True, None), "V": (True, 0), "delta": (True, 0),
    "status": (True, 0), "step_us": (True, 0),
}  # fmt: skip


def check(where: str, channels: Mapping[str, LogChannel], about: Any) -> None:
    """Refuse content that `Log` cannot have written.

    Parameters
    ----------
    where : str
        The file.
    channels : mapping of str to LogChannel
        Its channels.
    about : Any
        Its settings.

    Raises
    ------
    InputError
        Something is missing, unknown, of the wrong type or inconsistent.
    """
    if set(about) != set(ENTRIES):
        raise InputError(where, f"entries {', '.join(sorted(ENTRIES))}", ", ".join(sorted(about)))
    for name, fits in ENTRIES.items():
        if not fits(about[name]):
            raise InputError(where, f"{name} as a log has it", repr(about[name]))
    if about["failed"] != (about["reason"] is not None):
        raise InputError(where, "a reason only for a failed run", repr(about["reason"]))
    with errors_in(where):
        around = Surroundings.of(about["obstacles"] or {}, where)
        numbers = goals(TaskMark.of(mark) for mark in about["marks"])
    _check_shapes(where, channels)
    for name, columns in (("reserve", around.names), ("targets", [n for n, _ in numbers])):
        if name in channels and channels[name].columns != tuple(columns):
            raise InputError(where, f"columns {columns} of {name}", f"{channels[name].columns}")
    if not {len(about["u_min"]), len(about["u_max"])} == {channels["u"].values.shape[1]}:
        raise InputError(where, "bounds of every input", "others")
    _check_values(where, {name: channel.values for name, channel in channels.items()}, about)


def _check_shapes(where: str, channels: Mapping[str, LogChannel]) -> None:
    for name, (held, count) in FORMS.items():
        if name not in channels:
            raise InputError(where, f"a channel {name}", ", ".join(channels))
        made = channels[name]
        columns = 0 if made.columns is None else len(made.columns)
        fits = (count is None and made.columns is not None) or columns == count
        if (made.held, made.text) != (held, name == "status") or not fits:
            raise InputError(where, f"{name} as a log has it", "another form")
    samples = channels["t"].values.size
    for name, channel in channels.items():
        expected = channel.empty(samples).shape if samples else None
        values = channel.values
        if values.shape != expected:
            raise InputError(where, f"{name} of shape {expected}", f"shape {values.shape}")
        if values.dtype.kind != "U" if channel.text else values.dtype != FLOAT:
            raise InputError(where, f"{name} of its own type", f"type {values.dtype}")


def _check_values(where: str, arrays: dict[str, np.ndarray], about: Mapping[str, Any]) -> None:
    """Refuse impossible values; only the last sample of a run that ended early may be NaN."""
    t, u, low, high = arrays["t"], arrays["u"], np.array(about["u_min"]), np.array(about["u_max"])
    if not (t[0] == 0 and np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise InputError(where, "increasing times from 0", "others")
    if about["complete"] and abs(t[-1] - about["duration"]) > about["timestep"]:
        raise InputError(where, f"{about['duration']} s of a complete run", f"{t[-1]} s")
    whole = len(t) if about["complete"] else len(t) - 1
    aims = about["kind"] != ROLLOUT
    for name in ("q", "v", "y", "y_ref", "error") if aims else ("q", "v", "y"):
        if not np.isfinite(arrays[name][:whole]).all():
            raise InputError(where, f"finite numbers in {name}", "others")
    with np.errstate(invalid="ignore", over="ignore"):
        error = arrays["y"] - arrays["y_ref"]
        same = np.allclose(arrays["error"], error, rtol=1e-9, atol=1e-12, equal_nan=True)
    if not same:
        raise InputError(where, "an error of y - y_ref", "another")
    if not (low <= high).all() or not ((low <= u) & (u <= high)).all():
        raise InputError(where, "inputs inside their bounds", "others")
    if (arrays["step_us"] < 0).any() or np.isinf(arrays["step_us"]).any():
        raise InputError(where, "finite step times >= 0", "others")


def _is_bounds(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(bound, float) for bound in value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return (isinstance(value, float) and math.isfinite(value)) or _is_count(value)


def _is_positive(value: Any) -> bool:
    return _is_number(value) and value > 0


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not _is_flag(value) and abs(value) <= LARGEST


def _is_versions(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_text, value.values()))


def _or_none(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or fits(value)


def _is_source(value: Any) -> bool:
    texts = {"path", "text", "annotations", "digest"}
    return (
        isinstance(value, dict)
        and set(value) - {*OPTIONAL} == {*texts, "floating", "bundled"}
        and all(_is_text(value[name]) for name in texts)
        and _is_flag(value["floating"])
        and (value["bundled"] is None or _is_text(value["bundled"]))
        and isinstance(value.get("basis", {}), dict)
        and isinstance(value.get("gravity", []), list)
    )


# name → whether a value is allowed in a file
ENTRIES: dict[str, Callable[[Any], bool]] = {
    "u_unit": _is_text,
    "u_min": _is_bounds,
    "u_max": _is_bounds,
    "start": _is_text,
    "robot": _is_text,
    "controller": _is_text,
    "kind": _or_none(_is_text),
    "theta": _or_none(_is_number),
    "omega": _or_none(_is_positive),
    "duration": _is_positive,
    "period": _is_positive,
    "timestep": _is_positive,
    "length": _or_none(_is_positive),
    "contacts": _is_flag,
    "complete": _is_flag,
    "failed": _is_flag,
    "reason": _or_none(_is_text),
    "not_solved": _is_count,
    "fallbacks": _is_count,
    "max_bound_violation": lambda value: _is_number(value) and value >= 0,
    "gains": lambda value: True,
    "versions": _is_versions,
    "source": _is_source,
    "plant": _or_none(_is_text),
    "obstacles": _or_none(lambda value: isinstance(value, dict)),
    "record": lambda value: isinstance(value, dict),
    "marks": lambda value: isinstance(value, list),
}
