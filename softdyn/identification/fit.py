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
from softdyn.identification.data import AXES, Measurements, at_stops
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
VAGUE = 0.5  # a relative standard deviation above which a parameter is not identified


@dataclass(frozen=True, eq=False)
class _Problem:
    """All that the residual of the fit depends on but the unknowns."""

    base: SoftModel
    unknowns: tuple[Parameter, ...]
    data: Measurements
    held: Held | None
    first: np.ndarray | None  # (2n,) of the first state, which is then unknown too; None: at rest
    step: float

    def outputs(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulated outputs (N, outputs) and their derivatives (N, outputs, len(z))."""
        count = len(self.unknowns)
        model = with_values(self.base, self.unknowns, z[:count])
        start = self._start(model, z)
        path, by = follow(model, self.unknowns, self.data, start, self.held, self.step, self.base)
        return measured(model, self.data.names, path, by)

    def _start(self, model: SoftModel, z: np.ndarray) -> Start:
        n, count = model.nv, len(self.unknowns)
        by_q, by_v = np.zeros((2, n, len(z)))
        if self.first is not None:
            by_q[:, count : count + n] = by_v[:, count + n :] = np.eye(n)
            return Start(z[count : count + n], z[count + n :], by_q, by_v)
        u = self.data.u[0]
        rest = settle(model, u)
        state = model.state(rest.q, np.zeros(n))
        moment = Moment(state, np.zeros(n), u, self.base)
        columns = columns_of(self.unknowns, moment, len(z))
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
    all joints were measured the first state is unknown too, and joints at their stops follow the
    measurement; else the robot starts at rest under its first input. The covariance is
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
    problem, accelerations = _problem(model, data.part(0, split), unknowns, step)
    theta, noise, problem, vague = _fitted(problem, _guess(problem, accelerations))
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
) -> tuple[_Problem, np.ndarray | None]:
    """What is to be fitted, and the measured accelerations (N, n) where all joints were."""
    joints = data.joints(model)
    if joints is None:
        return _Problem(model, unknowns, data, None, None, step), None
    held, accelerations = smoothed(data, joints, at_stops(model, joints))
    first = np.concatenate((held.q[0], held.v[0]))
    return _Problem(model, unknowns, data, held, first, step), accelerations


def _guess(problem: _Problem, accelerations: np.ndarray | None) -> np.ndarray:
    """Unknowns to start from: the file's, or the linear fit's and the measured first state."""
    if accelerations is None or problem.held is None or problem.first is None:
        return np.array([parameter.nominal for parameter in problem.unknowns])
    theta = first_guess(problem.base, problem.unknowns, problem.data, problem.held, accelerations)
    return np.concatenate((theta, problem.first))


def _used(problem: _Problem) -> np.ndarray:
    """Which outputs (N, outputs) count: not those of joints at their stops."""
    use = np.ones(problem.data.outputs.shape, bool)
    if problem.held is not None:
        for j, name in enumerate(problem.base.joint_names):
            use[:, problem.data.names.index(f"q.{name}")] = ~problem.held.mask[:, j]
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
    size = np.ones(len(z))
    size[:count] = [abs(p.nominal) or 1.0 for p in problem.unknowns]
    outputs(z)  # an error at the first guess is the user's to know
    return least_squares(
        residual, z, jacobian, (lower, np.full(len(z), np.inf)), x_scale=size,
        ftol=1e-10, xtol=1e-9, gtol=1e-10, max_nfev=30,
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


def _held_out(
    problem: _Problem, theta: np.ndarray, data: Measurements, split: int, noise: np.ndarray
) -> float:
    """Rms over the noise in the rest of the data; from its smoothed first state, or all the way."""
    if split > len(data.t) - FEWEST:
        return float("nan")
    if problem.first is None:
        whole = replace(problem, data=data)
        left = (whole.outputs(theta)[0] - data.outputs)[split:]
        return float(np.sqrt(np.mean((left / noise) ** 2)))
    rest, _ = _problem(problem.base, data.part(split, len(data.t)), problem.unknowns, problem.step)
    assert rest.first is not None
    z = np.concatenate((theta, rest.first))
    left = ((rest.outputs(z)[0] - rest.data.outputs) / noise)[_used(rest)]
    return float(np.sqrt(np.mean(left**2)))
