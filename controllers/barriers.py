"""Exponential control barrier functions: joint limits, half-spaces and spheres as rows of the QP.

A barrier is a function b(q) of relative degree two that must stay non-negative. Its condition has
poles at -α and -β (Nguyen and Sreenath 2016); β = α unless the barrier has a `recovery`. As in the
dynamics (`softdyn.controllers.qps.horizon`) it is evaluated by backward Euler at the end of a step
τ:

    b̈ + (α + β) (ḃ + τ b̈) + α β (b + τ ḃ + τ² b̈) ≥ 0,     b̈ = G q̈ + r,   G = ∂b/∂q,

where r is the part of b̈ without q̈. q̈ is *not* the QP's own, which is fictitious along unactuated
directions. It is that of the whole dynamics, q̈ = M⁻¹(B u - h), so every barrier gives one
inequality in u. The dynamics have no stops, so a joint that is at a stop, or reaches it within a
period, has the q̈ that takes it there, unless the input makes it leave. Divided by
(1 + α τ)(1 + β τ) it is b̈ ≥ -c, where -c is the least allowed acceleration.

Let s = ḃ + α b, ḃ⁺ = ḃ + τ b̈ and b⁺ = b + τ ḃ⁺. The row is then (1 + β τ) s⁺ ≥ s, and b⁺ is
(b + τ s⁺) / (1 + α τ). If b ≥ 0 and s ≥ 0, both still hold after an exact step of τ. From other
states there is no guarantee. They are counted, and a run that starts at one gives a warning.

In a run every barrier has two rows: τ is the horizon in one, and the control period in the other.
With the first row alone an input may push the tip in within a period, because it would come back
within the horizon; but the next input does the same. With the second row alone it brakes too late.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from softdyn import SoftModel, State
from softdyn.checks import number
from softdyn.controllers.controller import SILENT
from softdyn.controllers.qps.horizon import Horizon
from softdyn.controllers.qps.qp import DenseQp, QpProblem, QpSolution
from softdyn.safety.clearance import CENTIRADIAN, MILLIMETRE, Values
from softdyn.safety.obstacles import RATE, KeepOutSphere
from softdyn.safety.obstacles import HalfSpace as HalfSpace

NEGLIGIBLE = 1e-6  # of these units
ROOM = 1e-2  # of these units; every row is relaxed by it, because a QP needs an interior
ROUNDS = 6  # largest number of rounds that add rows
TOUCH = 0.1  # of these units: a joint so near its stop touches it
TIE = 1e-6  # weight that chooses among inputs that break the rows alike


class ControlBarrier(Protocol):
    """An obstacle or a limit."""

    @property
    def rate(self) -> float:
        """α (1/s), the rate at which the controller may approach it."""
        ...

    def __call__(self, state: State) -> Values:
        """Its barriers at this state."""
        ...


class JointLimits:
    """Every finite limit of the file's joints.

    Parameters
    ----------
    model : SoftModel
        The robot.
    margin : float
        Distance to keep from every limit, as a share of the joint's range.
    rate : float
        α (1/s), the rate at which the controller may approach a limit.
    """

    def __init__(self, model: SoftModel, margin: float = 0.0, rate: float = RATE) -> None:
        margin = number("margin", margin, lower=0.0)
        self.rate = number("rate", rate, above=0.0)
        limited = np.isfinite(model.lower) & np.isfinite(model.upper)
        inset = margin * np.where(limited, model.upper - model.lower, 0.0)
        eye = np.eye(model.nv)
        below, above = np.isfinite(model.lower), np.isfinite(model.upper)
        self._gradient = np.vstack((eye[below], -eye[above]))
        self._offset = np.concatenate((-(model.lower + inset)[below], (model.upper - inset)[above]))
        self._drift = np.zeros(len(self._offset))
        unit = _joint_units(model)
        self._unit = np.concatenate((unit[below], unit[above]))

    def __call__(self, state: State) -> Values:
        """q - lower and upper - q, joint by joint."""
        coordinates = state.model.coordinates(state.q)
        b = self._gradient @ coordinates + self._offset
        return Values(b, self._gradient, self._drift, self._unit)


def _joint_units(model: SoftModel) -> np.ndarray:
    """The unit (n,) of each joint: a slide's is a length."""
    sliding = {joint.name for joint in model.robot.joints if joint.kind == "prismatic"}
    return np.array([MILLIMETRE if n in sliding else CENTIRADIAN for n in model.joint_names])


def __getattr__(name: str) -> Any:
    if name != "Sphere":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn("Sphere is called KeepOutSphere", DeprecationWarning, stacklevel=2)
    return KeepOutSphere


class UnsafeStart(UserWarning):
    """A run starts with b < 0 or ḃ + α b < 0."""


class Rows(NamedTuple):
    """matrix @ u ≤ upper; an excess of `unit` (p,) lets b fall by one of its units."""

    matrix: np.ndarray
    upper: np.ndarray
    unit: np.ndarray


class BarrierRows:
    """The rows of all barriers; they are hard if an admissible input meets them.

    The priorities are: the input bounds, then the rows, then the objective. If no admissible input
    meets all rows, they are relaxed by the least squares of their excess, in mm and 0.01 rad. The
    QP's feasible set may then be thinner than the solver's tolerance. If the QP has no accurate
    answer, the result is the input of least excess nearest to the answer without rows.

    Parameters
    ----------
    model : SoftModel
        The robot.
    barriers : sequence of ControlBarrier
        Obstacles and limits.
    tau : float
        The horizon τ (s).

    Attributes
    ----------
    outside : int
        Number of states with b < 0 or ḃ + α b < 0 for a barrier, from which there is no guarantee.
    violation : float
        The largest -b at any state, in mm or 0.01 rad; negative if no barrier was violated.
    relaxed : int
        Number of steps at which rows were relaxed.
    relaxation : float
        The largest relaxation, as the mm or 0.01 rad by which b may fall.
    least : int
        Number of steps at which the input of least excess was taken, without the objective.
    """

    def __init__(self, model: SoftModel, barriers: Sequence[ControlBarrier], tau: float) -> None:
        self._model, self._barriers, self._tau = model, tuple(barriers), tau
        self._u_min, self._u_max = model.u_min, model.u_max
        self._range = np.where(model.u_max > model.u_min, model.u_max - model.u_min, 1.0)
        self._solvers: dict[tuple[int, int], DenseQp] = {}
        self.reset()

    def reset(self, period: float = 0.0) -> None:
        """Reset all counts; with a control period (s) every barrier has a row for it too."""
        self.violation, self.relaxed, self.relaxation = -np.inf, 0, 0.0
        self.outside, self.least, self._begun = 0, 0, False
        self._period, self._step = period, period or self._tau or 1e-3
        self._hold = Horizon(self._model, period) if period else None

    def at(self, state: State, M: np.ndarray, h: np.ndarray) -> Rows:
        """Every barrier's rows at a state, with M and h of the dynamics over the horizon."""
        seen, steps, stops = self._seen(state), self._steps(state, M, h), self._stops(state)
        return _stacked(state, seen, steps, [_inverse(state, *step, stops) for step in steps])

    def _seen(self, state: State) -> list[tuple[float, float, Values]]:
        """The rates α, β and the values of every barrier; states without guarantee are counted."""
        seen = [
            (one.rate, getattr(one, "recovery", one.rate), one(state)) for one in self._barriers
        ]
        self._count(state, seen)
        model, period = self._model, self._period
        for k, barrier in enumerate(self._barriers):
            if (kept := getattr(barrier, "kept", None)) is not None:
                alpha, beta, found = seen[k]  # the counts above are of the barrier itself
                seen[k] = alpha, beta, found._replace(b=found.b - kept(model, period))
        return seen

    def _steps(self, state: State, M: np.ndarray, h: np.ndarray) -> list[Dynamics]:
        """The steps τ that have rows, each with M and h; the last is the control period."""
        steps = [(self._tau, M, h)] if self._tau or self._hold is None else []
        if self._hold is not None:
            steps.append((self._period, *self._hold(state)))
        return steps

    def _stops(self, state: State) -> np.ndarray:
        """Distance (n,) to the stop that a joint is at, or reaches in a step; NaN for the others.

        A joint that meets its stop between two steps loses its speed there and pushes the others.
        """
        model, near, slow = self._model, TOUCH * _joint_units(self._model), 1 / self._step
        q, v = model.coordinates(state.q), state.v
        low, high, way = model.lower - q, model.upper - q, self._period * v
        at_low = (low >= -near) & (v <= near * slow) | (low >= way) & (v < 0)
        at_high = (high <= near) & (v >= -near * slow) | (high <= way) & (v > 0)
        return np.where(at_low, low, np.where(at_high, high, np.nan))

    def _count(self, state: State, seen: Sequence[tuple[float, float, Values]]) -> None:
        """Count a state without guarantee; warn if a run starts at one."""
        outside = ""
        for barrier, (alpha, _, (b, G, _, unit)) in zip(self._barriers, seen, strict=True):
            self.violation = max(self.violation, float((-b / unit).max(initial=-np.inf)))
            s = G @ state.v + alpha * b
            approach = np.minimum(b, s / alpha) / unit
            if approach.size and approach.min() < -NEGLIGIBLE:
                worst = approach.argmin()
                name = type(barrier).__name__
                outside = outside or (
                    f"{name}: b = {b[worst]:.3g}, db/dt + {alpha:g} b = {s[worst]:.3g}"
                )
        self.outside += bool(outside)
        if outside and not self._begun:
            text = f"the run starts outside the safe set ({outside}; both should be >= 0)"
            warnings.warn(text, UnsafeStart, stacklevel=2)
        self._begun = True

    @SILENT
    def enforce(
        self,
        problem: QpProblem,
        solution: QpSolution | None,
        state: State,
        M: np.ndarray,
        h: np.ndarray,
    ) -> QpSolution | None:
        """`solution` if it meets every row, else the answer of `problem` with rows.

        Few rows ever matter, so a row is added only when an answer breaks it, in at most `ROUNDS`
        rounds. The first unknowns of `problem` are u.
        """
        seen, steps, stops = self._seen(state), self._steps(state, M, h), self._stops(state)
        if solution is None or not solution.solved:
            return solution
        m = state.B.shape[1]
        while True:  # every round frees a joint
            inverses = [_inverse(state, *step, stops) for step in steps]
            rows = _stacked(state, seen, steps, inverses)
            answer, sunk, least = self._enforced(problem, solution, rows)
            leaving = _leaving(self._model, state, steps[-1], inverses[-1], stops, answer.x[:m])
            if not leaving.any():
                break
            stops[leaving] = np.nan
        if sunk > ROOM + 2 * NEGLIGIBLE:
            self.relaxed, self.relaxation = self.relaxed + 1, max(self.relaxation, sunk)
        self.least += least
        return answer

    def _enforced(
        self, problem: QpProblem, solution: QpSolution, rows: Rows
    ) -> tuple[QpSolution, float, bool]:
        """The answer with these rows, the largest excess in units, and whether it is the least."""
        m = rows.matrix.shape[1]
        answer, wanted, least = solution, solution.x[:m].copy(), False
        upper, chosen = rows.upper.copy(), np.zeros(len(rows.upper), bool)
        for _ in range(ROUNDS):
            broken = rows.matrix @ answer.x[:m] > upper + NEGLIGIBLE * rows.unit
            if not (broken & ~chosen).any():
                break
            chosen |= broken
            some = Rows(*(part[chosen] for part in rows))
            excess, nearest = self._excess(some, wanted)
            upper[chosen] = some.upper + some.unit * np.where(excess > ROOM, excess + ROOM, ROOM)
            found = self._restricted(problem, some.matrix, upper[chosen])
            least = found is None or not found.solved
            if found is None or least:  # the other unknowns then have no value
                x = np.concatenate((nearest, np.full(len(problem.g) - m, np.nan)))
                found = QpSolution(x, np.zeros(len(problem.lower)), 0.0, 0.0, 0.0)
            answer = found
        sunk = float(((rows.matrix @ answer.x[:m] - rows.upper) / rows.unit).max(initial=0.0))
        return answer, sunk, least

    def _restricted(
        self, problem: QpProblem, matrix: np.ndarray, upper: np.ndarray
    ) -> QpSolution | None:
        """The answer of `problem` with the further rows `matrix` u ≤ `upper` (p,)."""
        (p, m), size = matrix.shape, len(problem.g)
        restricted = QpProblem(
            problem.H,
            problem.g,
            np.vstack((problem.A, np.hstack((matrix, np.zeros((p, size - m)))))),
            np.concatenate((problem.lower, np.full(p, -np.inf))),
            np.concatenate((problem.upper, upper)),
        )
        return self._solver(size, len(restricted.lower)).solve(restricted)

    def _excess(self, rows: Rows, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Excess of each row (p,) under the best admissible input, in units, and this input (m,).

        It is the s of min ‖s‖² over matrix u - unit s ≤ upper, u in bounds; s ≥ 0 needs no row. Of
        several best inputs, the one nearest to `wanted` is taken.
        """
        p, m = rows.matrix.shape
        matrix, upper = rows.matrix / rows.unit[:, None], rows.upper / rows.unit
        # the weight is relative to the inputs' effect on the rows: a smaller one would be rounding
        effect = max(1.0, float(np.linalg.norm(matrix * self._range, axis=1).max(initial=0.0)))
        tie = TIE * (effect / self._range) ** 2
        H, g = np.diag(np.concatenate((tie, np.ones(p)))), np.zeros(m + p)
        g[:m] = -tie * wanted
        A = np.zeros((m + p, m + p))
        A[:m, :m] = np.eye(m)
        A[m:, :m], A[m:, m:] = matrix, -np.eye(p)
        lower = np.concatenate((self._u_min, np.full(p, -np.inf)))
        solution = self._solver(m + p, m + p).solve(
            QpProblem(H, g, A, lower, np.concatenate((self._u_max, upper)))
        )
        u = wanted if solution is None else np.clip(solution.x[:m], self._u_min, self._u_max)
        return np.maximum(matrix @ u - upper, 0.0), u

    def _solver(self, variables: int, rows: int) -> DenseQp:
        key = variables, rows
        if key not in self._solvers:
            self._solvers[key] = DenseQp(variables, rows)
        return self._solvers[key]


Dynamics = tuple[float, np.ndarray, np.ndarray]  # τ, M, h


def _inverse(
    state: State, tau: float, M: np.ndarray, h: np.ndarray, stops: np.ndarray
) -> np.ndarray:
    """(X, x), (n, nu + 1), of q̈ = X u - x, with M and h of the dynamics over a step τ.

    Joints with a distance in `stops` go to their stop in this step: q̈ = (distance / τ - q̇) / τ. At
    τ = 0 they do not accelerate.
    """
    inverse = np.column_stack((state.B, h))
    free = np.isnan(stops)
    if free.all():
        return np.linalg.solve(M, inverse)
    held = np.flatnonzero(~free)
    qdd = (stops[held] / tau - state.v[held]) / tau if tau else np.zeros(len(held))
    inverse[:, -1] += M[:, held] @ qdd
    inverse[free] = np.linalg.solve(M[np.ix_(free, free)], inverse[free])
    inverse[held] = 0.0
    inverse[held, -1] = -qdd
    return inverse


def _leaving(
    model: SoftModel,
    state: State,
    step: Dynamics,
    inverse: np.ndarray,
    stops: np.ndarray,
    u: np.ndarray,
) -> np.ndarray:
    """Whether each joint (n,) leaves its stop under u, because the stop would have to pull."""
    _, M, h = step
    held = ~np.isnan(stops)
    if not held.any():
        return held
    force = M @ (inverse[:, :-1] @ u - inverse[:, -1]) + h - state.B @ u
    q = model.coordinates(state.q)
    upper = model.upper - q < q - model.lower
    return held & (np.where(upper, -force, force) < 0)


def _stacked(
    state: State,
    seen: Sequence[tuple[float, float, Values]],
    steps: Sequence[Dynamics],
    inverses: Sequence[np.ndarray],
) -> Rows:
    """The rows over all steps."""
    parts = [
        _rows(state, seen, tau, inverse)
        for (tau, _, _), inverse in zip(steps, inverses, strict=True)
    ]
    return Rows(*(np.concatenate(same) for same in zip(*parts, strict=True)))


def _rows(
    state: State,
    seen: Sequence[tuple[float, float, Values]],
    tau: float,
    inverse: np.ndarray,
) -> Rows:
    """A row for every barrier, with its rate α, over a step τ with q̈ of `_inverse`."""
    parts = []
    for alpha, beta, (b, G, drift, unit) in seen:
        share = 1 / ((1 + alpha * tau) * (1 + beta * tau))
        both = alpha * beta
        affordable = share * ((alpha + beta + both * tau) * (G @ state.v) + both * b)
        response = G @ inverse
        upper = affordable + drift - response[:, -1]
        parts.append((-response[:, :-1], upper, share * both * unit))
    return Rows(*(np.concatenate(same) for same in zip(*parts, strict=True)))
