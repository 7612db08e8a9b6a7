"""Trials that show whether measurements identify the parameters, on a twin with other values.

The data come from MuJoCo, not from the model. A robot with randomly drawn parameters moves under
random inputs, its outputs get noise, and the fit starts from the file's values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from softdyn import InputError, SoftModel
from softdyn.checks import number
from softdyn.dynamics.balance import ForceBalance
from softdyn.identification import (
    MAX_ROWS,
    Acquisition,
    Identified,
    MarkerView,
    Measurements,
    Parameter,
    apply_values,
    compute_outputs,
    identify,
    least_deviations,
    member_values,
    prepared,
)
from softdyn.statics.equilibria import settle
from softdyn.validation.processes import in_order
from softdyn.validation.tables import Table
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin

# standard deviations of noise by type of joint (rad, m), and for tip and cables (m)
JOINT_NOISE = {"revolute": 0.005, "continuous": 0.005, "prismatic": 1e-4}
TIP_NOISE = 0.001
GAP, GAP_EVERY = 0.04, 0.5  # s; how long and how often a marker is lost
# range of drawn values that are zero in the file (rad, m): rest positions, offsets
ABOUT_ZERO = 0.05

# limit of step times eigenvalue: the method diverges at 2.79, and the inertia changes with the
# motion
STABLE = 1.5
FINEST = 1e-7  # s: with shorter plant steps, a run would take too long
LONGEST_REST, STILL = 600, 1e-6  # tenths of a second; rad/s or m/s


@dataclass(frozen=True)
class Excitation:
    """The excitation of the twin.

    Attributes
    ----------
    seconds, rate : float
        Length (s), and samples per second.
    spread : float
        Parameters are drawn within this share of the file's.
    knots, amplitude, bias : float or tuple of float
        One for all inputs, or one for each. Inputs are linear between random values at knots that
        are `knots` (s) apart. The values use the share `amplitude` of the input's range. The share
        `bias` of the range is added, which can move joints off their stops.
    at_rest : bool
        Whether data of all joints begin at rest. Otherwise they begin at q = 0, from where the
        robot falls. Other data always begin at rest.
    timestep : float
        Longest step of the plant (s). The step divides the sample time, and is shorter if the
        explicit Runge-Kutta method needs it. MuJoCo's other methods are of first order: at 0.1 ms
        their error shifts a stiffness of the SpiRob by four standard deviations of a fit to 20 s of
        noisy joint angles.
    """

    seconds: float = 20.0
    rate: float = 200.0
    spread: float = 0.3
    knots: float | tuple[float, ...] = 0.2
    amplitude: float | tuple[float, ...] = 0.6
    bias: float | tuple[float, ...] = 0.0
    at_rest: bool = False
    timestep: float = 1e-4

    def __post_init__(self) -> None:
        number("seconds", self.seconds, above=0.0)
        if self.seconds * self.rate > MAX_ROWS:
            raise InputError("seconds", f"at most {MAX_ROWS / self.rate:g}", self.seconds)
        number("timestep", self.timestep, lower=FINEST)

    def inputs(self, model: SoftModel, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Inputs (N, m), around the middle of ranges that contain 0, else from the lower bound."""
        knots = _of_inputs("knots", self.knots, model, 1 / self.rate, MAX_ROWS / self.rate)
        amplitude = _of_inputs("amplitude", self.amplitude, model, 0.0, 1.0)
        bias = _of_inputs("bias", self.bias, model, 0.0, 1.0)
        low, high = model.u_min, model.u_max
        low = np.where(low < 0, low * amplitude, low)
        high = low + np.where(low < 0, amplitude * (high - model.u_min), amplitude * (high - low))
        count = int(np.ceil(self.seconds / knots.min())) + 2
        values = rng.uniform(low, high, (count, model.nu))
        values[0] = np.clip(0, low, high)
        values = np.clip(values + bias * (model.u_max - model.u_min), model.u_min, model.u_max)
        times = np.arange(count)[:, None] * knots
        return np.stack([np.interp(t, *both) for both in zip(times.T, values.T, strict=True)], 1)


def _of_inputs(
    name: str, given: float | tuple[float, ...], model: SoftModel, least: float, most: float
) -> np.ndarray:
    """One number per input (m,), from a common one or one for each."""
    numbers = np.asarray(given)
    if numbers.shape not in ((), (1,), (model.nu,)):
        raise InputError(name, f"one number, or {model.nu}", f"{numbers.size} of them")
    if not ((numbers >= least) & (numbers <= most)).all():
        raise InputError(name, f"numbers from {least:g} to {most:g}", numbers.tolist())
    return np.broadcast_to(numbers, model.nu)


def twin_data(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    outputs: Sequence[str],
    excitation: Excitation,
    noise: float,
    seed: int,
) -> tuple[Measurements, np.ndarray]:
    """Measurements of a twin whose parameters were drawn, and the drawn θ.

    Parameters
    ----------
    model : SoftModel
    unknowns : sequence of Parameter
        The parameters that are drawn.
    outputs : sequence of str
        Names as in `Measurements`.
    excitation : Excitation
    noise : float
        Factor on `JOINT_NOISE` and `TIP_NOISE`; 0 is without noise.
    seed : int
    """
    number("noise", noise, lower=0.0)
    rng = np.random.default_rng(seed)
    nominal = np.array([parameter.nominal for parameter in unknowns])
    drawn = rng.uniform(-excitation.spread, excitation.spread, len(nominal))
    theta = np.where(nominal, nominal * (1 + drawn), ABOUT_ZERO * drawn)
    true = apply_values(model, unknowns, theta)
    steps = plant_steps(true, 1 / excitation.rate, excitation.timestep)
    timestep = 1 / excitation.rate / steps
    twin = Twin(true.robot, timestep=timestep, integrator="rk4", friction=True)
    factors = member_values(model, unknowns, theta).get("mass", {})
    # the twin reads the file's text, which has the old values
    for joint, factor in factors.items():
        scale_mass(twin.model, joint, factor)
    if factors:
        mujoco.mj_setConst(twin.model, twin.data)
        twin.reset()
    states = StateMap(true, twin)
    t = np.arange(int(excitation.seconds * excitation.rate)) / excitation.rate
    u = excitation.inputs(true, t, rng)
    all_joints = {f"q.{name}" for name in true.joint_names} <= set(outputs)
    if excitation.at_rest or not all_joints:
        twin.set_state(*states.to_twin(settle(true, u[0]).q, np.zeros(true.nv)))
        _come_to_rest(twin, u[0])
    path = np.empty((len(t), true.nv))
    for k, held in enumerate(u):
        q, _ = states.from_twin(twin.qpos, twin.qvel)
        path[k] = true.coordinates(q)
        twin.advance(held, steps)
    values, _ = compute_outputs(true, outputs, path, np.zeros((len(t), true.nv, 0)))
    for unknown, value in zip(unknowns, theta, strict=True):
        values = values + value * unknown.shift(true, outputs)
    values = values + noise * deviations(true, outputs) * rng.standard_normal(values.shape)
    lose_and_rename(values, outputs, t, rng)
    return Measurements(t, u, tuple(outputs), values), theta


def lose_and_rename(
    values: np.ndarray, outputs: Sequence[str], t: np.ndarray, rng: np.random.Generator
) -> None:
    """Leave gaps in the markers among outputs (N, k), and give them new names, in place.

    Every `GAP_EVERY` seconds some marker is lost for `GAP` seconds; then all get other names.
    """
    places = MarkerView.of(outputs).positions
    if not places or not any(name.startswith("point.") for name in outputs):
        return
    columns = np.array(places)[:, None] + np.arange(3)
    for begin in np.arange(GAP_EVERY / 2, t[-1], GAP_EVERY):
        gap = (t >= begin) & (t < begin + GAP)
        values[np.ix_(gap, columns[rng.integers(len(places))])] = np.nan
        after = np.flatnonzero(t >= begin + GAP)
        order = rng.permutation(len(places))
        values[np.ix_(after, columns.ravel())] = values[np.ix_(after, columns[order].ravel())]


def deviations(model: SoftModel, outputs: Sequence[str]) -> np.ndarray:
    """Standard deviations (outputs,) of the noise of these outputs."""
    of_joints = {f"q.{joint.name}": JOINT_NOISE[joint.kind] for joint in model.robot.moving_joints}
    return np.array([of_joints.get(name, TIP_NOISE) for name in outputs])


def scale_mass(model: mujoco.MjModel, joint: str, factor: float) -> None:
    """Scale mass and inertia of the body that a joint moves; the caller calls `mj_setConst`."""
    body = int(model.joint(joint).bodyid[0])
    model.body_mass[body] *= factor
    model.body_inertia[body] *= factor


def plant_steps(model: SoftModel, sample: float, longest: float) -> int:
    """Number of steps per sample time (s): at most `longest` (s), and stable for Runge-Kutta."""
    return int(np.ceil(sample / min(longest, STABLE / _fastest(model))))


def _fastest(model: SoftModel) -> float:
    """Largest eigenvalue (1/s) of the motion around q = 0."""
    n = model.nv
    at = model.configuration(np.zeros(n)), np.zeros(n), np.zeros(n), np.zeros(model.nu)
    terms = ForceBalance(model, motors=())(*at)
    by_state = np.linalg.solve(terms.by_a, np.c_[terms.by_q, terms.by_v])
    first = np.block([[np.zeros((n, n)), np.eye(n)], [-by_state]])
    return float(np.abs(np.linalg.eigvals(first)).max())


def _come_to_rest(twin: Twin, u: np.ndarray) -> None:
    """Hold the input until nothing moves."""
    tenth = round(0.1 / twin.model.opt.timestep)
    for _ in range(LONGEST_REST):
        twin.advance(u, tenth)
        if np.abs(twin.qvel).max() < STILL:
            return
    raise InputError("robot", "a twin that comes to rest under its first input", "one that moves")


@dataclass(frozen=True, eq=False)
class Trial:
    """One identification of known parameters; NaN for parameters that are not identified.

    Attributes
    ----------
    seed : int
    found : Identified
    relative : ndarray, (P,)
        Errors relative to the true values.
    scores : ndarray, (P,)
        Errors relative to the stated deviations.
    width : ndarray, (P,)
        Stated deviations relative to the Cramér-Rao bound; NaN without noise.
    """

    seed: int
    found: Identified
    relative: np.ndarray
    scores: np.ndarray
    width: np.ndarray


def trial(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    outputs: Sequence[str],
    excitation: Excitation,
    noise: float,
    seed: int,
    step: float = np.inf,
) -> Trial:
    """Draw, record, identify, compare."""
    data, theta = twin_data(model, unknowns, outputs, excitation, noise, seed)
    return judged(model, unknowns, data, theta, noise, seed, step)


def judged(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    data: Measurements,
    theta: np.ndarray,
    noise: float,
    seed: int,
    step: float = np.inf,
) -> Trial:
    """Identify the data of `twin_data`, and compare with the drawn θ (P,)."""
    acquisition = Acquisition()
    if any(name.startswith("point.") for name in data.names):
        data, acquisition = prepared(model, data, relabel=True)
    found = identify(model, data, unknowns, step=step, acquisition=acquisition)
    known = np.array([one.identified for one in found.estimates])
    value = np.array([one.value for one in found.estimates])
    deviation = np.array([one.deviation for one in found.estimates])
    size = np.where([one.nominal for one in unknowns], theta, ABOUT_ZERO)
    relative = np.where(known, (value - theta) / size, np.nan)
    scores = np.where(known, (value - theta) / deviation, np.nan)
    width = np.full(len(theta), np.nan)
    if noise > 0:
        identified = [one for one, yes in zip(unknowns, known, strict=True) if yes]
        size = noise * deviations(model, data.names)
        width[known] = least_deviations(model, data, identified, theta[known], size, step=step)
        width = deviation / width
    return Trial(seed, found, relative, scores, width)


def each_trial(*what: Any, seeds: int, step: float = np.inf, jobs: int = -1) -> list[Trial]:
    """Run `trial` for each seed from 0 on.

    Parameters
    ----------
    what
        Its first arguments, up to and including the noise.
    seeds : int
        Number of trials.
    step : float
        As for `trial`.
    jobs : int
        Processes, -1 for one per core.
    """
    calls = [(*what, seed, step) for seed in range(seeds)]
    return in_order(trial, calls, 1 if seeds == 1 else jobs)


SHOWN = (
    ("kind", "kind", ""),
    ("identified", "told", ""),
    ("median error (%)", "median_percent", ".2g"),
    ("worst (%)", "worst_percent", ".2g"),
    ("truth in 95 %", "inside", ".0%"),
    ("widest", "widest", ".2f"),
)


def summary(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """By kind: identified, errors, and the share of 95 % intervals that contain the true value.

    `widest` is the widest interval relative to the Cramér-Rao bound; None without noise.
    """
    estimates, rows = trials[0].found.estimates, []
    for kind in dict.fromkeys(one.parameter.kind.name for one in estimates):
        of_kind = [k for k, one in enumerate(estimates) if one.parameter.kind.name == kind]
        errors, scores, width = (
            np.abs(np.concatenate([getattr(one, name)[of_kind] for one in trials]))
            for name in ("relative", "scores", "width")
        )
        known = np.isfinite(errors)
        figures: dict[str, float | None] = dict.fromkeys(key for _, key, form in SHOWN if form)
        if known.any():
            figures |= {
                "median_percent": float(100 * np.median(errors[known])),
                "worst_percent": float(100 * np.nanmax(errors)),
            }
        if np.isfinite(width).any():
            figures |= {
                "inside": float((scores[known] <= 1.96).mean()),
                "widest": float(np.nanmax(width)),
            }
        rows.append({"kind": kind, "told": f"{known.sum()} of {len(known)}", **figures})
    return rows


def trial_table(trials: Sequence[Trial]) -> Table:
    """The summary as text."""
    return Table.of(SHOWN, summary(trials))
