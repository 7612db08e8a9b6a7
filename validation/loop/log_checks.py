"""Checks of a log's file: its names, its shapes and the plausibility of its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.description.task_mark import TaskMark
from softdyn.exceptions import errors_in
from softdyn.safety import Surroundings
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.plain_data import LARGEST

FORMAT = "softdyn-log-3"
FLOAT = np.dtype(float)
# Axes of the arrays: N control steps, N + 1 samples, the robot's sizes, 3 of space.
SHAPES = {
    "t": ("samples",),
    "q": ("samples", "nq"),
    "v": ("samples", "nv"),
    "y": ("samples", "space"),
    "y_ref": ("samples", "space"),
    "error": ("samples", "space"),
    "u": ("steps", "nu"),
    "V": ("steps",),
    "delta": ("steps",),
    "status": ("steps",),
    "step_us": ("steps",),
    "u_min": ("nu",),
    "u_max": ("nu",),
}
# only of a `certified` log
CERTIFIED = {"Vdot": ("steps",), "delta_true": ("steps",)}
# only from a run with a rig
RIGGED = {
    "command": ("steps", "nu"),
    "acting": ("samples", "nu"),
    "q_seen": ("steps", "nq"),
    "v_seen": ("steps", "nv"),
    "measured": ("samples", "sensors"),
}
# only from a run on a real rig
DRIVEN = {"clock": ("samples",), "stamps": ("samples", "sensors"), "missed": ("samples",)}
# only from a controller of several tasks
TASKED = {"tasks": ("samples", "columns")}
# and of those, only from tasks of links' frames
AIMED = {"targets": ("samples", "numbers")}
# only from a run among obstacles
SURROUNDED = {"reserve": ("samples", "barriers")}
# only from a controller that found an equilibrium to go to
GOING = {"distance": ("steps",)}
# only from an observer of disturbances
ESTIMATED = dict.fromkeys(("disturbances", "deviations"), ("samples", "disturbances"))
EXTRA = CERTIFIED | RIGGED | DRIVEN | TASKED | AIMED | SURROUNDED | GOING | ESTIMATED
# keys that older logs lack
NAMES = (
    "sensor_names", "command_units", "sensor_units", "task_names", "task_units",
    "disturbance_names", "disturbance_units", "marks",
)  # fmt: skip
ADDED: dict[str, Any] = {"plant": None, "obstacles": None, "start": ""}
ADDED |= {name: [] for name in NAMES}


def _format(about: Any) -> Any:
    return about.get("format") if isinstance(about, dict) else None


def check(where: str, arrays: dict[str, np.ndarray], about: Any, names: set[str]) -> None:
    """Refuse content that `Log.save` cannot have written, and logs of other versions.

    Parameters
    ----------
    where : str
        The file.
    arrays : dict[str, np.ndarray]
        Its arrays.
    about : Any
        The content of its JSON.
    names : set of str
        The fields of a log that are not arrays.

    Raises
    ------
    InputError
        Something is missing, unknown, of the wrong type or inconsistent.
    """
    if _format(about) != FORMAT:
        raise InputError(where, f"a log of format {FORMAT}", _format(about) or "another format")
    if set(about) != names | {"format"}:
        raise InputError(where, f"entries {sorted(names)}", sorted(about))
    groups = (SHAPES, CERTIFIED, RIGGED, DRIVEN, TASKED, AIMED, SURROUNDED, GOING, ESTIMATED)
    whole = [group for group in groups if group is SHAPES or not {*group}.isdisjoint(arrays)]
    if {name for group in whole for name in group} != set(arrays):
        raise InputError(where, f"arrays {', '.join(SHAPES)}", ", ".join(arrays))
    for name, fits in ENTRIES.items():
        if not fits(about[name]):
            raise InputError(where, f"{name} as a log has it", repr(about[name]))
    if about["failed"] != (about["reason"] is not None):
        raise InputError(where, "a reason only for a failed run", repr(about["reason"]))
    with errors_in(where):
        around = Surroundings.of(about["obstacles"] or {}, where)
        goals = [name for mark in about["marks"] for name in TaskMark.of(mark).columns]
    sizes = {"nv": "joint_names", "sensors": "sensor_names", "columns": "task_names"}
    sizes |= {"disturbances": "disturbance_names"}
    lengths = {axis: len(about[name]) for axis, name in sizes.items()}
    lengths |= {"barriers": len(around.names), "numbers": len(goals)}
    _check_shapes(where, arrays, lengths)
    _check_units(where, arrays, about)
    _check_values(where, arrays, about)


def _check_shapes(where: str, arrays: dict[str, np.ndarray], size: dict[str, int]) -> None:
    size |= {"space": 3, "samples": arrays["t"].size}
    size |= {"steps": size["samples"] - 1, "nu": arrays["u_min"].size}
    for name, axes in (SHAPES | EXTRA).items():
        if name not in arrays:
            continue
        shape = arrays[name].shape
        expected = tuple(size.get(axis, s) for axis, s in zip(axes, shape, strict=False))
        if len(shape) != len(axes) or shape != expected:
            raise InputError(where, f"{name} of shape ({', '.join(axes)})", f"shape {shape}")
        dtype = arrays[name].dtype
        if dtype.kind != "U" if name == "status" else dtype != FLOAT:
            raise InputError(where, f"{name} of its own type", f"type {dtype}")


def _check_units(where: str, arrays: dict[str, np.ndarray], about: Mapping[str, Any]) -> None:
    """Refuse units that are not one for each column; older logs have none."""
    sizes = {"command_units": arrays["u_min"].size, "sensor_units": len(about["sensor_names"])}
    sizes |= {f"{what}_units": len(about[f"{what}_names"]) for what in ("task", "disturbance")}
    for name, size in sizes.items():
        if len(about[name]) not in (0, size):
            raise InputError(where, f"{size} of {name}", f"{len(about[name])}")


def _check_values(where: str, arrays: dict[str, np.ndarray], about: Mapping[str, Any]) -> None:
    """Refuse impossible values; only the last sample of a run that ended early may be NaN."""
    t, u, low, high = (arrays[name] for name in ("t", "u", "u_min", "u_max"))
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


def _is_names(value: Any) -> bool:
    return _is_units(value) and len({*value}) == len(value)


def _is_units(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _is_versions(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_text, value.values()))


def _or_none(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or fits(value)


def _is_source(value: Any) -> bool:
    texts = {"path", "text", "annotations", "digest"}
    return (
        isinstance(value, dict)
        and set(value) == {*texts, "floating", "bundled"}
        and all(_is_text(value[name]) for name in texts)
        and _is_flag(value["floating"])
        and (value["bundled"] is None or _is_text(value["bundled"]))
    )


# name → whether a value is allowed in a file; gains may have any form
ENTRIES: dict[str, Callable[[Any], bool]] = {
    "u_unit": _is_text,
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
    "joint_names": _is_names,
    "sensor_names": _is_names,
    "command_units": _is_units,
    "sensor_units": _is_units,
    "task_names": _is_names,
    "task_units": _is_units,
    "disturbance_names": _is_names,
    "disturbance_units": _is_units,
    "contacts": _is_flag,
    "complete": _is_flag,
    "failed": _is_flag,
    "reason": _or_none(_is_text),
    "not_solved": _is_count,
    "fallbacks": _is_count,
    "max_bound_violation": lambda value: _is_number(value) and value >= 0,
    "versions": _is_versions,
    "source": _is_source,
    "plant": _or_none(_is_text),
    "obstacles": _or_none(lambda value: isinstance(value, dict)),
    "marks": lambda value: isinstance(value, list),
}
