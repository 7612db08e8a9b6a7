"""Residuals by output, input and time, and extensions that the model may lack.

A hint is an experiment: one extension of the model is fitted beside the unknowns to the same data,
and the error on data that no fit has seen is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError, SoftdynError
from softdyn.identification.data import Measurements
from softdyn.identification.design import DesignFile
from softdyn.identification.markers.camera import CAMERA
from softdyn.identification.output_error import fit
from softdyn.identification.parameters import Parameter, parameters
from softdyn.identification.problem import Fit, FitProblem
from softdyn.identification.result import Identified, distance, rms
from softdyn.identification.unknowns.kinds import (
    CABLE_FRICTION,
    INPUT_LOSS,
    KINDS,
    SENSOR_BIAS,
    Kind,
    MotionSample,
)
from softdyn.identification.unknowns.sensor_errors import READ

ONE_EACH = ("q", "length", "measured")  # outputs of one number; the others are points and poses
PARTS = 4  # of the time, or of the rows
SLIGHT = 0.05  # of a joint's stiffness times 1 rad: a first guess of dry friction
GUESS = 0.1  # a first guess of a cable's friction
FEWEST = 3  # rows of a fit
FOLDS = 11  # largest number of parts of static rows, if the user states none


def cubes(sample: MotionSample) -> np.ndarray:
    """Joint forces (n, 1) of the springs' stiffness times the cubes of their deflections."""
    model = sample.state.model
    deflection = model.coordinates(sample.state.q) - model.rest
    return np.asarray(model.stiffness * deflection**3)[:, None]


STIFFENING = Kind(
    "stiffening", "1/rad^2, 1/m^2", lambda model: ("all",), lambda model: np.zeros(1), cubes,
    lambda robot, values: robot, -np.inf, about_zero=True,
)  # fmt: skip
"""Springs with the stiffness k (1 + θ e²) at the deflection e, near θ = 0: no model has them."""


@dataclass(frozen=True)
class Hint:
    """An extension, and the rms residuals on unseen data without and with it; see `distance`."""

    extension: str
    before: float
    after: float

    def __str__(self) -> str:
        way = "lowers" if self.after < self.before else "does not lower"
        change = f"from {self.before:.3g} to {self.after:.3g}"
        return f"adding {self.extension} {way} the held-out error: {change}"


def where(found: Identified) -> list[dict[str, Any]]:
    """Rms residuals by output (markers as one), by quarter of time, and by quarter of each input.

    The input quarters have equal numbers of rows, from the least to the largest input.
    """
    left, u, rows = found.residuals, found.data.u, []
    keys = []
    for name in found.names:
        stem, _, axis = name.rpartition(".")
        turn = " rotation" if axis in CAMERA[3:] else ""
        keys.append(stem + turn if axis in CAMERA and stem not in ONE_EACH else name)
    for key in dict.fromkeys(keys):
        own = left[:, [k for k, one in enumerate(keys) if one == key]]
        rows.append({"by": "output", "of": key, "rms": rms(own)})
    scaled = left / found.noise
    orders = {"time": np.arange(len(left))}
    for k, one in enumerate(found.model.robot.actuators):
        orders[f"input {one.name}"] = np.argsort(u[:, k], kind="stable")
    for by, order in orders.items():
        for k, part in enumerate(np.array_split(order, PARTS)):
            rows.append({"by": by, "of": f"quarter {k + 1}", "rms": rms(scaled[part])})
    return rows


def where_text(rows: Sequence[dict[str, Any]]) -> str:
    """`where` as text."""
    lines = []
    for by in dict.fromkeys(row["by"] for row in rows):
        own = [row for row in rows if row["by"] == by]
        shown = [f"{row['of']} {row['rms']:.3g}" for row in own] if by == "output" else [
            f"{row['rms']:.2g}" for row in own
        ]  # fmt: skip
        unit = "rms" if by == "output" else "in standard deviations, first to last quarter"
        lines.append(f"residuals by {by}, {unit}: {', '.join(shown)}")
    return "\n".join(lines)


def extensions(
    model: SoftModel, unknowns: Sequence[Parameter], static: bool, made: DesignFile | None,
    names: Sequence[str] = (),
) -> Iterator[tuple[str, tuple[Parameter, ...]]]:  # fmt: skip
    """The extensions that are no unknowns yet: friction, biases of sensors, the path of cables."""
    taken = {one.names[0] for one in unknowns}
    driven = {one.tendon for one in model.robot.actuators}
    rubs = np.array([float(one.name in driven) for one in model.robot.tendons])
    if static and rubs.any() and not taken & {CABLE_FRICTION.name, "friction"}:
        label = f"{CABLE_FRICTION.name}, all"
        yield CABLE_FRICTION.name, (Parameter(CABLE_FRICTION, label, rubs, GUESS),)
    if static and INPUT_LOSS.name not in taken and model.nu:
        yield INPUT_LOSS.name, parameters(model, INPUT_LOSS.name, shared=True)
    if not static and "friction" not in taken:
        size = SLIGHT * float(model.stiffness.mean() or 1.0)
        yield "friction", (Parameter(KINDS["friction"], "friction, all", np.ones(model.nv), size),)
    if SENSOR_BIAS.name not in taken and any(name.startswith(READ) for name in names):
        read = [
            one for one in parameters(model, SENSOR_BIAS.name) if one.shift(model, names).any()
        ]  # fmt: skip
        yield SENSOR_BIAS.name, tuple(read)
    if made is not None and "offset" not in taken:
        try:
            yield "offset", made.unknowns(("offset.cable",))
        except InputError:  # the design has no cables
            return
    elif made is None and "gear" not in taken and model.nu:
        yield "gear", parameters(model, "gear")


def hints(
    found: Identified,
    again: Callable[[tuple[Parameter, ...]], Identified],
    folds: int,
    made: DesignFile | None = None,
    *,
    progress: bool = False,
) -> Iterator[Hint]:
    """The gain of each extension; one that cannot be fitted is left out.

    Parameters
    ----------
    found : Identified
    again : callable
        More unknowns → the fit of data over time with them, with the same part held out.
    folds : int
        Parts of static rows that are left out in turn.
    made : DesignFile, optional
        The design that was fitted.
    progress : bool
        Show on stderr which extension is tried, if that is a terminal.
    """
    names, unknowns = found.names, found.fit.problem.unknowns
    base = found.fit.problem.base
    if found.static:
        before = distance(names, left_out(found.fit, folds))
        strained = distance(names, left_out(found.fit, folds, stiffened))
        yield Hint("a stiffness that depends on strain", before, strained)
    else:
        before = found.rms_held_out
    tried = list(extensions(base, unknowns, found.static, made, names))
    bar = tqdm(tried, disable=None if progress else True, leave=False, unit=" extensions")
    for name, more in bar:
        bar.set_description(f"tries {name}")
        try:
            if found.static:
                after = distance(names, left_out(_extended(found.fit, more), folds))
            else:
                after = again(more).rms_held_out
        except SoftdynError:
            continue
        yield Hint(name, before, after)


def _extended(found: Fit, more: tuple[Parameter, ...]) -> Fit:
    """The fit with more unknowns, at their first guesses."""
    problem = replace(found.problem, unknowns=found.problem.unknowns + more)
    return replace(found, problem=problem, theta=np.append(found.theta, [x.nominal for x in more]))


Forecast = Callable[[Fit, FitProblem], np.ndarray]


def as_fitted(found: Fit, rows: FitProblem) -> np.ndarray:
    """Outputs (N, outputs) of static rows by the fitted model."""
    return rows.outputs(found.theta, rows.firsts())[0]


def stiffened(found: Fit, rows: FitProblem) -> np.ndarray:
    """Outputs (N, outputs) of static rows if the springs stiffen.

    θ of `STIFFENING` is fitted together with the unknowns by one linear step from the fit found.
    """
    theta = np.append(found.theta, 0.0)
    stiffening = Parameter(STIFFENING, "stiffening, all", np.ones(1), 0.0)

    def near(problem: FitProblem) -> tuple[np.ndarray, np.ndarray]:
        wide = replace(problem, unknowns=(*problem.unknowns, stiffening))
        (run,) = wide.simulated(theta, wide.firsts())
        return run.out, run.by_theta

    out, slope = near(found.problem)
    known = np.isfinite(found.problem.data.outputs)
    left = ((found.problem.data.outputs - out) / found.noise)[known]
    A = (slope / found.noise[:, None])[known]
    scale = np.maximum(np.linalg.norm(A, axis=0), np.finfo(float).tiny)
    step = np.linalg.lstsq(A / scale, left)[0] / scale
    out, slope = near(rows)
    return np.asarray(out + slope @ step)


def left_out(found: Fit, folds: int, forecast: Forecast = as_fitted) -> np.ndarray:
    """Residuals (N, outputs) of static rows that are left out of the fit, in parts.

    Each fit of the others starts from the values found.

    Parameters
    ----------
    found : Fit
    folds : int
        Number of parts; 3 rows or more are left in.
    forecast : callable
        (fit of the others, problem of all rows) → outputs (N, outputs).

    Raises
    ------
    InputError
        For data over time, and another number of parts.
    """
    begin = [
        replace(one, nominal=float(value))
        for one, value in zip(found.problem.unknowns, found.theta, strict=True)
    ]
    problem = replace(found.problem, unknowns=tuple(begin))
    data, rows = problem.data, np.arange(len(problem.data.t))
    if not (problem.acquisition.static and 2 <= folds <= len(rows) and len(rows) > FEWEST):
        expected = f"2 to {len(rows)} parts of static rows, {FEWEST + 1} or more"
        raise InputError(
            "folds", expected, folds if problem.acquisition.static else "data over time"
        )
    residuals = np.full(data.outputs.shape, np.nan)
    for k in range(folds):
        held = rows % folds == k
        own = fit(_on(problem, data.rows(rows[~held])))
        residuals[held] = (data.outputs - forecast(own, _on(own.problem, data)))[held]
    return residuals


def _on(problem: FitProblem, data: Measurements) -> FitProblem:
    return replace(problem, data=data, runs=((0, len(data.t)),))
