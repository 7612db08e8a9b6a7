"""The motion of a robot over a period under a constant input, with its exact Jacobians.

`discrete_step` takes steps of backward Euler (`softdyn.dynamics.implicit_step`), one if that has a
solution, else shorter ones. With x = (q, v) and the Jacobians A_k, B_k of each step, the chain rule
gives those of the period:

    A ← A_k A,    B ← A_k B + B_k.

With motors, x has their states w, too (`softdyn.dynamics.motors`). In a step the robot feels the
mean of the values that act, ū(w, u). With the robot's A_r and B_r,

    A_k = [[A_r, B_r ∂ū/∂w], [0, ∂w⁺/∂w]],    B_k = [B_r ∂ū/∂u; ∂w⁺/∂u].

Parameters θ change the balance r at the end of a step, so that ∂v⁺/∂θ = -A⁻¹ ∂r/∂θ, with the A⁻¹ of
the step. Over the period they follow the rule of B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from softdyn.checks import array, flag, instance, number, vector
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.derivatives import parameter_columns
from softdyn.dynamics.implicit_step import (
    ImplicitStep,
    ImplicitStepResult,
    ends_by,
    linearised,
    newton_matrix,
)
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.motors import Motors
from softdyn.dynamics.stops import Stops
from softdyn.exceptions import InputError, SoftdynError

if TYPE_CHECKING:
    import softdyn

SHORTEST = 2**20  # sub-steps in a period; where a shorter one is needed, there is no motion to find
ACCURACY = 1e-9  # rad, m: what is left of the forces moves no joint farther within a sub-step


class StepError(SoftdynError, ArithmeticError):
    """A step without a solution, even in 2⁻²⁰ of its period.

    Attributes
    ----------
    q, v, u : ndarray, (nq,), (n,), (m,)
        The state from which it did not go on, and the input.
    residual : ndarray, (n,)
        The joint forces out of balance there (N m, N), if no joint accelerates.
    """

    def __init__(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, residual: np.ndarray, step: float
    ) -> None:
        self.q, self.v, self.u, self.residual, self.step = q, v, u, residual, step
        largest = np.abs(residual).max(initial=0.0)
        super().__init__(
            f"no solution of a step of {step:.3g} s: joint forces of up to {largest:.3g} out of "
            "balance; give a shorter period or smaller speeds"
        )

    def __reduce__(self) -> tuple[Any, ...]:  # crosses process boundaries
        return type(self), (self.q, self.v, self.u, self.residual, self.step)


@dataclass(frozen=True, eq=False)
class DiscreteStep:
    """The state after a period and its Jacobians, along the velocity coordinates: q ⊕ dq.

    Attributes
    ----------
    q, v : ndarray, (nq,), (n,)
        The state (rad, m; (cos, sin) of a continuous joint; per second).
    A : ndarray, (2n, 2n)
        ∂(q, v)⁺ by (q, v); with motors (2n + k, 2n + k), of (q, v, acting).
    B : ndarray, (2n, m)
        ∂(q, v)⁺ by u; with motors (2n + k, m).
    held : ndarray of int, (n,)
        1 for a joint at its upper stop at the end, -1 at the lower one, 0 for a free joint.
    substeps : int
        The number of steps that it took, 1 if the first one had a solution.
    acting : ndarray, (k,)
        The motors' states after the period; (0,) without motors.
    parameters : ndarray, (2n, p)
        ∂(q, v)⁺ by the parameters of a robot's identification; p is 0 without them.
    """

    q: np.ndarray
    v: np.ndarray
    A: np.ndarray
    B: np.ndarray
    held: np.ndarray
    substeps: int
    acting: np.ndarray = field(default_factory=lambda: np.zeros(0))
    parameters: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def discrete_step(
    model: SoftModel,
    q: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    period: float,
    stops: bool = True,
    *,
    winches: bool = False,
    motors: bool = False,
    acting: np.ndarray | None = None,
    parameters: Sequence[softdyn.identification.Parameter] = (),
) -> DiscreteStep:
    """The state after a period under a constant input, by backward Euler, with exact Jacobians.

    Each sub-step's solution is checked: what is left of its forces would move no free joint by
    1e-9 rad or m, no stop pulls, and no joint is beyond its limits. Where there is none, the
    sub-step is halved. The Jacobians are those of the sub-steps taken. They are one-sided where a
    small change would let a joint meet or leave its stop, or a cable become slack.

    Parameters
    ----------
    model : SoftModel
        Any robot's model.
    q, v : array_like, (nq,), (n,)
        Configuration and velocity. A joint that begins beyond a limit ends at it.
    u : array_like, (m,)
        Input during the period.
    period : float
        Its length (s).
    stops : bool
        Whether joints stop at their limits.
    winches : bool
        Whether `u` are commands of the file's motors, for a winch the free length of its cable less
        the motor's offset, as `softdyn.actuation.Winches` gives them.
    motors : bool
        Whether `u` are commands of the file's motors, whose states join (q, v): the values that act
        (m,), of u or of free lengths less their offsets. They follow the commands with the file's
        lags and bounded rates, and winches that command a speed integrate it. Motors have further
        states where `softdyn.dynamics.motors` says so. A delay is the caller's: it chooses the
        command that has arrived.
    acting : array_like, (k,), optional
        The motors' states at the begin, as the last step's `acting`. By default `u` has acted for
        long, and the cable of a winch that commands a speed is just slack.
    parameters : sequence of softdyn.identification.Parameter
        As in `acceleration_derivatives`, with its errors.

    Raises
    ------
    InputError
        For a wrong shape, a number that is not finite, a period that is not above zero, motors'
        states without motors, or parameters beside winches or motors.
    StepError
        Without a solution in 2⁻²⁰ of the period.
    """
    n = check_model(model).nv
    q, v = array("q", q, (model.nq,)), vector("v", v, n)
    u, period = vector("u", u, model.nu), number("period", period, above=0.0)
    stops = instance("stops", stops, bool, "True or False")
    model.coordinates(model.integrate(q, np.zeros(n)))  # refuses (cos, sin) off the unit circle
    flag("winches", winches)
    drives = Motors(model) if flag("motors", motors) else None
    w = np.zeros(0)
    if drives is not None:
        w = drives.settled(q, v, u) if acting is None else vector("acting", acting, drives.size)
    elif acting is not None:
        raise InputError("acting", "none without motors=True", repr(acting))
    if len(parameters) and (winches or motors):
        raise InputError("parameters", "none with winches or motors", repr(parameters))
    balance = ForceBalance(model, motors=None if winches or motors else ())
    steps = _CheckedSteps(
        model, balance, Stops.of(model) if stops else Stops.none(model), parameters
    )
    A, B = np.eye(2 * n + len(w)), np.zeros((2 * n + len(w), model.nu))
    by_theta = np.zeros((2 * n, len(parameters)))
    held = np.zeros(n, np.int64)
    done, part, count = 0, SHORTEST, 0  # in 2⁻²⁰ of the period
    with np.errstate(all="ignore"):  # a step that overflows has no solution
        while done < SHORTEST:
            h = period * (part / SHORTEST)
            span = None if drives is None else drives.over(w, u, h)
            felt = u if span is None else span.mean
            found = steps(q, v, felt, h, held)
            if found is None:
                if part == 1:
                    raise StepError(q, v, felt, balance(q, v, np.zeros(n), felt).residual, h)
                part //= 2
                continue
            q, v, held, one, other, own = found
            if span is not None:
                w = span.after
                one, other = (
                    np.vstack((np.hstack((one, other @ span.mean_by_state)),
                               np.hstack((np.zeros((len(w), 2 * n)), span.after_by_state)))),
                    np.vstack((other @ span.mean_by_command, span.after_by_command)),
                )  # fmt: skip
            A, B = one @ A, one @ B + other
            by_theta = one[: 2 * n, : 2 * n] @ by_theta + own
            done, count = done + part, count + 1
            if part < SHORTEST and done % (2 * part) == 0:  # the next one may be longer again
                part *= 2
    return DiscreteStep(q, v, A, B, held, count, w, by_theta)


class _CheckedSteps:
    """Steps of backward Euler whose solutions are checked."""

    def __init__(
        self,
        model: SoftModel,
        balance: ForceBalance,
        stops: Stops,
        parameters: Sequence[softdyn.identification.Parameter],
    ) -> None:
        self._model, self._balance, self._stops = model, balance, stops
        self._parameters = parameters
        self._step = ImplicitStep(model, balance, stops)

    def __call__(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float, held: np.ndarray
    ) -> tuple[np.ndarray, ...] | None:
        """q⁺, v⁺, the held joints, A, B and ∂(q, v)⁺/∂θ; None without a solution."""
        model, n, none = self._model, self._model.nv, np.zeros(0)
        found = self._step(q, v, u, none, h, held)
        if found is None:
            return None
        ends = ends_by(model, q, h * found.v)
        terms = self._balance.trusted(found.q, found.v, (found.v - v) / h, u, none)
        matrix = newton_matrix(terms, h, ends)
        try:
            step = linearised(found.q, found.v, terms, matrix, h, found.held, ends)
        except np.linalg.LinAlgError:
            return None
        if not self._solved(step, terms.residual, np.abs(matrix), h):
            return None
        by_theta = parameter_columns(self._parameters, model, step.q, step.v, (step.v - v) / h, u)
        speeds = step.by_state, -step.by_force @ terms.by_commands, -step.by_force @ by_theta
        A, B, C = (np.vstack((h * by, by)) for by in speeds)
        if ends is not None:
            A[:n], B[:n], C[:n] = ends[1] @ A[:n], ends[1] @ B[:n], ends[1] @ C[:n]
        A[:n, :n] += np.eye(n) if ends is None else ends[0]
        return (step.q, step.v, step.held, A, B, C) if np.isfinite(A).all() else None

    def _solved(self, step: ImplicitStepResult, r: np.ndarray, A: np.ndarray, h: float) -> bool:
        """Whether balance and complementarity of stops hold at a step's end."""
        at, held = self._model.coordinates(step.q), step.held
        beyond = at - self._stops.within(at)
        pull = r * held - ACCURACY / h * A.diagonal()  # a stop that pulls
        return bool(
            (h * np.abs(step.by_force @ r) <= ACCURACY).all()
            and (pull <= 0)[held != 0].all()
            and (np.abs(beyond) <= ACCURACY).all()
        )
