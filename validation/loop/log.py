"""The record of one closed loop."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.validation.arrays import read_npz
from softdyn.validation.files import atomic
from softdyn.validation.loop.metrics import CM, mean_square
from softdyn.validation.plain import LARGEST

FORMAT = "softdyn-log-2"
FLOAT = np.dtype(float)
STEP_TIMES = {"median": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}  # percentiles
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


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """What happened in a closed loop, and what it was.

    With N control steps done there are N + 1 samples of the plant: one at the start of every
    hold, ``t[k] = k · period``, and one at the end of the last, which is the run's final state.
    ``u[k]`` was held from ``t[k]`` to ``t[k + 1]``. Arrays are read-only.

    Attributes
    ----------
    t : np.ndarray, (N + 1,)
        Time (s).
    q, v : np.ndarray, (N + 1, nq), (N + 1, nv)
        The plant's state in the model's convention.
    y, y_ref, error : np.ndarray, (N + 1, 3)
        Tip, reference and ``y - y_ref`` (m).
    u : np.ndarray, (N, nu)
        The input the plant got, inside its bounds.
    V, delta : np.ndarray, (N,)
        Lyapunov function and relaxation; NaN from a controller that has none.
    status : np.ndarray, (N,)
        Text, empty from a controller that has none.
    step_us : np.ndarray, (N,)
        Time of the control step, (q, v) → State → u (µs).
    u_min, u_max : np.ndarray, (nu,)
        The bounds of u.
    u_unit : str
        What one of u is, e.g. ``0.1 N m``.
    robot, controller : str
        Their names.
    kind, theta, omega : str, float, float or None
        The experiment's, None for a plain reference.
    duration, period, timestep : float
        Planned length of the run, control period, plant step (s).
    length : float or None
        The robot's length (m), None when unknown.
    joint_names : tuple[str, ...]
        The order of v.
    contacts : bool
        Whether links could touch.
    complete : bool
        Whether the run reached its end.
    failed, reason : bool, str or None
        Whether it counts as failed (see `ClosedLoop`), and why.
    not_solved, fallbacks : int
        The controller's counts over this run.
    max_bound_violation : float
        Largest violation of the input bounds by an answer, before clipping.
    gains : Any
        The controller's, None if it does not expose them.
    versions : dict[str, str]
        Of the packages that made this run.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    y: np.ndarray
    y_ref: np.ndarray
    error: np.ndarray
    u: np.ndarray
    V: np.ndarray
    delta: np.ndarray
    status: np.ndarray
    step_us: np.ndarray
    u_min: np.ndarray
    u_max: np.ndarray
    u_unit: str
    robot: str
    controller: str
    kind: str | None
    theta: float | None
    omega: float | None
    duration: float
    period: float
    timestep: float
    length: float | None
    joint_names: tuple[str, ...]
    contacts: bool
    complete: bool
    failed: bool
    reason: str | None
    not_solved: int
    fallbacks: int
    max_bound_violation: float
    gains: Any
    versions: dict[str, str]

    def __post_init__(self) -> None:
        for name in SHAPES:
            getattr(self, name).flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        # NumPy's copies come back writeable; the constructor makes them read-only again
        return Log, tuple(getattr(self, field.name) for field in fields(self))

    def __repr__(self) -> str:
        outcome = f"failed: {self.reason}" if self.failed else "done"
        return f"Log({self.robot}, {self.controller}, {self.steps} steps, {outcome})"

    @property
    def steps(self) -> int:
        """Number N of control steps done."""
        return len(self.u)

    @property
    def finite_samples(self) -> int:
        """Number of samples before the first that is not finite, which a diverged run ends with."""
        finite = np.isfinite(self.error).all(axis=1) & np.isfinite(self.q).all(axis=1)
        return len(finite) if finite.all() else int(np.argmin(finite))

    @property
    def final_error_cm(self) -> float:
        """‖e(T)‖ (cm) of the run's final state, the paper's SP; NaN when the run ended early."""
        return CM * float(np.linalg.norm(self.error[-1])) if self.complete else math.nan

    @property
    def mse_cm2(self) -> float:
        """Time-mean of ‖e‖² (cm²) over the whole run, the paper's TT; NaN when it ended early.

        See `metrics.mean_square` for the samples and their weights.
        """
        return CM**2 * mean_square(self.t, self.error) if self.complete else math.nan

    @property
    def step_times_us(self) -> dict[str, float | None]:
        """Median, 99 %, 99.9 % and maximum (µs) of the control step; None for a run without any."""
        if not self.steps:
            return dict.fromkeys(STEP_TIMES)
        return {name: float(np.percentile(self.step_us, p)) for name, p in STEP_TIMES.items()}

    def report(self) -> dict[str, Any]:
        """The run's figures under the names of the JSON contract."""
        return {
            "robot": self.robot,
            "controller": self.controller,
            "kind": self.kind,
            "final_error_cm": self.final_error_cm,
            "mse_cm2": self.mse_cm2,
            "failed": self.failed,
            "reason": self.reason,
            "steps": self.steps,
            "step_us": self.step_times_us,
            "not_solved": self.not_solved,
            "fallbacks": self.fallbacks,
            "max_bound_violation": self.max_bound_violation,
        }

    def summary(self, beside: Mapping[str, str] | None = None) -> str:
        """The same for people, several lines.

        Parameters
        ----------
        beside : Mapping[str, str], optional
            Text to stand beside a figure, by its name in `report`: ``final_error_cm``, ``mse_cm2``.
        """
        sp, tt = (
            f"   {beside[name]}" if beside and name in beside else ""
            for name in ("final_error_cm", "mse_cm2")
        )
        lines = [
            f"{self.robot}, {self.controller}, {self._goal()}: {self.t[-1]:g} s of "
            f"{self.duration:g} s, period {1e3 * self.period:g} ms",
            f"final error    {self.final_error_cm:.3f} cm{sp}",
            f"mean |e|^2     {self.mse_cm2:.3f} cm²{tt}",
        ]
        if self.steps:
            parts = ", ".join(f"{name} {value:.0f}" for name, value in self.step_times_us.items())
            lines.append(f"step time      {parts} us over {self.steps} steps")
        lines.append(
            f"solver         {self.not_solved} not solved, {self.fallbacks} fallbacks, "
            f"bounds exceeded by {self.max_bound_violation:.2g}"
        )
        first, last = (CM * math.dist(self.y[i], self.y_ref[i]) for i in (0, -1))
        fell = f"done: |e| fell from {first:.3f} to {last:.3f} cm"
        return "\n".join([*lines, f"failed: {self.reason}" if self.failed else fell])

    def _goal(self) -> str:
        if self.theta is not None:
            return f"set point at {self.theta:g} pi"
        if self.omega is not None:
            return f"tracking at {self.omega:g} pi rad/s"
        return "set point at " + " ".join(f"{x:g}" for x in self.y_ref[0]) + " m"

    def save(self, path: str | Path) -> None:
        """Write the log as a compressed NPZ file, whole or not at all.

        Raises
        ------
        InputError
            When nothing can be written there.
        """
        arrays = {name: getattr(self, name) for name in SHAPES}
        about = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in SHAPES}
        text = json.dumps({"format": FORMAT, **about})
        with atomic(path) as file:
            np.savez_compressed(file, about=np.array(text), **arrays)

    @classmethod
    def load(cls, path: str | Path) -> Log:
        """Read a log exactly as it was saved.

        Raises
        ------
        InputError
            When the file cannot be read or is not a whole, consistent log.
        """
        where = str(path)
        content: dict[str, Any] = {**read_npz(path, f"a log of format {FORMAT}", "log")}
        try:
            about = json.loads(content.pop("about").item())
        except (KeyError, ValueError, TypeError, RecursionError) as error:
            raise InputError(where, f"a log of format {FORMAT}", error) from None
        _check(where, content, about)
        about.pop("format")
        return cls(**content, **{**about, "joint_names": tuple(about["joint_names"])})


def _format(about: Any) -> Any:
    return about.get("format") if isinstance(about, dict) else None


def _check(where: str, arrays: dict[str, np.ndarray], about: Any) -> None:
    """Refuse what `Log.save` cannot have written, logs of other versions too."""
    if _format(about) != FORMAT:
        raise InputError(where, f"a log of format {FORMAT}", _format(about) or "another format")
    names = {"format"} | {f.name for f in fields(Log)} - set(SHAPES)
    if set(about) != names:
        raise InputError(where, f"entries {sorted(names)}", sorted(about))
    if set(arrays) != set(SHAPES):
        raise InputError(where, f"arrays {', '.join(SHAPES)}", ", ".join(arrays))
    for name, fits in ENTRIES.items():
        if not fits(about[name]):
            raise InputError(where, f"{name} as a log has it", repr(about[name]))
    if about["failed"] != (about["reason"] is not None):
        raise InputError(where, "a reason of failed runs alone", repr(about["reason"]))
    _check_shapes(where, arrays, len(about["joint_names"]))
    _check_values(where, arrays, about)


def _check_shapes(where: str, arrays: dict[str, np.ndarray], nv: int) -> None:
    size = {"space": 3, "nv": nv, "samples": arrays["t"].size}
    size |= {"steps": size["samples"] - 1, "nu": arrays["u_min"].size}
    for name, axes in SHAPES.items():
        shape = arrays[name].shape
        expected = tuple(size.get(axis, s) for axis, s in zip(axes, shape, strict=False))
        if len(shape) != len(axes) or shape != expected:
            raise InputError(where, f"{name} of shape ({', '.join(axes)})", f"shape {shape}")
        dtype = arrays[name].dtype
        if dtype.kind != "U" if name == "status" else dtype != FLOAT:
            raise InputError(where, f"{name} of its own type", f"type {dtype}")


def _check_values(where: str, arrays: dict[str, np.ndarray], about: Mapping[str, Any]) -> None:
    """Refuse arrays that no run has: only the last sample of one that ended early may be NaN."""
    t, u, low, high = (arrays[name] for name in ("t", "u", "u_min", "u_max"))
    if not (t[0] == 0 and np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise InputError(where, "times from 0 that increase", "others")
    if about["complete"] and abs(t[-1] - about["duration"]) > about["timestep"]:
        raise InputError(where, f"{about['duration']} s of a complete run", f"{t[-1]} s")
    whole = len(t) if about["complete"] else len(t) - 1
    for name in ("q", "v", "y", "y_ref", "error"):
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
    return isinstance(value, list) and all(map(_is_text, value)) and len({*value}) == len(value)


def _is_versions(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_text, value.values()))


def _or_none(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or fits(value)


# name → whether a value may stand there in a file; gains are whatever the controller had
ENTRIES: dict[str, Callable[[Any], bool]] = {
    "u_unit": _is_text,
    "robot": _is_text,
    "controller": _is_text,
    "kind": _or_none(_is_text),
    "theta": _or_none(_is_number),
    "omega": _or_none(_is_number),
    "duration": _is_positive,
    "period": _is_positive,
    "timestep": _is_positive,
    "length": _or_none(_is_positive),
    "joint_names": _is_names,
    "contacts": _is_flag,
    "complete": _is_flag,
    "failed": _is_flag,
    "reason": _or_none(_is_text),
    "not_solved": _is_count,
    "fallbacks": _is_count,
    "max_bound_violation": lambda value: _is_number(value) and value >= 0,
    "versions": _is_versions,
}
