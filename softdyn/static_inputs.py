"""Inputs that hold the tip at a given point, and samples of the points where it can be held.

Unknown are q and u together: r(q, u) = 0 between the joint limits, u within its bounds, y(q) = y*.
Two solvers share the work. `explore` treats all of it as one bounded least-squares problem from an
arbitrary start, so it passes through shapes that are no equilibria and finds buckled and unstable
branches that no ramp leads to. `approach` then moves along the branch of exact equilibria it ended
on, with ∂y/∂u = J (∂r/∂q)⁻¹ B, until the tip is as close as the bounds let it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from softdyn.checks import array
from softdyn.derivatives import stiffness
from softdyn.equilibria import Equilibrium, StaticsError, balance, move, residual, rest, settle
from softdyn.model import SoftModel

REACHED = 1e-6  # m: the tip is at the target
SAME = 1e-3  # equilibria whose joints are this close are one (rad, m)
LARGEST_STEP = 0.3  # of a joint in one step along a branch (rad, m)
RAMP = 6  # steps from rest to a sampled input


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

    def distance(self, equilibrium: Equilibrium) -> float:
        """From its tip to the target (m)."""
        return float(np.linalg.norm(equilibrium.y - self.target))


def inputs_for_tip(
    model: SoftModel,
    target: np.ndarray,
    starts: Iterable[Equilibrium] = (),
    *,
    shapes: int = 16,
    seed: int = 0,
) -> TipSearch:
    """Inputs within their bounds that hold the tip at `target`, or as near as was found.

    A local search from many starts: what it finds exists; what it does not find may exist.

    Parameters
    ----------
    target : (3,) in the world (m).
    starts : equilibria to start from besides rest, e.g. the nearest of `scatter`.
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
    guesses = [(one.q, one.u) for one in known]
    guesses += list(random_shapes(model, shapes, seed))
    ends = [approach(one, target) for one in known]
    for q, u in guesses:
        try:
            ends.append(approach(explore(model, target, q, u), target))
        except StaticsError:
            continue
    found: list[Equilibrium] = []
    for one in sorted(ends, key=lambda one: _order(one, target)):
        if not any(_same(one, other) for other in found):
            found.append(one)
    return TipSearch(target, tuple(found))


def approach(start: Equilibrium, target: np.ndarray, steps: int = 60) -> Equilibrium:
    """Follow the branch of `start` until the tip is as close to `target` as its inputs allow.

    Damped Gauss-Newton on ‖y(u) - y*‖ within the input bounds, every iterate an equilibrium,
    stable or not. It ends early where the branch folds (∂r/∂q singular).

    Parameters
    ----------
    start : where to start.
    target : (3,) in the world (m).
    steps : at most so many.
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
        after = _follow(here, np.clip(here.u + du, model.u_min, model.u_max))
        if after is not None and np.linalg.norm(after.y - target) < np.linalg.norm(error):
            gain = 1 - np.linalg.norm(after.y - target) / np.linalg.norm(error)
            here, error = after, after.y - target
            damping = max(damping / 10, 1e-9)
            if gain < 1e-9:
                break
        elif damping > 1e3:
            break
        else:
            damping *= 10
    return here


def explore(
    model: SoftModel, target: np.ndarray, q: np.ndarray, u: np.ndarray, steps: int = 60
) -> Equilibrium:
    """An equilibrium, stable or not, with its tip near `target`, from an arbitrary shape.

    Bounded least squares on (q, u) (SciPy's reflective trust region): forces, the tip's error,
    and a little of u so that among many inputs small ones are taken. A joint limit acts as a
    barrier force μ / gap whose μ falls; Newton's method then finishes on exact stops.

    Parameters
    ----------
    target : (3,) in the world (m).
    q, u : where to start: (nq,), (nu,).
    steps : evaluations at most, for each of two μ.

    Raises
    ------
    StaticsError
        The least squares ended at no equilibrium.
    """
    target = array("target", target, (3,))
    problem = _TipProblem.build(model, target)
    x = np.concatenate((model.coordinates(q), u)) / problem.scale
    for barrier in (1e-2, 1e-4):
        value, slope = problem.functions(barrier)
        x = problem.inside(x)
        x = least_squares(
            value, x, slope, bounds=(problem.low, problem.high), max_nfev=steps, ftol=1e-10,
            xtol=1e-10, gtol=1e-10,
        ).x  # fmt: skip
    x = np.clip(x, problem.low, problem.high) * problem.scale
    coordinates, u = problem.to_stops(x[: model.nv]), x[model.nv :]
    return balance(model, u, model.configuration(coordinates))


def scatter(model: SoftModel, count: int, seed: int = 0) -> Iterator[Equilibrium]:
    """Stable equilibria that raising random inputs from rest leads to.

    Directions are uniform in the box of inputs, amplitudes log-uniform between 1e-3 of it and
    all of it: a robot's useful tensions may be a small part of what its bounds allow.

    Parameters
    ----------
    count : so many inputs; one that leads to no equilibrium yields none.
    seed : of the random inputs.
    """
    start = rest(model)
    for u in random_inputs(model, count, seed):
        try:
            yield _quick_ramp(start, u)
        except StaticsError:
            continue


def random_inputs(model: SoftModel, count: int, seed: int = 0) -> np.ndarray:
    """Inputs (count, nu) within bounds: uniform directions, log-uniform amplitudes."""
    rng = np.random.default_rng(seed)
    origin = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
    ends = rng.uniform(model.u_min, model.u_max, (count, model.nu)) - origin
    reach = np.where(ends > 0, model.u_max - origin, model.u_min - origin)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.nanmax(np.where(reach == 0, 0.0, ends / reach), axis=1, initial=1e-300)
    return origin + ends / part[:, None] * 10.0 ** rng.uniform(-3, 0, (count, 1))


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
        self, barrier: float
    ) -> tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]:
        """Residual and Jacobian of x at one barrier parameter."""
        model, n = self.model, self.model.nv
        mu = barrier * self.force * self.scale[:n]
        little = 1e-3

        def value(x: np.ndarray) -> np.ndarray:
            z = x * self.scale
            state = model.state(model.configuration(z[:n]), np.zeros(n))
            r = state.K + state.bias - state.B @ z[n:]
            r += mu / (model.upper - z[:n]) - mu / (z[:n] - model.lower)
            return np.concatenate(
                (r / self.force, (state.y - self.target) / self.length, little * x[n:])
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
            rows[n : n + 3, :n] = state.J / self.length
            rows *= self.scale
            rows[n + 3 :, n:] = little * np.eye(model.nu)
            return rows

        return value, slope

    def inside(self, x: np.ndarray) -> np.ndarray:
        """x strictly between its bounds."""
        margin = 1e-6 * np.minimum(self.high - self.low, 1.0)
        return np.clip(x, self.low + margin, self.high - margin)

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


def _follow(here: Equilibrium, u: np.ndarray) -> Equilibrium | None:
    """The equilibrium under `u` on the same branch, None when Newton's method leaves it."""
    change = here.joint_sensitivity @ (u - here.u)
    try:
        after = balance(here.model, u, move(here.model, here.q, change))
    except StaticsError:
        return None
    moved = np.abs(here.model.coordinates(after.q) - here.model.coordinates(here.q))
    return after if moved.max(initial=0.0) < 3 * LARGEST_STEP else None


def _quick_ramp(start: Equilibrium, u: np.ndarray) -> Equilibrium:
    here = start
    for s in np.linspace(0, 1, RAMP + 1)[1:]:
        here = settle(start.model, start.u + s * (u - start.u), here.q)
    return here


def _order(one: Equilibrium, target: np.ndarray) -> tuple[float, float]:
    distance = float(np.linalg.norm(one.y - target))
    return max(distance, REACHED), float(np.linalg.norm(one.u))


def _same(one: Equilibrium, other: Equilibrium) -> bool:
    coordinates = one.model.coordinates
    return bool(np.abs(coordinates(one.q) - coordinates(other.q)).max() < SAME)
