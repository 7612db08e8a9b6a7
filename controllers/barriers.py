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

Stops of joints make q̈ piecewise linear in u (`qps.stopped_step`). An input has to meet the rows of
the motion that it leads to. So rows that an answer breaks, in its own motion, are added to the QP,
until an answer breaks none.

If no admissible input meets the rows, they are relaxed. Then (1 + β τ) s⁺ ≥ s may not hold where
s > 0, but the guarantee needs s⁺ ≥ 0 only: the step is counted in `braked`. It is counted in
`relaxed` if s⁺ < 0 for a barrier. Rows are linear, and large inputs can meet them by motions for
which this is wrong. So beside rows, no joint may move by more than 0.1 rad or 10 mm in a period,
unless it is as fast already.
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
from softdyn.controllers.qps.qp import QpProblem, QpSolution
from softdyn.controllers.qps.relaxed_rows import ROOM, RelaxedRows, Rows
from softdyn.controllers.qps.stopped_step import StoppedStep
from softdyn.description.robot import sliding
from softdyn.dynamics.stops import Stops
from softdyn.safety.clearance import CENTIRADIAN, MILLIMETRE, Values
from softdyn.safety.obstacles import RATE
from softdyn.safety.obstacles import HalfSpace as HalfSpace
from softdyn.safety.obstacles import KeepOutSphere as KeepOutSphere

LEAP = 10.0  # of these units, a joint's largest motion in a period
NEGLIGIBLE = 1e-6  # of a row's unit
ROUNDS = 8  # largest number of answers that are looked at in a step


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
    return np.where(sliding(model.robot, model.joint_names), MILLIMETRE, CENTIRADIAN)


class UnsafeStart(UserWarning):
    """A run starts with b < 0 or ḃ + α b < 0."""


class BarrierRows:
    """The rows of all barriers; they are hard if an admissible input meets them.

    The priorities are: the input bounds, then the rows, then the objective. If no admissible input
    meets all rows, they are relaxed by the least squares of their excess, in mm and 0.01 rad; see
    `softdyn.controllers.qps.relaxed_rows`.

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
    braked : int
        Number of steps at which rows were relaxed, but b and ḃ + α b stay non-negative.
    relaxed : int
        Number of steps at which rows were relaxed further, by more than 0.02 of their units.
    relaxation : float
        The largest relaxation, as the mm or 0.01 rad by which b may fall.
    """

    def __init__(self, model: SoftModel, barriers: Sequence[ControlBarrier], tau: float) -> None:
        self._model, self._barriers, self._tau = model, tuple(barriers), tau
        self._qp, self._stops = RelaxedRows(model.u_min, model.u_max), Stops.of(model)
        self._leap = LEAP * _joint_units(model)
        self.reset()

    def reset(self, period: float = 0.0) -> None:
        """Reset all counts; with a control period (s) every barrier has a row for it too."""
        self.violation, self.relaxed, self.relaxation = -np.inf, 0, 0.0
        self.outside, self.braked, self._begun = 0, 0, False
        self._period = period
        self._hold = Horizon(self._model, period) if period else None

    def at(self, state: State, M: np.ndarray, h: np.ndarray) -> Rows:
        """Every barrier's rows where no joint is at a stop; M and h are those over the horizon."""
        found = self._found(state)
        return Rows.joined([found.rows(step, step.free) for step in self._steps(state, M, h)])

    def _found(self, state: State) -> AllValues:
        """The values of every barrier; states without guarantee are counted."""
        parts = []
        for one in self._barriers:
            values, kept = one(state), getattr(one, "kept", None)
            kept = 0.0 if kept is None else kept(self._model, self._period)
            own = one.rate, getattr(one, "recovery", one.rate), kept, isinstance(one, JointLimits)
            parts.append((*values, *(np.full(len(values.b), value) for value in own)))
        b, G, drift, unit, alpha, beta, kept, limits = map(np.concatenate, zip(*parts, strict=True))
        rate = G @ state.v
        self._count(parts, b, rate + alpha * b)
        return AllValues(b - kept, G, drift, unit, rate, alpha, beta, limits)

    def _count(self, parts: Sequence[tuple[np.ndarray, ...]], b: np.ndarray, s: np.ndarray) -> None:
        """Count a state without guarantee; warn if a run starts at one."""
        alpha, unit = (np.concatenate([part[k] for part in parts]) for k in (4, 3))
        self.violation = max(self.violation, float((-b / unit).max(initial=-np.inf)))
        approach = np.minimum(b, s / alpha) / unit
        outside = bool(approach.min(initial=0.0) < -NEGLIGIBLE)
        self.outside += outside
        if outside and not self._begun:
            k = int(approach.argmin())
            whose = np.searchsorted(np.cumsum([len(part[0]) for part in parts]), k, "right")
            text = (
                f"the run starts outside the safe set ({type(self._barriers[whose]).__name__}: "
                f"b = {b[k]:.3g}, db/dt + {alpha[k]:g} b = {s[k]:.3g}; both should be >= 0)"
            )
            warnings.warn(text, UnsafeStart, stacklevel=2)
        self._begun = True

    def _steps(self, state: State, M: np.ndarray, h: np.ndarray) -> list[StoppedStep]:
        """The steps τ that have rows; in a run the last is the control period."""
        if self._hold is None:
            return [StoppedStep(state, self._tau, M, h)]
        steps = [(self._tau, M, h)] if self._tau else []
        steps.append((self._period, *self._hold(state)))
        return [StoppedStep(state, *step, self._stops) for step in steps]

    def _rows(
        self, found: AllValues, steps: Sequence[StoppedStep], held: Sequence[np.ndarray]
    ) -> Rows:
        """The rows of all steps; in a run the period's and its joints' motion come last."""
        parts = [found.rows(*one) for one in zip(steps, held, strict=True)]
        if self._hold is not None:
            parts += steps[-1].motion_within(self._leap, held[-1], self._leap / LEAP)
        return Rows.joined(parts)

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

        The first unknowns of `problem` are u. Stops count in runs only.

        Few rows ever matter. So a round adds those that the last answer breaks, in the motion that
        it leads to, to the rows of earlier rounds.
        """
        found = self._found(state)
        if solution is None or not solution.solved or not len(found.b):
            return solution
        steps, wanted = self._steps(state, M, h), solution.x[: state.B.shape[1]]
        held, chosen, relaxed = [step.free for step in steps], dict[bytes, Chosen](), False
        answer, best, excess = solution, solution, np.full(1, np.inf)
        for _ in range(ROUNDS):
            u = answer.x[: len(wanted)]
            held = [step.held(u, guess) for step, guess in zip(steps, held, strict=True)]
            rows = self._rows(found, steps, held)
            own = np.maximum(rows.excess(u), 0.0)
            if own @ own < excess @ excess:
                best, excess = answer, own
            motion = np.concatenate(held).tobytes()
            _, before = chosen.get(motion, (rows, np.zeros(len(own), bool)))
            broken = own > ROOM + 2 * NEGLIGIBLE
            if not (broken & ~before).any():
                break
            chosen[motion] = rows, broken | before
            parts = [rows.where(of_these) for rows, of_these in chosen.values()]
            answer, relaxed = self._qp(problem, wanted, Rows.joined(parts), relaxed)
        if excess.max() > 2 * ROOM:
            first = (len(steps) - 1) * len(found.b)
            last = excess[first : first + len(found.b)]
            lack = float(found.lack(last, self._period).max())
            if lack <= 2 * ROOM:
                self.braked += 1
            else:
                self.relaxed, self.relaxation = self.relaxed + 1, max(self.relaxation, lack)
        return best


Chosen = tuple[Rows, np.ndarray]  # the rows of a motion, and which of them (p,) are in the QP


class AllValues(NamedTuple):
    """The values of all barriers at a state, in its motion.

    Attributes
    ----------
    b, gradient, drift, unit
        As in `Values`; b is less the distance that rows keep.
    rate : ndarray, (p,)
        ḃ.
    alpha, beta : ndarray, (p,)
        The rates α, β (1/s) of their barriers.
    limits : ndarray, (p,)
        Whether they are limits of joints.
    """

    b: np.ndarray
    gradient: np.ndarray
    drift: np.ndarray
    unit: np.ndarray
    rate: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    limits: np.ndarray

    def rows(self, step: StoppedStep, held: np.ndarray) -> Rows:
        """A row for every value over a step in which stops hold joints (n,).

        An excess of its unit lets b decrease by one of the barrier's. Limits of joints keep them
        from their stops, so their rows are those of free joints.
        """
        alpha, beta, tau, G = self.alpha, self.beta, step.tau, self.gradient
        share, both = 1 / ((1 + alpha * tau) * (1 + beta * tau)), alpha * beta
        affordable = share * ((alpha + beta + both * tau) * self.rate + both * self.b)
        response = G @ step.response(held)
        if held.any() and self.limits.any():
            response[self.limits] = G[self.limits] @ step.response(step.free)
        upper = affordable + self.drift + response[:, -1]
        return Rows(-response[:, :-1], upper, share * both * self.unit)

    def lack(self, excess: np.ndarray, period: float) -> np.ndarray:
        """How far ḃ + α b falls below zero after a period, over α and in units.

        A row of excess e leads to (1 + β T) s⁺ = s - T α β e, e in units. If s < 0 already, the
        lack is that from s / (1 + β T). Without a period it is the excess itself.

        Parameters
        ----------
        excess : ndarray, (p,)
            Excess of the period's rows.
        period : float
            T (s).
        """
        if not period:
            return excess
        Tb, spare = period * self.beta, self.rate / self.alpha + self.b
        lack: np.ndarray = Tb * excess - np.maximum(spare, 0.0) / self.unit
        return lack / (1 + Tb)
