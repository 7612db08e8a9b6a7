"""Exponential control barrier functions: joint limits, half-spaces and spheres as rows of the QP.

A barrier is a function b(q) of relative degree two that must stay non-negative. Its condition has
poles at -α and -β (Nguyen and Sreenath 2016); β = α unless the barrier has a `recovery`. As in the
dynamics (`softdyn.controllers.qps.horizon`) it is evaluated by backward Euler at the end of a step
τ:

    b̈ + (α + β) (ḃ + τ b̈) + α β (b + τ ḃ + τ² b̈) ≥ 0,     b̈ = G q̈ + r,   G = ∂b/∂q,

where r is the part of b̈ without q̈. q̈ is *not* the QP's own, which is fictitious along unactuated
directions. It is that of the whole dynamics, so every barrier gives one inequality in u. Divided by
(1 + α τ)(1 + β τ) it is b̈ ≥ -c, where -c is the least allowed acceleration.

Let s = ḃ + α b, ḃ⁺ = ḃ + τ b̈ and b⁺ = b + τ ḃ⁺. The row is then (1 + β τ) s⁺ ≥ s, and b⁺ is
(b + τ s⁺) / (1 + α τ). If b ≥ 0 and s ≥ 0, both still hold after an exact step of τ. From other
states there is no guarantee. They are counted, and a run that starts at one gives a warning.

In a run every barrier has two rows: τ is the horizon in one, and the control period in the other.
With the first row alone an input may push the tip in within a period, because it would come back
within the horizon; but the next input does the same. With the second row alone it brakes too late.

The input is that of a QP in strict order (`qps.lexicographic_qp`):

1. the bounds of u, and the stops of joints, which make q̈ piecewise linear in u;
2. the rows, wholly; if no input that the search finds meets them all, those over the horizon are
   dropped, and those over the period ask s⁺ ≥ 0 instead of (1 + β τ) s⁺ ≥ s where s > 0, with the
   least slack. That is all that the next state needs; always asked alone, it makes inputs chatter;
3. the law's objective.

Rows are linear, and large inputs can meet them by motions for which this is wrong. So where there
are rows, no joint may move by more than 0.1 rad or 10 mm in a period, unless it is as fast already.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from softdyn import SoftModel, State
from softdyn.checks import number
from softdyn.controllers.controller import SILENT
from softdyn.controllers.qps.horizon import Horizon
from softdyn.controllers.qps.lexicographic_qp import (
    ENOUGH,
    MET,
    NEGLIGIBLE,
    Conditions,
    LexicographicQp,
    Rows,
)
from softdyn.controllers.qps.qp import QpProblem, QpSolution
from softdyn.controllers.qps.stopped_step import StoppedStep, stops_around
from softdyn.copies import KeepsMaking
from softdyn.description.robot import sliding
from softdyn.dynamics.stops import Stops
from softdyn.safety import obstacles
from softdyn.safety.clearance import CENTIRADIAN, MILLIMETRE, Values
from softdyn.safety.obstacles import RATE, BarrierSet

LOOKAHEAD = 0.02  # s, the horizon of rows where the controller has none
LEAP = 10.0  # of these units, a joint's largest motion in a period
AT_STOP = 0.1  # of these units: a joint this close to its limit is at its stop


def __getattr__(name: str) -> object:
    """The obstacles' former place, which warns."""
    if name not in ("HalfSpace", "KeepOutSphere"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn(f"{name} is now in softdyn.safety", DeprecationWarning, stacklevel=2)
    found: object = getattr(obstacles, name)
    return found


class ControlBarrier(Protocol):
    """An obstacle or a limit."""

    @property
    def rate(self) -> float:
        """α (1/s), the rate at which the controller may approach it."""
        ...

    def __call__(self, state: State) -> Values:
        """Its barriers at this state."""
        ...


class JointLimits(KeepsMaking):
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
    return np.where(sliding(model.robot, model.joint_names), MILLIMETRE, CENTIRADIAN)


class UnsafeStart(UserWarning):
    """A run starts with b < 0 or ḃ + α b < 0."""


class LoadedStop(UserWarning):
    """`JointLimits` guard a joint that no input keeps off its stop, because the stop carries load.

    The controller then gives up its target for limits that it cannot keep.
    """


class BarrierRows:
    """The rows of all barriers; they are hard if an admissible input meets them.

    If no admissible input meets all rows, they are relaxed by the least squares of their excess, in
    mm and 0.01 rad.

    Parameters
    ----------
    model : SoftModel
        The robot.
    barriers : sequence of ControlBarrier
        Obstacles and limits.
    tau : float
        The horizon τ of the rows (s).

    Attributes
    ----------
    outside : int
        Number of states with b < 0 or ḃ + α b < 0 for a barrier, from which there is no guarantee.
    violation : float
        The largest -b at any state, in mm or 0.01 rad; negative if no barrier was violated.
    braked : int
        Number of steps at which the rows over the horizon were dropped.
    relaxed : int
        Number of steps at which rows were relaxed by more than 0.02 of their units.
    relaxation : float
        The largest relaxation, as the mm or 0.01 rad by which b may fall.
    least : int
        Number of steps at which the input of least excess was taken, without the objective.
    """

    def __init__(self, model: SoftModel, barriers: Sequence[ControlBarrier], tau: float) -> None:
        self._model, self._barriers = model, tuple(barriers)
        self._horizon = Horizon(model, tau)
        self._values = BarrierSet(model, self._barriers)
        Stops.of(model).prepare()  # those of a step are solved alike
        self._qp = LexicographicQp(model.u_min, model.u_max)
        eye, self._unit = np.eye(model.nv), np.tile(_joint_units(model), 2)
        self._both, self._none = np.vstack((eye, -eye)), np.zeros(2 * model.nv, bool)
        self.reset()

    def reset(self, period: float = 0.0) -> None:
        """Reset all counts; with a control period (s) every barrier has a row for it too."""
        self.violation, self.relaxed, self.relaxation = -np.inf, 0, 0.0
        self.outside, self.least, self.braked, self._begun = 0, 0, 0, False
        self._loaded = False
        self._period = period
        self._hold = Horizon(self._model, period) if period else None
        self._kinds: np.ndarray | None = None

    def at(self, state: State) -> Rows:
        """Every barrier's rows where no joint is at a stop."""
        values, steps = self._at(state), self._steps(state)
        every = np.arange(len(values.b))
        return Rows.joined([
            self._conditions(values, one, state).rows(one.free, every) for one in steps
        ])  # fmt: skip

    def _at(self, state: State) -> BarrierValues:
        """The values of all barriers; a state without guarantee is counted."""
        (b, G, drift, unit), of = self._values(state)
        if self._kinds is None:
            self._kinds = np.array([
                (one.rate, getattr(one, "recovery", one.rate),
                 one.sampled_margin(self._model, self._period)
                 if hasattr(one, "sampled_margin") else 0.0,
                 isinstance(one, JointLimits)) for one in self._barriers
            ]).T  # fmt: skip
        alpha, beta, margin, limits = self._kinds[:, of]
        values = BarrierValues(alpha, beta, b, G @ state.v, drift, unit, G, limits > 0)
        if len(b):
            self._count(values, of)  # of the barriers themselves
        self._begun = True
        return values._replace(b=b - margin)

    def _steps(self, state: State) -> list[StoppedStep]:
        """The steps τ that have rows; in a run the last is the control period."""
        over = [self._horizon] if self._horizon.tau or self._hold is None else []
        over += [] if self._hold is None else [self._hold]
        stops = None if self._hold is None else stops_around(state)
        return [StoppedStep(state, one.tau, *one(state), stops) for one in over]

    def _count(self, values: BarrierValues, of: np.ndarray) -> None:
        """Count a state without guarantee; warn if a run starts at one."""
        alpha, b, unit, outside = values.alpha, values.b, values.unit, ""
        self.violation = max(self.violation, float((-b / unit).max(initial=-np.inf)))
        s = values.rate + alpha * b
        approach = np.minimum(b, s / alpha) / unit
        if approach.min(initial=0.0) < -NEGLIGIBLE:
            k = approach.argmin()
            name = type(self._barriers[of[k]]).__name__
            outside = f"{name}: b = {b[k]:.3g}, db/dt + {alpha[k]:g} b = {s[k]:.3g}"
        self.outside += bool(outside)
        if outside and not self._begun:
            text = f"the run starts outside the safe set ({outside}; both should be >= 0)"
            warnings.warn(text, UnsafeStart, stacklevel=2)

    def _warn_of_loads(self, values: BarrierValues) -> None:
        """Warn once in a run if rows were relaxed while a joint is at a limit that is a barrier."""
        at = values.limits & (values.b <= AT_STOP * values.unit)
        if self._loaded or not at.any():
            return
        self._loaded = True
        joints = np.abs(values.gradient[at]).argmax(axis=1)
        names = dict.fromkeys(self._model.joint_names[j] for j in joints.tolist())
        text = (
            f"JointLimits: no input keeps {', '.join(names)} off their stops, which carry load; "
            "the target is given up for these limits: leave JointLimits out, the stops hold"
        )
        warnings.warn(text, LoadedStop, stacklevel=2)

    @SILENT
    def enforce(
        self,
        problem: QpProblem,
        solution: QpSolution | None,
        state: State,
    ) -> QpSolution | None:
        """`solution` if it meets every row, else the answer of `problem` with rows.

        The first unknowns of `problem` are u. Stops count in runs only.
        """
        values = self._at(state)
        if solution is None or not solution.solved or not len(values.alpha):
            return solution
        u, running = solution.x[: state.B.shape[1]], self._hold is not None
        steps = self._steps(state)
        every = [self._conditions(values, one, state) for one in steps]
        if all(
            (one.excess(u, *one.step.motion(u, one.step.free)) <= ENOUGH).all() for one in every
        ):
            return solution
        best = self._qp(problem, solution, every, slack=not running)
        if running and best.excess > MET:
            needed = self._conditions(values, steps[-1], state, braking=True)
            best = self._qp(problem, solution, [needed])
            self.braked += 1
        if best.excess > MET:
            self.relaxed, self.relaxation = self.relaxed + 1, max(self.relaxation, best.excess)
            self._warn_of_loads(values)
        self.least += best.least
        return best.solution

    def _conditions(
        self, values: BarrierValues, step: StoppedStep, state: State, *, braking: bool = False
    ) -> Conditions:
        """The conditions of all barriers over a step.

        An excess of its unit lets b decrease by one of the barrier's. Limits of joints keep them
        from their stops, so their conditions are on free joints. Over a period no joint moves by
        more than `LEAP` units, or faster than it does.
        """
        tau, A, free = step.tau, values.gradient, values.limits
        c, unit = values.braking(tau) if braking else values.allowed(tau)
        if self._period and tau == self._period:
            leap, v = self._unit / tau**2, self._both @ (state.v / tau)
            A = np.concatenate((A, self._both))
            c = np.concatenate((c, np.maximum(LEAP * leap, np.abs(v)) + v))
            unit, free = np.concatenate((unit, leap)), np.concatenate((free, self._none))
        return Conditions(step, A, c, unit, free)


class BarrierValues(NamedTuple):
    """Values of all barriers at a state, those of one after those of another.

    Attributes
    ----------
    alpha, beta : ndarray, (p,)
        α and β (1/s).
    b, rate, drift, unit : ndarray, (p,)
        b, ḃ, r and the unit, see `Values`.
    gradient : ndarray, (p, n)
        G.
    limits : ndarray of bool, (p,)
        Whether it is a limit of a joint.
    """

    alpha: np.ndarray
    beta: np.ndarray
    b: np.ndarray
    rate: np.ndarray
    drift: np.ndarray
    unit: np.ndarray
    gradient: np.ndarray
    limits: np.ndarray

    def allowed(self, tau: float) -> tuple[np.ndarray, np.ndarray]:
        """The largest allowed -G q̈ (p,) over a step, and how much of it a unit of b costs (p,)."""
        alpha, beta = self.alpha, self.beta
        share, both = 1 / ((1 + alpha * tau) * (1 + beta * tau)), alpha * beta
        c = share * ((alpha + beta + both * tau) * self.rate + both * self.b)
        return c + self.drift, share * both * self.unit

    def braking(self, tau: float) -> tuple[np.ndarray, np.ndarray]:
        """The same, but where s > 0 only s⁺ ≥ 0 is asked."""
        alpha, (allowed, unit) = self.alpha, self.allowed(tau)
        safe, reach = self.rate + alpha * self.b > 0, alpha / (tau * (1 + alpha * tau))
        allowed = np.where(safe, self.rate / tau + reach * self.b + self.drift, allowed)
        return allowed, np.where(safe, reach * self.unit, unit)
