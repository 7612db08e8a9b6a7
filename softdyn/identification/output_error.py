"""Fit simulated outputs to measured ones: values, intervals, parameters not identifiable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2
from tqdm.auto import tqdm

from softdyn.checks import array, instance, instances, number
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError, NotIdentifiable
from softdyn.identification.blocks import reduced
from softdyn.identification.data import Measurements, check_data
from softdyn.identification.dynamic_fit import DynamicFit
from softdyn.identification.intervals import (
    deviations,
    fit_length,
    ljung_box,
    unidentifiable,
    widening,
)
from softdyn.identification.parameters import Parameter, apply_values, distinct
from softdyn.identification.problem import PLAIN, Acquisition, Fit, FitProblem, idle
from softdyn.identification.result import Estimate, Identified, distance, rms
from softdyn.identification.static_fit import StaticFit

CUTS = 4  # largest number of times that data without joint angles are cut at a simulated stop
ROUNDS = 12  # largest number of rounds that estimate noise and unknowns in turn


def identify(
    model: SoftModel,
    data: Measurements,
    unknowns: Sequence[Parameter],
    *,
    hold_out: float = 0.2,
    step: float = np.inf,
    acquisition: Acquisition = PLAIN,
    progress: bool = False,
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
    acquisition : Acquisition
        Whether the data are static, and how markers were seen.
    progress : bool
        Show a bar in a terminal, with the numbers of unknowns, rows and simulations so far.

    Raises
    ------
    InputError
        For no unknowns, a member in two of them, a floating base or mimic joints, data of another
        robot, inputs beyond the file's bounds, a step that is not positive, and data that show none
        of the unknowns.
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
    kind = _kind(acquisition)
    data = kind.cleaned(model, data)
    keep, left_out = kind.parts(data, hold_out)
    whole = kind.of(model, data.rows(keep), unknowns, _positive(step), acquisition)
    whole = whole.within(data, keep)
    text = f"{len(unknowns)} unknowns, {len(keep)} rows"
    off = None if progress else True  # None: in a terminal only
    with tqdm(desc=text, disable=off, leave=False, unit=" simulations") as bar:
        whole = replace(whole, tick=bar.update)
        found = fit(whole)
        for _ in range(CUTS):
            if (shorter := whole.shorter(found)) is None:
                break
            found = fit(shorter)
    found = replace(found, problem=replace(found.problem, tick=idle))
    problem, theta, noise = found.problem, found.theta, found.noise
    residuals = problem.residuals(found.simulated)
    samples = np.isfinite(residuals).sum(0)
    correlation = problem.correlation(residuals)
    blocks = problem.blocks(found.simulated, noise * np.sqrt(widening(correlation, samples)))
    half = problem.half_widths(blocks, residuals)
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
        missed = problem.held_out(found, data, left_out)
    return Identified(
        apply_values(model, problem.unknowns, theta), estimates, problem.data, residuals,
        np.where(samples > 0, noise, np.nan), correlation,
        float(chi2.sf(statistic, degrees)),
        rms(missed / noise), distance(data.names, missed), found.unidentifiable,
        problem.moved(found), found,
    )  # fmt: skip


def tested(found: Identified, test: Measurements) -> Identified:
    """The result with the residuals of other static data as those held out."""
    instance("test", test, Measurements, "Measurements")
    check_data(instance("found", found, Identified, "an Identified").model, test)
    problem = found.fit.problem
    if not isinstance(problem, StaticFit):
        raise InputError("test", "a fit of static rows", "data over time")
    missed = problem.held_out(found.fit, test, np.arange(len(test.t)))
    return replace(
        found,
        held_out=rms(missed / found.fit.noise),
        rms_held_out=distance(test.names, missed),
    )


def make_problem(
    model: SoftModel,
    data: Measurements,
    unknowns: tuple[Parameter, ...],
    step: float = np.inf,
    acquisition: Acquisition = PLAIN,
) -> StaticFit | DynamicFit:
    """The problem of these unknowns: of all static rows, or of stretches that no stop disturbs."""
    check_data(check_model(model), instance("data", data, Measurements, "Measurements"))
    unknowns = instances("unknowns", unknowns, Parameter, "a Parameter")
    return _kind(acquisition).of(model, data, unknowns, _positive(step), acquisition)


def _kind(acquisition: Acquisition) -> type[StaticFit] | type[DynamicFit]:
    static = instance("acquisition", acquisition, Acquisition, "an Acquisition").static
    return StaticFit if static else DynamicFit


def _positive(step: float) -> float:
    return number("step", step, above=0.0, finite=False)


def fit(problem: FitProblem) -> Fit:
    """The output-error fit of a problem; it estimates unknowns and noise in turn.

    Raises
    ------
    InputError
        If no unknown is identifiable.
    TrajectoryError
        If the first guess cannot be simulated.
    """
    theta, firsts, noise = instance("problem", problem, FitProblem, "a FitProblem").starting_point()
    asked, texts = len(problem.unknowns), list[str]()
    for _ in range(ROUNDS + len(theta)):
        theta, firsts, simulated = problem.solved(theta, firsts, noise)
        before, noise = noise, problem.noise(theta, simulated, noise)
        R = reduced(problem.blocks(simulated, noise)).R
        drop, new = unidentifiable(problem.unknowns, R, theta)
        texts += new
        if drop:
            unknowns = tuple(p for k, p in enumerate(problem.unknowns) if k not in drop)
            theta = np.delete(theta, sorted(drop))
            if not unknowns:
                some = "; ".join(texts[:3]) + ("; …" if len(texts) > 3 else "")
                raise NotIdentifiable(
                    "data", "motion that shows some of the unknowns; try fewer of them, such as"
                    " --shared stiffness",
                    f"none of {asked} ({some})",
                )  # fmt: skip
            problem = replace(problem, unknowns=unknowns)
        elif (np.abs(noise / before - 1) < 0.1).all():
            break
    return Fit(problem, theta, noise, simulated, tuple(texts))


def least_deviations(
    model: SoftModel,
    data: Measurements,
    unknowns: Sequence[Parameter],
    theta: np.ndarray,
    noise: np.ndarray,
    *,
    hold_out: float = 0.2,
    step: float = np.inf,
) -> np.ndarray:
    """Cramér and Rao's bound (P,): least standard deviations of an unbiased fit of the stretches.

    It is infinite for parameters that `identify` would report as not identifiable with this noise.

    Parameters
    ----------
    model, data, unknowns, hold_out, step
        As for `identify`.
    theta : ndarray, (P,)
        The true values.
    noise : ndarray, (outputs,)
        The true standard deviation of each output; the noise is white.
    """
    unknowns = instances("unknowns", unknowns, Parameter, "a Parameter")
    split = fit_length(data, hold_out)
    theta = array("theta", theta, (len(unknowns),))
    noise = array("noise", noise, (len(data.names),))
    problem = DynamicFit.of(model, data.part(0, split), unknowns, _positive(step))
    if problem.smooth is None:
        problem = replace(problem, runs=((0, problem.first_stop(theta)),))
    R = reduced(problem.blocks(problem.simulated(theta, problem.firsts()), noise)).R
    identifiable, drop = list(range(len(unknowns))), {-1}
    while identifiable and drop:
        some = [unknowns[k] for k in identifiable]
        drop, _ = unidentifiable(some, R[:, identifiable], theta[identifiable])
        identifiable = [k for at, k in enumerate(identifiable) if at not in drop]
    found = np.full(len(unknowns), np.inf)
    found[identifiable] = deviations(R[:, identifiable])
    return found
