"""Fit simulated outputs to measured ones: values, intervals, parameters not identifiable."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2, norm

from softdyn.checks import instance, instances
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError
from softdyn.identification.blocks import DONE, ResidualBlock, least_squares, reduced
from softdyn.identification.data import SHORTEST, Measurements, check_data, spread
from softdyn.identification.intervals import (
    FEWEST,
    SHARE,
    autocorrelation,
    deviations,
    fit_length,
    half_widths,
    ljung_box,
    unidentifiable,
    widening,
)
from softdyn.identification.linear import first_guess
from softdyn.identification.parameters import Parameter, distinct, with_values
from softdyn.identification.problem import (
    PLAIN,
    Acquisition,
    Fit,
    FitProblem,
    Simulated,
    first_stop,
    problem_of,
)  # fmt: skip
from softdyn.identification.result import Estimate, Identified, distance, rms
from softdyn.identification.trajectory import TrajectoryError
from softdyn.identification.unknowns.sensor_errors import without_repeats
from softdyn.statics.equilibrium import StaticsError

CUTS = 4  # largest number of times that data without joint angles are cut at a simulated stop
ROUNDS = 12  # largest number of rounds that estimate noise and unknowns in turn
PIECE = 100  # samples of the first pieces that are fitted
LATE = 4  # least length of a piece over the largest latency; before that a piece has no readings
ROUGH = 1e-3  # pieces are joined if a step would reduce the cost by a smaller share


def identify(
    model: SoftModel,
    data: Measurements,
    unknowns: Sequence[Parameter],
    *,
    hold_out: float = 0.2,
    step: float = np.inf,
    taken: Acquisition = PLAIN,
) -> Identified:
    """Parameters of the model from measurements, by the output-error method.

    If all joints were measured, least squares on smoothed angles gives a first guess. The simulated
    outputs are then fitted to the measured ones in the stretches without a stop, in short pieces
    first. The first state of each piece is unknown too. A joint that is nearly always at a stop
    follows its measured motion. Else the robot starts at rest under its first input, and longer and
    longer parts are fitted. The data end where the simulated motion brings a joint to a stop.
    The fit is Levenberg and Marquardt's with bounds and analytic derivatives; each output is
    weighted by its noise. The covariance is σ² (JᵀJ)⁻¹ of the whitened outputs. Coloured residuals
    widen it (Newey–West, `intervals.widening`).

    If the data are static, each row is an equilibrium. All outputs of one kind then have one common
    noise, and the intervals allow errors that the outputs of a row share (`half_widths`).

    Parameters
    ----------
    model : SoftModel
        The model with the first guess, the file's values.
    data : Measurements
    unknowns : sequence of Parameter
        Unknowns from `parameters`.
    hold_out : float
        Share of the data, at the end, that only tests the result; of static data every few rows.
    step : float
        Longest step (s) of the simulation; the samples' own by default.
    taken : Acquisition
        Whether the data are static, and how markers were seen.

    Raises
    ------
    InputError
        For no unknowns, a member in two of them, a floating base or mimic joints, data of another
        robot, inputs beyond the file's bounds, and a step that is not positive.
    TrajectoryError
        No simulation near the first guess.
    """
    unknowns = instances("unknowns", unknowns, Parameter, "a Parameter")
    if not unknowns:
        raise InputError("unknowns", "at least one", "none")
    if check_model(model).robot.floating or model.robot.followers:
        raise InputError("robot", "a fixed base and no mimic joints", model.name)
    distinct(unknowns)
    check_data(model, instance("data", data, Measurements, "Measurements"))
    instance("taken", taken, Acquisition, "an Acquisition")
    if not taken.static:
        fresh = without_repeats(model.robot, data.names, data.t, data.outputs)
        data = replace(data, outputs=fresh)
    keep, left_out = parts_of(data, hold_out, taken.static)
    if len(data.t) < FEWEST and not taken.static:
        raise InputError("data", f"at least {FEWEST} samples", len(data.t))
    whole = problem_of(model, data.rows(keep), unknowns, step, taken)
    found = fit(whole)
    for _ in range(CUTS if whole.smooth is None and not taken.static else 0):
        end = first_stop(replace(found.problem, runs=whole.runs), found.theta)
        if end == found.problem.runs[0][1]:
            break
        if end < SHORTEST:
            raise InputError("data", f"{SHORTEST} samples before a joint is at its stop", f"{end}")
        found = fit(replace(whole, runs=((0, end),)))
    problem, theta, noise = found.problem, found.theta, found.noise
    residuals = problem.residuals(found.simulated)
    samples = np.isfinite(residuals).sum(0)
    correlation = np.zeros((0, len(noise))) if taken.static else autocorrelation(residuals)
    blocks = problem.blocks(found.simulated, noise * np.sqrt(widening(correlation, samples)))
    if taken.static:
        half = half_widths(blocks[0], np.nonzero(np.isfinite(residuals))[0])
    else:
        half = norm.ppf(SHARE) * deviations(reduced(blocks).R)
    kept = {id(one): k for k, one in enumerate(problem.unknowns)}
    estimates = tuple(
        Estimate(one, float(theta[kept[id(one)]]), float(half[kept[id(one)]]), True)
        if id(one) in kept
        else Estimate(one, one.nominal, np.inf, False)
        for one in unknowns
    )
    statistic, degrees = ljung_box(correlation, samples)
    missed = np.zeros((0, len(noise)))
    if left_out.size:
        test = data.rows(left_out) if taken.static else data
        missed = _held_out(problem, theta, test, len(keep), noise)
    return Identified(
        with_values(model, problem.unknowns, theta), estimates, problem.data, residuals,
        np.where(samples > 0, noise, np.nan), correlation,
        float(chi2.sf(statistic, degrees)),
        rms(missed / noise), distance(data.names, missed), found.unidentifiable,
        np.nan if taken.static else _moved(found), found,
    )  # fmt: skip


def tested(found: Identified, test: Measurements) -> Identified:
    """The result with the residuals of other static data as those held out."""
    instance("test", test, Measurements, "Measurements")
    check_data(instance("found", found, Identified, "an Identified").model, test)
    problem = found.fit.problem
    if not problem.taken.static:
        raise InputError("test", "a fit of static rows", "data over time")
    missed = _held_out(problem, found.fit.theta, test, len(problem.data.t), found.fit.noise)
    return replace(
        found,
        held_out=rms(missed / found.fit.noise),
        rms_held_out=distance(test.names, missed),
    )


def parts_of(data: Measurements, hold_out: float, static: bool) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the samples to fit and of those held out: the last ones, or spread rows."""
    split, every = fit_length(data, hold_out), np.arange(len(data.t))
    if not static:
        return every[:split], every[split:]
    count = round(len(every) * hold_out)
    held = ((np.arange(count) + 0.5) * len(every) / max(count, 1)).astype(int)
    return np.setdiff1d(every, held), held


def fit(problem: FitProblem) -> Fit:
    """The output-error fit of a problem; it estimates unknowns and noise in turn.

    Raises
    ------
    InputError
        If no unknown is identifiable.
    TrajectoryError
        If the first guess cannot be simulated.
    """
    theta, firsts, noise = _starting_point(instance("problem", problem, FitProblem, "a FitProblem"))
    texts: list[str] = []
    for _ in range(ROUNDS + len(theta)):
        theta, firsts, simulated = _solve(problem, theta, firsts, noise)
        before, noise = noise, _noise(problem, theta, simulated, noise)
        drop, new = unidentifiable(problem.unknowns, reduced(problem.blocks(simulated, noise)).R)
        texts += new
        if drop:
            unknowns = tuple(p for k, p in enumerate(problem.unknowns) if k not in drop)
            theta = np.delete(theta, sorted(drop))
            if not unknowns:
                raise InputError("data", "motion that identifies a parameter", "; ".join(texts))
            problem = replace(problem, unknowns=unknowns)
        elif (np.abs(noise / before - 1) < 0.1).all():
            break
    return Fit(problem, theta, noise, simulated, tuple(texts))


def _starting_point(problem: FitProblem) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Parameters, first states and noise (outputs,) from which the fit starts."""
    if problem.taken.static:
        theta = np.array([parameter.nominal for parameter in problem.unknowns])
        return theta, problem.firsts(), _pooled(problem, _first_noise(problem))
    if problem.smooth is None:
        return _fit_growing_part(problem), problem.firsts(), _first_noise(problem)
    guess = first_guess(problem.base, problem.unknowns, problem.data, problem.smooth, problem.stops)
    return _joined(problem, guess)


def _joined(
    problem: FitProblem, theta: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Parameters, first states and noise from short pieces of the runs, joined four by four.

    Some motions are sensitive: after seconds the first guess's motion is far from the measured one,
    and a fit would end in a wrong minimum. A short piece has its own first state and stays near the
    measured motion. Its fit gives a better guess for a longer piece (multiple shooting: Bock,
    Recent advances in parameter identification techniques for O.D.E., 1983).
    """
    noise, known = _first_noise(problem), dict[int, np.ndarray]()
    late = max((sensor.latency for sensor in problem.base.robot.sensors), default=0.0)
    length = max(PIECE, int(LATE * late / np.median(np.diff(problem.data.t))))
    while True:
        parts = replace(problem, runs=_pieces(problem.runs, length))
        firsts = [
            known.get(begin, first)
            for (begin, _), first in zip(parts.runs, parts.firsts(), strict=True)
        ]
        if parts.runs == problem.runs:
            return theta, firsts, noise
        theta, firsts, simulated = _solve(parts, theta, firsts, noise, ROUGH)
        noise = _noise(parts, theta, simulated, noise)
        known = {begin: first for (begin, _), first in zip(parts.runs, firsts, strict=True)}
        length *= 4


def _pieces(runs: Sequence[tuple[int, int]], length: int) -> tuple[tuple[int, int], ...]:
    """The runs, halved until none has more samples than `length`."""
    found: list[tuple[int, int]] = []
    for begin, end in runs:
        count = 1
        while end - begin > count * length:
            count *= 2
        edges = np.linspace(begin, end, count + 1).astype(int).tolist()
        found += itertools.pairwise(edges)
    return tuple(found)


def _fit_growing_part(problem: FitProblem) -> np.ndarray:
    """θ from fits of growing parts of the run, each twice as long, up to half of the run.

    After seconds the motion under the file's values is far from the measured one, and the sum of
    squares has many minima. The first seconds may hold no information, so a part's θ is kept only
    if it also fits the part of twice the length better.
    """
    theta = np.array([parameter.nominal for parameter in problem.unknowns])
    whole = problem.runs[0][1]
    noise = _first_noise(problem)
    for short in (whole >> k for k in range(int(math.log2(whole / SHORTEST)), 0, -1)):
        part, ahead = (replace(problem, runs=((0, end),)) for end in (short, 2 * short))
        there, _, _ = _solve(part, theta, part.firsts(), noise, ROUGH)
        try:
            theta = min((theta, there), key=lambda at: _misfit(ahead, at, noise))
        except TrajectoryError:
            continue
    return theta


def _first_noise(problem: FitProblem) -> np.ndarray:
    """A first value of the noise (outputs,), from the outputs' ranges."""
    wide = spread(problem.data.outputs)
    return 1e-3 * np.maximum(wide, 1e-3 * wide.max())


def _misfit(problem: FitProblem, theta: np.ndarray, noise: np.ndarray) -> float:
    """Sum of squares of a run from rest."""
    out = problem.outputs(theta, problem.firsts())[0]
    return float(np.nansum(((out - problem.data.outputs[: len(out)]) / noise) ** 2))


def _noise(
    problem: FitProblem, theta: np.ndarray, simulated: Sequence[Simulated], before: np.ndarray
) -> np.ndarray:
    """Standard deviations (outputs,) of the residuals; `before` for outputs that do not count."""
    left = problem.residuals(simulated)
    samples = np.isfinite(left).sum(0)
    spent = (len(theta) + sum(len(run.first) for run in simulated)) / left.shape[1]
    power = np.nansum(left**2, axis=0) / np.maximum(samples - spent, 1)
    least = 1e-9 * _first_noise(problem)
    if problem.taken.static:
        spent = len(theta) / left.shape[1]
        return np.maximum(_pooled(problem, np.sqrt(np.nanmean(left**2, axis=0))), least) * float(
            np.sqrt(samples.mean() / max(samples.mean() - spent, 0.5))
        )
    return np.where(samples > 0, np.maximum(np.sqrt(power), least), before)


def _pooled(problem: FitProblem, noise: np.ndarray) -> np.ndarray:
    """One noise for all outputs of a kind, because few rows tell little about each output's."""
    kinds = [(name.partition(".")[0], ".r" in name[-3:]) for name in problem.data.names]
    found = np.empty(len(noise))
    for kind in set(kinds):
        same = np.array([one == kind for one in kinds])
        found[same] = np.sqrt(np.mean(noise[same] ** 2))
    return found


def _solve(
    problem: FitProblem,
    theta: np.ndarray,
    firsts: Sequence[np.ndarray],
    noise: np.ndarray,
    done: float = DONE,
) -> tuple[np.ndarray, list[np.ndarray], list[Simulated]]:
    """Parameters, first states and outputs with the least sum of squares, weighted by the noise."""
    lower = np.array([p.lower for p in problem.unknowns])
    theta = np.maximum(theta, lower)
    best = problem.simulated(theta, firsts)  # an error at the first guess reaches the user
    kept = {_key(theta, firsts): best}

    def blocks(at: np.ndarray, own: Sequence[np.ndarray]) -> list[ResidualBlock] | None:
        key = _key(at, own)
        if key not in kept:
            kept.clear()
            try:
                kept[key] = problem.simulated(at, own)
            except (TrajectoryError, StaticsError, InputError):
                return None  # these values cannot be simulated
        return problem.blocks(kept[key], noise)

    theta, own = least_squares(blocks, theta, firsts, lower, done)
    key = _key(theta, own)
    return theta, own, kept[key] if key in kept else problem.simulated(theta, own)


def _key(theta: np.ndarray, own: Sequence[np.ndarray]) -> bytes:
    return np.concatenate((theta, *own)).tobytes()


def _moved(found: Fit) -> float:
    """Largest change of θ with half of every step, over its deviation, to first order.

    It is NaN if the model cannot be simulated with half the step.
    """
    problem, coarse = found.problem, found.simulated
    try:
        outputs = replace(problem, finer=2).outputs(found.theta, [run.first for run in coarse])
    except TrajectoryError:  # the change is unknown, but the fit is still good
        return float("nan")
    fine = [run._replace(out=out) for run, out in zip(coarse, outputs, strict=True)]
    both = (problem.blocks(runs, found.noise) for runs in (coarse, fine))
    blocks = [a._replace(residual=b.residual - a.residual) for a, b in zip(*both, strict=True)]
    linear = reduced(blocks)
    return float(np.abs(np.linalg.pinv(linear.R) @ linear.d / deviations(linear.R)).max())


def _held_out(
    problem: FitProblem, theta: np.ndarray, data: Measurements, split: int, noise: np.ndarray
) -> np.ndarray:
    """Residuals of the held-out data (N, outputs); only first states are fitted to them."""
    none = np.zeros((0, len(noise)))
    if problem.taken.static:
        there = replace(problem, data=data, runs=((0, len(data.t)),))
        return data.outputs - there.outputs(theta, there.firsts())[0]
    if split > len(data.t) - FEWEST:
        return none
    if problem.smooth is None:
        whole = replace(problem, data=data, runs=((0, len(data.t)),))
        end = first_stop(whole, theta)
        out = whole.outputs(theta, whole.firsts())[0]
        return (data.outputs - out)[split:end]
    changed = with_values(problem.base, problem.unknowns, theta)
    try:
        rest = problem_of(
            changed, data.part(split, len(data.t)), (), problem.step, problem.seen(theta)
        )
        zero, firsts, _ = _joined(rest, np.zeros(0))
        _, _, simulated = _solve(rest, zero, firsts, noise)
    except InputError:  # no joint moves there, all samples are at stops, or readings are older
        return none
    return rest.residuals(simulated)
