"""The fit of simulated outputs to measured ones, its intervals, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.identification.data import AXES, SHORTEST, Measurements, at_stops, stretches
from softdyn.identification.linear import first_guess, smoothed
from softdyn.identification.parameters import (
    Moment,
    Parameter,
    columns_of,
    with_values,
)
from softdyn.identification.result import Estimate, Identified
from softdyn.identification.trajectory import Held, Start, TrajectoryError, follow
from softdyn.identification.whiteness import autocorrelation, ljung_box, widening
from softdyn.statics.equilibria import settle

FEWEST = 5  # samples that a smoothing spline can go through
CUTS = 4  # times that data without joints are cut at a stop of the motion fitted to them
VAGUE = 0.5  # a relative standard deviation above which a parameter is not identified


@dataclass(frozen=True, eq=False)
class _Problem:
    """All that the residual of the fit depends on but the unknowns."""

    base: SoftModel
    unknowns: tuple[Parameter, ...]
    data: Measurements
    step: float
    runs: tuple[tuple[int, int], ...]  # stretches of samples that are simulated
    held: Held | None  # None where not all joints were measured: then the one run begins at rest
    stops: np.ndarray | None  # (N, n) of `at_stops`
    smooth: np.ndarray | None  # (3, N, n) angles, rates, accelerations

    def outputs(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulated outputs (N, outputs) and their derivatives (N, outputs, len(z))."""
        count = len(self.unknowns)
        model = with_values(self.base, self.unknowns, z[:count])
        shape = self.data.outputs.shape
        out, slope = np.zeros(shape), np.zeros((*shape, len(z)))
        firsts = np.split(z[count:], len(self.runs))
        for k, ((begin, end), first) in enumerate(zip(self.runs, firsts, strict=True)):
            part = slice(begin, end)
            t, u, held = self.data.t[part], self.data.u[part], self.held
            if held is None:
                start = self.at_rest(model)
            else:
                held = Held(held.mask, held.q[part], held.v[part])
                start = self._moving(held, first)
            path, by = follow(model, self.unknowns, t, u, start, held, self.step, self.base)
            out[part], by_z = measured(model, self.data.names, path, by)
            slope[part, :, :count] = by_z[:, :, :count]
            own = count + k * len(first)
            slope[part, :, own : own + len(first)] = by_z[:, :, count:]
        return out, slope

    def firsts(self) -> np.ndarray:
        """The measured first states of the runs: q and v of the joints that are free."""
        if self.held is None:
            return np.zeros(0)
        free = ~self.held.mask
        firsts = [(self.held.q[begin, free], self.held.v[begin, free]) for begin, _ in self.runs]
        return np.ravel(firsts)

    def _moving(self, held: Held, first: np.ndarray) -> Start:
        """From the unknown state of the free joints; the held ones' is measured."""
        free = np.flatnonzero(~held.mask)
        q, v = held.q[0].copy(), held.v[0].copy()
        q[free], v[free] = np.split(first, 2)
        by_q, by_v = np.zeros((2, len(q), len(self.unknowns) + len(first)))
        by_q[free, -2 * len(free) : -len(free)] = by_v[free, -len(free) :] = np.eye(len(free))
        return Start(q, v, by_q, by_v)

    def at_rest(self, model: SoftModel) -> Start:
        """In equilibrium under the first input."""
        n, count = model.nv, len(self.unknowns)
        by_q, by_v = np.zeros((2, n, count))
        u = self.data.u[0]
        rest = settle(model, u)
        state = model.state(rest.q, np.zeros(n))
        moment = Moment(state, np.zeros(n), u, self.base)
        columns = columns_of(self.unknowns, moment, count)
        free = (model.coordinates(rest.q) > model.lower) & (model.coordinates(rest.q) < model.upper)
        block = np.ix_(free, free)
        by_q[free] = -np.linalg.solve(stiffness(model, rest.q, u)[block], columns[free])
        return Start(model.coordinates(rest.q), np.zeros(n), by_q, by_v)


def measured(
    model: SoftModel, names: Sequence[str], path: np.ndarray, by: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The outputs (N, outputs) of a path (N, n), and their derivatives from the path's."""
    out, slope = np.empty((len(path), len(names))), np.empty((len(path), len(names), by.shape[2]))
    joints = {f"q.{name}": k for k, name in enumerate(model.joint_names)}
    of_joints = [(k, joints[name]) for k, name in enumerate(names) if name in joints]
    of_tip = [(k, AXES.index(name[-1])) for k, name in enumerate(names) if name.startswith("tip.")]
    lengths = {f"length.{name}": k for k, name in enumerate(model.tendons.names)}
    of_cables = [(k, lengths[name]) for k, name in enumerate(names) if name in lengths]
    for k, j in of_joints:
        out[:, k], slope[:, k] = path[:, j], by[:, j]
    if of_tip or of_cables:
        still = np.zeros(model.nv)
        for i, point in enumerate(path):
            state = model.state(model.configuration(point), still)
            for k, axis in of_tip:
                out[i, k], slope[i, k] = state.y[axis], state.J[axis] @ by[i]
            for k, t in of_cables:
                out[i, k], slope[i, k] = state.lengths[t], state.moment_arms[t] @ by[i]
    return out, slope


def identify(
    model: SoftModel,
    data: Measurements,
    unknowns: Sequence[Parameter],
    *,
    hold_out: float = 0.2,
    step: float = np.inf,
) -> Identified:
    """Parameters of the model from measurements, by the output-error method.

    A first guess by least squares on smoothed angles where all joints were measured; then the
    simulated outputs are fitted to the measured ones (Gauss–Newton with bounds and analytic
    derivatives, SciPy's trust-region reflective method), each output weighted by its noise. Where
    all joints were measured the robot is simulated in the stretches without a stop, the first state
    of each unknown too; a joint that is nearly always at a stop follows its measurement. Else the
    robot starts at rest under its first input, and its simulated motion says where a joint comes
    to its stop: that ends the data. The covariance is
    σ² (JᵀJ)⁻¹ of the whitened outputs, times 1 + 2 Σ ρ² … of coloured residuals (Newey–West).

    Parameters
    ----------
    model : SoftModel
        The file's values are the first guess.
    data : Measurements
    unknowns : sequence of Parameter
        Of `parameters`.
    hold_out : float
        The last part of the data, which only tests the result.
    step : float
        Longest step (s) of the simulation; the samples' own by default.

    Raises
    ------
    InputError
        No unknowns, a floating base or mimic joints, or data of another robot.
    TrajectoryError
        No simulation near the first guess.
    """
    unknowns = tuple(unknowns)
    if not unknowns:
        raise InputError("unknowns", "at least one", "none")
    if model.robot.floating or model.robot.followers:
        raise InputError("robot", "a fixed base and no mimic joints", model.name)
    if not 0 <= hold_out < 0.9:
        raise InputError("hold_out", "a part from 0 to 0.9", hold_out)
    if len(data.t) < FEWEST:
        raise InputError("data", f"at least {FEWEST} samples", len(data.t))
    split = max(FEWEST, round(len(data.t) * (1 - hold_out)))
    problem = _problem(model, data.part(0, split), unknowns, step)
    whole = problem
    theta, noise, problem, vague = _fitted(whole, _guess(whole))
    for _ in range(CUTS if whole.held is None else 0):
        end = _first_stop(replace(problem, runs=whole.runs), theta)
        if end == problem.runs[0][1]:
            break
        if end < SHORTEST:
            raise InputError("data", f"{SHORTEST} samples before a joint is at its stop", f"{end}")
        theta, noise, problem, vague = _fitted(replace(whole, runs=((0, end),)), _guess(whole))
    count = len(problem.unknowns)
    out, slope = problem.outputs(theta)
    use = _used(problem)
    residuals = np.where(use, problem.data.outputs - out, np.nan)
    correlation = autocorrelation(residuals)
    widened = widening(correlation, use.sum(0))
    whitened = (slope / noise[:, None] / np.sqrt(widened)[:, None])[use]
    covariance = np.linalg.pinv(whitened.T @ whitened)
    deviations = np.sqrt(np.diag(covariance)[:count])
    changed = with_values(model, problem.unknowns, theta[:count])
    kept = {id(one): k for k, one in enumerate(problem.unknowns)}
    estimates = tuple(
        Estimate(one, float(theta[kept[id(one)]]), float(deviations[kept[id(one)]]), True)
        if id(one) in kept
        else Estimate(one, one.nominal, np.inf, False)
        for one in unknowns
    )
    statistic, degrees = ljung_box(correlation, use.sum(0))
    return Identified(
        changed, estimates, data.names, residuals, noise, correlation,
        float(chi2.sf(statistic, degrees)),
        _held_out(problem, theta[:count], data, split, noise), vague,
    )  # fmt: skip


def _problem(
    model: SoftModel, data: Measurements, unknowns: tuple[Parameter, ...], step: float
) -> _Problem:
    """What is to be fitted."""
    joints = data.joints(model)
    if joints is None:
        return _Problem(model, unknowns, data, step, ((0, len(data.t)),), None, None, None)
    smooth = smoothed(data, joints)
    stops = at_stops(model, smooth[0])
    mask, runs = stretches(stops)
    if not runs:
        raise InputError("data", f"{SHORTEST} samples in a row away from the stops", "none")
    held = Held(mask, smooth[0], smooth[1])
    return _Problem(model, unknowns, data, step, tuple(runs), held, stops, smooth)


def _guess(problem: _Problem) -> np.ndarray:
    """Unknowns to start from: the file's, or the linear fit's and the measured first states."""
    if problem.smooth is None or problem.stops is None:
        return np.array([parameter.nominal for parameter in problem.unknowns])
    theta = first_guess(problem.base, problem.unknowns, problem.data, problem.smooth, problem.stops)
    return np.concatenate((theta, problem.firsts()))


def _used(problem: _Problem) -> np.ndarray:
    """Which outputs (N, outputs) count: those simulated, but not of joints that are held."""
    use = np.zeros(problem.data.outputs.shape, bool)
    for begin, end in problem.runs:
        use[begin:end] = True
    if problem.held is not None:
        for j in np.flatnonzero(problem.held.mask):
            use[:, problem.data.names.index(f"q.{problem.base.joint_names[j]}")] = False
    return use


def _fitted(
    problem: _Problem, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, _Problem, tuple[str, ...]]:
    """Unknowns, noise, the problem without what cannot be identified, and those directions."""
    spread = np.ptp(problem.data.outputs, axis=0)
    noise = 1e-3 * np.maximum(spread, 1e-3 * spread.max())
    vague: list[str] = []
    for _ in range(12):
        z = _solve(problem, z, noise)
        out, slope = problem.outputs(z)
        use = _used(problem)
        left = np.where(use, problem.data.outputs - out, 0.0)
        before = noise
        noise = np.sqrt((left**2).sum(0) / np.maximum(use.sum(0) - len(z) / left.shape[1], 1))
        noise = np.maximum(noise, 1e-12 * np.maximum(spread, spread.max() * 1e-3))
        found = _vague(problem, z, (slope / noise[:, None])[use])
        if found is not None:
            drop, text = found
            vague.append(text)
            unknowns = tuple(p for k, p in enumerate(problem.unknowns) if k not in drop)
            z = np.delete(z, sorted(drop))
            if not unknowns:
                raise InputError("data", "something that tells these parameters", "; ".join(vague))
            problem = replace(problem, unknowns=unknowns)
        elif (np.abs(noise / before - 1) < 0.1).all():
            break
    return z, noise, problem, tuple(vague)


def _solve(problem: _Problem, z: np.ndarray, noise: np.ndarray) -> np.ndarray:
    use = _used(problem)
    kept: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def outputs(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = at.tobytes()
        if key not in kept:
            kept.clear()
            kept[key] = problem.outputs(at)
        return kept[key]

    def residual(at: np.ndarray) -> np.ndarray:
        try:
            out, _ = outputs(at)
        except TrajectoryError:
            return np.full(int(use.sum()), 1e8)  # no way there: a shorter step
        return ((out - problem.data.outputs) / noise)[use]

    def jacobian(at: np.ndarray) -> np.ndarray:
        return (outputs(at)[1] / noise[:, None])[use]

    lower = np.full(len(z), -np.inf)
    count = len(problem.unknowns)
    lower[:count] = [p.kind.lower for p in problem.unknowns]
    z = np.maximum(z, lower + 1e-12)
    outputs(z)  # an error at the first guess is the user's to know
    return least_squares(
        residual, z, jacobian, (lower, np.full(len(z), np.inf)), x_scale="jac",
        ftol=1e-7, xtol=1e-9, gtol=1e-10, max_nfev=30,
    ).x  # fmt: skip


def _vague(problem: _Problem, z: np.ndarray, whitened: np.ndarray) -> tuple[set[int], str] | None:
    """The parameters of the worst direction that these outputs do not tell, and it as text."""
    count = len(problem.unknowns)
    pairs = zip(problem.unknowns, z[:count], strict=True)
    size = np.array([abs(p.nominal) or abs(x) or 1.0 for p, x in pairs])
    scaled = whitened[:, :count] * size
    if whitened.shape[1] > count:  # what the unknown first state explains is no information
        basis, _ = np.linalg.qr(whitened[:, count:])
        scaled = scaled - basis @ (basis.T @ scaled)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    if 1 / max(singular[-1], 1e-300) <= VAGUE:
        return None
    direction = directions[-1]
    share = np.abs(direction) / np.abs(direction).max()
    # the single parameter that is worst, so that a common scale loses one member, not all
    worst = int(np.argmax(share))
    terms = [problem.unknowns[k].label for k in np.argsort(-share) if share[k] > 0.3]
    text = " together with ".join(terms[:6]) + (" and others" if len(terms) > 6 else "")
    return {worst}, f"{text} (relative deviation {1 / max(singular[-1], 1e-300):.2g})"


def _first_stop(problem: _Problem, z: np.ndarray) -> int:
    """The sample at which the run that began at rest comes to a stop, or the run's end."""
    model = with_values(problem.base, problem.unknowns, z)
    end = problem.runs[0][1]
    t, u, start = problem.data.t[:end], problem.data.u[:end], problem.at_rest(model)
    path, _ = follow(model, problem.unknowns, t, u, start, None, problem.step, problem.base)
    near = np.flatnonzero(at_stops(model, path).any(1))
    return int(near[0]) if near.size else end


def _held_out(
    problem: _Problem, theta: np.ndarray, data: Measurements, split: int, noise: np.ndarray
) -> float:
    """Rms over the noise in the rest of the data, whose first states alone are fitted to it."""
    if split > len(data.t) - FEWEST:
        return float("nan")
    if problem.held is None:
        whole = replace(problem, data=data, runs=((0, len(data.t)),))
        end = _first_stop(whole, theta)
        left = (whole.outputs(theta)[0] - data.outputs)[split:end]
        return float(np.sqrt(np.mean((left / noise) ** 2))) if end > split else float("nan")
    changed = with_values(problem.base, problem.unknowns, theta)
    try:
        rest = _problem(changed, data.part(split, len(data.t)), (), problem.step)
    except InputError:  # nothing moves there, or all is at the stops
        return float("nan")
    z = _solve(rest, rest.firsts(), noise)
    left = ((rest.outputs(z)[0] - rest.data.outputs) / noise)[_used(rest)]
    return float(np.sqrt(np.mean(left**2)))
