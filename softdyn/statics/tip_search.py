"""Inputs that hold the tip at a given point, and samples of the points where it can be held.

Unknown are q and u together: r(q, u) = 0 between the joint limits, u within its bounds, y(q) = y*.
Two solvers share the work. `explore` treats all of it as one bounded least-squares problem from an
arbitrary start, so it passes through shapes that are no equilibria and finds buckled and unstable
branches that no ramp leads to. `approach` then moves along the branch of exact equilibria it ended
on, with ∂y/∂u = J (∂r/∂q)⁻¹ B, until the tip is as close as the bounds let it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from softdyn.checks import array
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel
from softdyn.statics.equilibria import (
    Barrier,
    Equilibrium,
    StaticsError,
    balance,
    move,
    rest,
    settle,
)

REACHED = 1e-6  # m: the tip is at the target
SAME = 1e-3  # equilibria whose joints are this close are one (rad, m)
LARGEST_STEP = 0.3  # of a joint in one step along a branch (rad, m)
STAGES = (1.0, 0.1, 0.03, 0.01, 0.0)  # of `explore`: the tip's error against the forces
BARRIERS = (1e-2, 1e-3, 1e-4)  # relative to a joint's force times its range
EXPLORED = 4  # of the given starts
STATIONS = 12  # equilibria along a ray of inputs


@dataclass(frozen=True, eq=False)
class TipSearch:
    """Equilibria that hold the tip at or near a target, the closest first.

    Those within `REACHED` of the target count as equally close; among them the least input ‖u‖
    comes first.

    Attributes
    ----------
    target : (3,) in the world (m).
    found : distinct equilibria, stable or not; at least one.
    """

    target: np.ndarray
    found: tuple[Equilibrium, ...]

    @property
    def nearest(self) -> Equilibrium:
        """The closest equilibrium, whatever its stability."""
        return self.found[0]

    @property
    def nearest_stable(self) -> Equilibrium | None:
        """The closest stable one; None when none was found."""
        return next((one for one in self.found if one.stable), None)

    @property
    def most_stable(self) -> Equilibrium | None:
        """Of the stable ones as close as the closest, the one with the largest smallest eigenvalue.

        None when no stable one was found.
        """
        nearest = self.nearest_stable
        if nearest is None:
            return None
        within = max(self.distance(nearest), REACHED)
        close = [one for one in self.found if one.stable and self.distance(one) <= within]
        return max(close, key=lambda one: one.eigenvalues[0] if one.eigenvalues.size else np.inf)

    def distance(self, equilibrium: Equilibrium) -> float:
        """From its tip to the target (m)."""
        return float(np.linalg.norm(equilibrium.y - self.target))


def inputs_for_tip(
    model: SoftModel,
    target: np.ndarray,
    starts: Iterable[Equilibrium] = (),
    *,
    guesses: Iterable[tuple[np.ndarray, np.ndarray]] = (),
    shapes: int = 16,
    seed: int = 0,
) -> TipSearch:
    """Inputs within their bounds that hold the tip at `target`, or as near as was found.

    A local search from many starts: what it finds exists; what it does not find may exist.

    Parameters
    ----------
    target : (3,) in the world (m).
    starts : equilibria to start from besides rest, e.g. of `scatter`, the nearest first: from
        each the branch is followed, from the first few shapes are explored too.
    guesses : (q, u) to start from besides: equilibria or not.
    shapes : random shapes to start from besides those.
    seed : of the shapes.

    Raises
    ------
    StaticsError
        The robot does not even settle at rest.
    InputError
        A target of the wrong shape or not finite.
    """
    target = array("target", target, (3,))
    known = (rest(model), *starts)
    ends = [approach(one, target) for one in known]
    ends += [approach(one, target, stay_stable=True) for one in known if one.stable]
    for q, u in guesses:
        with suppress(StaticsError):
            ends.append(approach(balance(model, u, q), target))
        with suppress(StaticsError):
            ends.append(explore(model, target, q, u))
    explored = [(one.q, one.u) for one in known[: 1 + EXPLORED]]
    for q, u in (*explored, *random_shapes(model, shapes, seed)):
        with suppress(StaticsError):
            ends.append(explore(model, target, q, u))
    found: list[Equilibrium] = []
    for one in sorted(ends, key=lambda one: _order(one, target)):
        if not any(_same(one, other) for other in found):
            found.append(one)
    return TipSearch(target, tuple(found))


def approach(
    start: Equilibrium,
    target: np.ndarray,
    steps: int = 60,
    barrier: Barrier | None = None,
    *,
    stay_stable: bool = False,
) -> Equilibrium:
    """Follow the branch of `start` until the tip is as close to `target` as its inputs allow.

    Damped Gauss-Newton on ‖y(u) - y*‖ within the input bounds, every iterate an equilibrium,
    stable or not. It ends early where the branch folds (∂r/∂q singular).

    Parameters
    ----------
    start : where to start.
    target : (3,) in the world (m).
    steps : at most so many.
    barrier : the stops `start` was found with, when they are not exact.
    stay_stable : end before the branch loses its stability.
    """
    model, here = start.model, start
    target = array("target", target, (3,))
    scale = _input_scale(model, start)
    low, high = model.u_min / scale, model.u_max / scale
    damping = 1e-3
    error = here.y - target
    for _ in range(steps):
        if np.linalg.norm(error) < REACHED / 100 or model.nu == 0:
            break
        slope = here.tip_sensitivity * scale
        rows = np.vstack((slope, damping * np.linalg.norm(slope) * np.eye(model.nu)))
        goal = np.concatenate((-error, np.zeros(model.nu)))
        u = np.clip(here.u / scale, low, high)
        room = (np.minimum(low - u, -1e-12), np.maximum(high - u, 1e-12))
        du = lsq_linear(rows, goal, room, method="bvls").x * scale
        change = here.joint_sensitivity @ du
        du *= min(1.0, LARGEST_STEP / max(np.abs(change).max(initial=0.0), 1e-300))
        after = _follow(here, np.clip(here.u + du, model.u_min, model.u_max), barrier)
        if after is not None and stay_stable and not after.stable:
            after = None
        if after is not None and np.linalg.norm(after.y - target) < np.linalg.norm(error):
            gain = 1 - np.linalg.norm(after.y - target) / np.linalg.norm(error)
            here, error = after, after.y - target
            damping = max(damping / 10, 1e-9)
            if gain < (1e-9 if barrier is None else 1e-4):
                break
        elif damping > 1e3:
            break
        else:
            damping *= 10
    return here


def explore(
    model: SoftModel, target: np.ndarray, q: np.ndarray, u: np.ndarray, steps: int = 100
) -> Equilibrium:
    """An equilibrium, stable or not, with its tip near `target`, from an arbitrary shape.

    Bounded least squares on (q, u) (SciPy's reflective trust region): the forces, the tip's error
    at falling weights until only the forces count, and a little of u so that of many inputs small
    ones are taken. Meanwhile joint limits are a `Barrier`; `approach` goes on with it, and Newton's
    method finishes on exact stops.

    Parameters
    ----------
    target : (3,) in the world (m).
    q, u : where to start: (nq,), (nu,).
    steps : evaluations at most, for each weight.

    Raises
    ------
    StaticsError
        The least squares ended at no equilibrium.
    """
    target = array("target", target, (3,))
    problem = _TipProblem.build(model, target)
    x = np.concatenate((model.coordinates(q), u)) / problem.scale
    for weight in STAGES:
        value, slope = problem.functions(BARRIERS[0], weight)
        x = problem.inside(x)
        x = least_squares(
            value, x, slope, bounds=(problem.low, problem.high), max_nfev=steps, ftol=1e-6,
            xtol=1e-8, gtol=1e-12,
        ).x  # fmt: skip
    x = np.clip(x, problem.low, problem.high) * problem.scale
    q, u = model.configuration(x[: model.nv]), x[model.nv :]
    if not problem.near_stops(q):
        return approach(balance(model, u, q), target)
    stops = [Barrier(mu * problem.force * problem.scale[: model.nv]) for mu in BARRIERS]
    here = balance(model, u, q, stops[0])
    for barrier in stops:
        here = balance(model, here.u, here.q, barrier)
        here = approach(here, target, 30, barrier)
    coordinates = problem.to_stops(model.coordinates(here.q))
    return approach(balance(model, here.u, model.configuration(coordinates)), target)


def scatter(model: SoftModel, rays: int, seed: int = 0) -> Iterator[Equilibrium]:
    """Stable equilibria that raising random inputs from rest leads to, all along the way.

    A robot's useful tensions may be a small part of what its bounds allow, so a ray goes from a
    thousandth of its end to all of it in equal ratios.

    Parameters
    ----------
    rays : so many inputs are raised, `STATIONS` equilibria each.
    seed : of the random inputs.
    """
    rng = np.random.default_rng(seed)
    start = rest(model)
    for end in random_inputs(model, rays, seed):
        here = start
        for part in np.geomspace(1e-3, 1.0, STATIONS) * 10 ** -rng.uniform(0.0, 3 / STATIONS):
            try:
                here = settle(model, start.u + part * (end - start.u), here.q)
            except StaticsError:
                break
            yield here


def spread(samples: Sequence[Equilibrium], count: int, seed: int = 0) -> Iterator[Equilibrium]:
    """More stable equilibria, with tips where `samples` has few.

    Each goes from the sample closest to a random point of the box around all tips towards that
    point as far as it stays stable: points within the reachable set are met, others mark its edge.

    Parameters
    ----------
    samples : stable equilibria to start from.
    count : so many.
    seed : of the points.
    """
    rng = np.random.default_rng(seed)
    known = list(samples)
    tips = [one.y for one in known]
    for _ in range(count if known else 0):
        low, high = np.min(tips, axis=0), np.max(tips, axis=0)
        point = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low))
        start = known[int(np.argmin(np.linalg.norm(np.array(tips) - point, axis=1)))]
        one = approach(start, point, 15, stay_stable=True)
        known.append(one)
        tips.append(one.y)
        yield one


def random_inputs(model: SoftModel, count: int, seed: int = 0) -> np.ndarray:
    """Inputs (count, nu) on the surface of the box of bounds, seen from the least input."""
    rng = np.random.default_rng(seed)
    origin = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
    ends = rng.uniform(model.u_min, model.u_max, (count, model.nu)) - origin
    reach = np.where(ends > 0, model.u_max - origin, model.u_min - origin)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.nanmax(np.where(reach == 0, 0.0, ends / reach), axis=1, initial=1e-300)
    return np.clip(origin + ends / part[:, None], model.u_min, model.u_max)


def random_shapes(
    model: SoftModel, count: int, seed: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Random (q, u): joints within 0.7 rad and their limits, the input that balances them best."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        wild = model.coordinates(model.q0) + rng.uniform(-0.7, 0.7, model.nv)
        q = model.configuration(np.clip(wild, model.lower, model.upper))
        u = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
        if model.nu:
            state = model.state(q, np.zeros(model.nv))
            bounds = (model.u_min, np.maximum(model.u_max, model.u_min + 1e-12))
            u = lsq_linear(state.B, state.K + state.g, bounds, method="bvls").x
        yield q, u


# -- inside --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _TipProblem:
    """The least-squares problem of `explore` in scaled unknowns x = (coordinates, u) / scale."""

    model: SoftModel
    target: np.ndarray
    scale: np.ndarray  # (nv + nu,) of the unknowns
    force: np.ndarray  # (nv,) of the residual's rows
    length: float  # of the tip's error (m)
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def build(cls, model: SoftModel, target: np.ndarray) -> _TipProblem:
        """Scales from the robot at rest."""
        start = rest(model)
        span = np.minimum(model.upper - model.lower, 1.0)
        force = np.abs(np.diag(start.stiffness)) * span
        force = np.maximum(force, 1e-3 * force.max())
        scale = np.concatenate((span, _input_scale(model, start)))
        low = np.concatenate((model.lower, model.u_min)) / scale
        high = np.concatenate((model.upper, model.u_max)) / scale
        length = max(float(np.linalg.norm(start.y)), 1e-3) / 30
        return cls(model, target, scale, force, length, low, np.maximum(high, low + 1e-12))

    def functions(
        self, barrier: float, weight: float
    ) -> tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]:
        """Residual and Jacobian of x for one barrier and one weight of the tip's error."""
        model, n = self.model, self.model.nv
        mu = barrier * self.force * self.scale[:n]
        little = 1e-3

        def value(x: np.ndarray) -> np.ndarray:
            z = x * self.scale
            state = model.state(model.configuration(z[:n]), np.zeros(n))
            r = state.K + state.bias - state.B @ z[n:]
            r += mu / (model.upper - z[:n]) - mu / (z[:n] - model.lower)
            return np.concatenate(
                (
                    r / self.force,
                    weight * (state.y - self.target) / self.length,
                    little * weight * x[n:],
                )
            )

        def slope(x: np.ndarray) -> np.ndarray:
            z = x * self.scale
            q = model.configuration(z[:n])
            state = model.state(q, np.zeros(n))
            H = stiffness(model, q, z[n:])
            H += np.diag(mu / (model.upper - z[:n]) ** 2 + mu / (z[:n] - model.lower) ** 2)
            rows = np.zeros((n + 3 + model.nu, n + model.nu))
            rows[:n, :n] = H / self.force[:, None]
            rows[:n, n:] = -state.B / self.force[:, None]
            rows[n : n + 3, :n] = weight * state.J / self.length
            rows *= self.scale
            rows[n + 3 :, n:] = little * weight * np.eye(model.nu)
            return rows

        return value, slope

    def inside(self, x: np.ndarray) -> np.ndarray:
        """x strictly between its bounds."""
        margin = 1e-6 * np.minimum(self.high - self.low, 1.0)
        return np.clip(x, self.low + margin, self.high - margin)

    def near_stops(self, q: np.ndarray) -> bool:
        """Whether any joint is within a tenth of its scale of a limit."""
        at, near = self.model.coordinates(q), 0.1 * self.scale[: self.model.nv]
        return bool(((at < self.model.lower + near) | (at > self.model.upper - near)).any())

    def to_stops(self, coordinates: np.ndarray) -> np.ndarray:
        """Joints that only the barrier keeps from a limit put on it."""
        near = 1e-3 * self.scale[: self.model.nv]
        lower, upper = self.model.lower, self.model.upper
        coordinates = np.where(coordinates < lower + near, lower, coordinates)
        return np.where(coordinates > upper - near, upper, coordinates)


def _input_scale(model: SoftModel, start: Equilibrium) -> np.ndarray:
    """What each input needs to be to move a joint by about a radian, within its range."""
    force = np.abs(np.diag(start.stiffness)) * np.minimum(model.upper - model.lower, 1.0)
    arms = np.abs(start.state.B).max(axis=0, initial=0.0)
    needed = force.max() / np.maximum(arms, 1e-300)
    return np.clip(needed, 1e-9, np.maximum(model.u_max - model.u_min, 1e-9))


def _follow(here: Equilibrium, u: np.ndarray, barrier: Barrier | None) -> Equilibrium | None:
    """The equilibrium under `u` on the same branch, None when Newton's method leaves it."""
    change = here.joint_sensitivity @ (u - here.u)
    try:
        after = balance(here.model, u, move(here.model, here.q, change), barrier)
    except StaticsError:
        return None
    moved = np.abs(here.model.coordinates(after.q) - here.model.coordinates(here.q))
    return after if moved.max(initial=0.0) < 3 * LARGEST_STEP else None


def _order(one: Equilibrium, target: np.ndarray) -> tuple[float, float]:
    distance = float(np.linalg.norm(one.y - target))
    return max(distance, REACHED), float(np.linalg.norm(one.u))


def _same(one: Equilibrium, other: Equilibrium) -> bool:
    coordinates = one.model.coordinates
    return bool(np.abs(coordinates(one.q) - coordinates(other.q)).max() < SAME)
