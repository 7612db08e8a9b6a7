"""Balance with unknown inputs: r(q, u) = 0 together with an error e(q) = 0, from any shape.

The error is that of the tip, or of tasks. The unknowns are q and u within their bounds. Shapes on
the way are no equilibria, so buckled and unstable branches are found that a slowly raised input
never reaches. `balance_at` ends with e = 0, or there is no answer. It takes milliseconds, so that
hundreds of shapes can be tried. `explore` lets e give way, so that it ends at an equilibrium in
most cases.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softdyn.checks import array, whole
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel, State, check_model
from softdyn.dynamics.stops import Stops
from softdyn.statics.branch import REACHED, Measure, descend, input_scale, tip_error
from softdyn.statics.equilibria import balance, rest
from softdyn.statics.equilibrium import Equilibrium, NoEquilibrium, StaticsError, locked_inputs
from softdyn.statics.samples import balancing_input

ITERATIONS = 40
LARGEST_STEP = 0.5  # of a joint's scale in one iteration
LARGEST_DAMPING = 1.0  # with more of it the steps are too small to arrive
MOST_DAMPING = 1e6  # where the errors may stay
GAIN = 1e-6  # a smaller relative fall of the squares is the last
STEPS = 100  # for each of `STAGES`
ENOUGH = 1e-16  # sum of the squared scaled residuals
CLOSE = 1e-10  # of it: from here `balance` is tried
STAGES = (1.0, 0.1, 0.03, 0.01, 0.0)  # weights of the error, relative to the forces
SOFTNESS = (1e-2, 1e-3, 1e-4)  # softness of the stops over a joint's force times its range
LITTLE = 1e-3  # weight of the inputs beside that of the error: small ones are preferred


@dataclass(frozen=True, eq=False)
class TargetProblem:
    """Forces and errors as functions of scaled unknowns.

    The unknowns are the joint coordinates and the inputs that have room between their limits. The
    others keep the one value that they can have.
    """

    model: SoftModel
    measure: Measure
    locked: np.ndarray  # (nv,) bool, joints without room
    free: np.ndarray  # (unknowns,) their places among (coordinates, u)
    fixed: np.ndarray  # (nv + nu,) the values of the others
    scale: np.ndarray  # (nv + nu,) size of coordinates and inputs
    force: np.ndarray  # (nv,) size of the forces
    length: float  # size of the errors
    low: np.ndarray  # (unknowns,)
    high: np.ndarray

    @classmethod
    def for_tip(cls, model: SoftModel, target: np.ndarray) -> TargetProblem:
        """The problem with the tip at a target (3,)."""
        start = rest(model)
        length = max(float(np.linalg.norm(start.y)), 1e-3) / 30
        return cls.build(start, tip_error(target), length)

    @classmethod
    def build(
        cls, start: Equilibrium, measure: Measure, length: float | None = None
    ) -> TargetProblem:
        """The problem of a robot, with scales from its equilibrium `rest`.

        The errors' size is by default a thirtieth of their change over the ranges of all joints.
        """
        model, locked = start.model, Stops.of(start.model).locked
        span = np.where(locked, 1.0, np.minimum(model.upper - model.lower, 1.0))
        force = np.abs(np.diag(start.stiffness)) * span
        inputs = input_scale(model, start)
        if force.max() <= start.rounding:  # no stiffness at rest: the inputs alone
            force = np.abs(start.state.B) @ inputs
        force = np.maximum(force, 1e-3 * force.max())
        force = np.where(force > 0, force, 1.0)
        scale = np.concatenate((span, inputs))
        fixed = np.concatenate((model.lower, model.u_min))
        free = np.flatnonzero(~np.concatenate((locked, locked_inputs(model))))
        low = fixed[free] / scale[free]
        high = np.concatenate((model.upper, model.u_max))[free] / scale[free]
        if length is None:
            length = max(float(np.linalg.norm(measure(start.state)[1] * span)), 1e-3) / 30
        return cls(model, measure, locked, free, fixed, scale, force, length, low, high)

    @cached_property
    def joints(self) -> np.ndarray:
        """Unknowns (unknowns,) bool that are joint coordinates."""
        return self.free < self.model.nv

    def unknowns(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The unknowns of a configuration (nq,) and an input (nu,)."""
        q, u = array("q", q, (self.model.nq,)), array("u", u, (self.model.nu,))
        return (np.concatenate((self.model.coordinates(q), u)) / self.scale)[self.free]

    def values(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joint coordinates (nv,) and input (nu,) of the unknowns."""
        z = self.fixed.copy()
        z[self.free] = x * self.scale[self.free]
        return z[: self.model.nv], z[self.model.nv :]

    def shape(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Configuration (nq,) and input (nu,) of the unknowns."""
        coordinates, u = self.values(x)
        return self.model.configuration(coordinates), u

    def repulsion(self, at: np.ndarray, softness: float) -> tuple[np.ndarray, np.ndarray]:
        """Forces (nv,) of soft stops at coordinates `at`, and the stiffness (nv,) that they add.

        The repulsion is μ / gap, with a softness μ over a joint's force times its scale.
        """
        weight = softness * self.force * self.scale[: self.model.nv]
        limits = at - self.model.lower, self.model.upper - at
        below, above = (np.where(self.locked, np.inf, gap) for gap in limits)
        return weight / below - weight / above, weight / below**2 + weight / above**2

    def near_stops(self, q: np.ndarray) -> bool:
        """Whether any joint with room is within a tenth of its scale of a limit."""
        lower, upper = self._at_stops(q, 0.1)
        return bool(((lower | upper) & ~self.locked).any())

    def to_stops(self, q: np.ndarray) -> np.ndarray:
        """A configuration (nq,) with joints at their limits that only soft stops keep away."""
        model = self.model
        lower, upper = self._at_stops(q, 1e-3)
        at = np.where(lower, model.lower, model.coordinates(q))
        return model.configuration(np.where(upper, model.upper, at))

    def _at_stops(self, q: np.ndarray, part: float) -> tuple[np.ndarray, np.ndarray]:
        model = self.model
        return Stops.of(model).hit(model.coordinates(q), part * self.scale[: model.nv])


@dataclass(frozen=True, eq=False)
class _Residual:
    """Scaled forces and errors at the unknowns x, and their derivatives."""

    problem: TargetProblem
    x: np.ndarray
    state: State
    rows: np.ndarray
    softness: float
    weight: float

    @classmethod
    def at(
        cls, problem: TargetProblem, x: np.ndarray, softness: float = 0.0, weight: float = 1.0
    ) -> _Residual:
        """With hard stops, which are not touched, inputs do not count."""
        model = problem.model
        coordinates, u = problem.values(x)
        state = model.state(model.configuration(coordinates), np.zeros(model.nv))
        r = state.h - state.B @ u
        r[problem.locked] = 0.0  # their stops take any force
        if softness:
            r -= problem.repulsion(coordinates, softness)[0]
        error = weight * problem.measure(state)[0]
        rows = np.concatenate((r / problem.force, error / problem.length))
        if softness:
            rows = np.concatenate((rows, LITTLE * weight * x[~problem.joints]))
        return cls(problem, x, state, rows, softness, weight)

    @property
    def cost(self) -> float:
        """Sum of the squares."""
        return float(self.rows @ self.rows)

    def slope(self) -> np.ndarray:
        """Derivatives (rows, unknowns)."""
        problem, model, n = self.problem, self.problem.model, self.problem.model.nv
        coordinates, u = problem.values(self.x)
        jacobian = problem.measure(self.state)[1]
        slope = np.zeros((n + len(jacobian), n + model.nu))
        slope[:n, :n] = stiffness(model, self.state.q, u)
        if self.softness:
            slope[:n, :n] += np.diag(problem.repulsion(coordinates, self.softness)[1])
        slope[:n, n:], slope[n:, :n] = -self.state.B, self.weight * jacobian
        slope[:n][problem.locked] = 0.0
        size = np.concatenate((problem.force, np.full(len(jacobian), problem.length)))[:, None]
        slope = np.take(slope * (problem.scale / size), problem.free, axis=1)
        if not self.softness:
            return slope
        small = np.eye(len(self.x))[~problem.joints]
        return np.vstack((slope, LITTLE * self.weight * small))

    def moved(self, step: np.ndarray) -> _Residual:
        """The residual after a step of the unknowns, cut at the bounds, and before soft stops."""
        problem = self.problem
        part = np.where(problem.joints & (self.softness > 0), 0.9, 1.0)
        below, above = (part * (bound - self.x) for bound in (problem.low, problem.high))
        x = np.clip(self.x + np.clip(step, below, above), problem.low, problem.high)
        return _Residual.at(problem, x, self.softness, self.weight)


def _least(here: _Residual, steps: int, most: float) -> _Residual:
    """The least squares by Levenberg-Marquardt within the bounds, with a damping up to `most`.

    With soft stops an input stays at its bound while the gradient leads out. Without them the steps
    are only cut: so they find more from folded shapes.
    """
    problem, damping = here.problem, 1e-2
    for _ in range(steps):
        cost = here.cost
        if cost < ENOUGH or damping > most:
            break
        slope = here.slope()
        square, fall = slope.T @ slope, slope.T @ here.rows
        out = (here.x <= problem.low) & (fall > 0) | (here.x >= problem.high) & (fall < 0)
        free = np.flatnonzero(~out | (here.softness == 0))
        block, step = square[np.ix_(free, free)], np.zeros(len(out))
        while damping <= most:
            step[free] = np.linalg.solve(block + damping * np.eye(len(free)), -fall[free])
            largest = max(np.abs(step[problem.joints]).max(initial=0.0), 1e-300)
            there = here.moved(step * min(1.0, LARGEST_STEP / largest))
            if there.cost < cost:
                here, damping = there, max(damping / 10, 1e-12)
                break
            damping = max(10 * damping, 1e-8)
        if here.cost > (1 - GAIN) * cost:
            break
    return here


def balance_at(problem: TargetProblem, q: np.ndarray, u: np.ndarray) -> Equilibrium:
    """The equilibrium, stable or not, with no error, from any shape.

    The method is Levenberg-Marquardt; steps are cut at the bounds of joints and inputs. It does not
    find equilibria at a joint's limit.

    Parameters
    ----------
    problem : TargetProblem
        The robot and the errors.
    q, u : ndarray, (nq,), (nu,)
        The first configuration and input.

    Raises
    ------
    StaticsError
        If it ends elsewhere.
    """
    model = problem.model
    x = np.clip(problem.unknowns(q, u), problem.low, problem.high)
    here = _least(_Residual.at(problem, x), ITERATIONS, LARGEST_DAMPING)
    if here.cost < CLOSE:
        q, u = problem.shape(here.x)
        found = balance(model, u, q)
        if np.linalg.norm(problem.measure(found.state)[0]) < REACHED:
            return found
    missed = float(np.abs(here.rows[: model.nv] * problem.force).max(initial=0.0))
    raise NoEquilibrium(f"no equilibrium of {model.name} at the target", missed)


def explore(
    model: SoftModel, target: np.ndarray, q: np.ndarray, u: np.ndarray, steps: int = STEPS
) -> Equilibrium:
    """An equilibrium, stable or not, with its tip near `target`, from an arbitrary shape.

    The method is that of `balance_at` on (q, u). The residuals are the forces, the tip's error, and
    u with a small weight, which prefers small inputs. The weight of the tip's error falls until
    only the forces count. Joint limits are soft stops first, with falling softness. `approach` then
    continues with exact stops.

    Parameters
    ----------
    target : ndarray, (3,)
        The target in the world (m).
    q, u : ndarray, (nq,), (nu,)
        The first configuration and input.
    steps : int
        Largest number of steps for each weight.

    Raises
    ------
    StaticsError
        If it ends at no equilibrium.
    """
    target, steps = array("target", target, (3,)), whole("steps", steps, 1)
    return explore_from(TargetProblem.for_tip(check_model(model), target), q, u, steps)


def explore_from(
    problem: TargetProblem, q: np.ndarray, u: np.ndarray, steps: int = STEPS
) -> Equilibrium:
    """`explore` for any errors."""
    model, measure = problem.model, problem.measure
    margin = np.where(problem.joints, SOFTNESS[0], 0.0)
    x = np.clip(problem.unknowns(q, u), problem.low + margin, problem.high - margin)
    for weight in STAGES:
        x = _least(_Residual.at(problem, x, SOFTNESS[0], weight), steps, MOST_DAMPING).x
    q, u = problem.shape(x)
    if not problem.near_stops(q):
        try:
            found = balance(model, u, q)
        except StaticsError:  # u also balances the soft stops, and no stiffness takes their place
            found = balance(model, balancing_input(model, q), q)
        return descend(found, measure)
    for softness in SOFTNESS[1:]:
        for weight in STAGES[-2:]:
            x = _least(_Residual.at(problem, x, softness, weight), steps, MOST_DAMPING).x
    q, u = problem.shape(x)
    return descend(balance(model, u, problem.to_stops(q)), measure)
