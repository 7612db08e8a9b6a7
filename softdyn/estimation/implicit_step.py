"""One backward Euler step with joint stops, and its exact Jacobians.

With q⁺ = q ⊕ T v⁺ the step solves

    r(q⁺, v⁺, (v⁺ - v) / T; c, d) = 0

by Newton's method, r from `softdyn.dynamics.balance`. A joint that would leave its limits is
held at the stop, q⁺ = limit, as long as the stop pushes it inward: an active set inside each Newton
step.
With A = M / T + ∂r/∂v + T ∂r/∂q, the free joints have

    ∂v⁺/∂v = A⁻¹ M / T,   ∂v⁺/∂q = -A⁻¹ ∂r/∂q,   ∂v⁺/∂d = -A⁻¹ ∂r/∂d,

and A⁻¹ maps a joint force to v⁺. A held joint has ∂v⁺/∂q = -1 / T and no other derivative.

The first Newton step takes r and its Jacobians from the linear model at the end of the step before,
if that leads to a solution.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softdyn.compiled import compiled
from softdyn.dynamics.balance import BalanceTerms, Disturbance, ForceBalance
from softdyn.dynamics.model import SoftModel

NEAR = 1e-10  # rad, m: the last Newton step is smaller; the Jacobians are of its begin
MOST = 12  # Newton steps
ROUNDED, RIDGE = 1e-12, 1e-12  # rad or m; share of a variance
ROUNDS = 20  # changes of the active set in a Newton step


class ImplicitStepResult(NamedTuple):
    """A step and its derivatives; the step after the next one overwrites the arrays.

    Attributes
    ----------
    q, v : ndarray, (nq,), (n,)
        The state after it.
    by_state : ndarray, (n, 2n + nd)
        ∂v⁺ by q, v and d.
    by_force : ndarray, (n, n)
        ∂v⁺ by a joint force that acts during the step.
    held : ndarray of int, (n,)
        1 for a joint at its upper stop, -1 at the lower one, 0 for a free joint.
    inputs : ndarray, (m,)
        The inputs u at its end.
    """

    q: np.ndarray
    v: np.ndarray
    by_state: np.ndarray
    by_force: np.ndarray
    held: np.ndarray
    inputs: np.ndarray


class ImplicitStep:
    """Backward Euler steps of a robot.

    Parameters
    ----------
    model : SoftModel
        The robot's model, without a floating base.
    disturbances : tuple of Disturbance
        The disturbances, in the order of d.
    """

    def __init__(self, model: SoftModel, disturbances: tuple[Disturbance, ...] = ()) -> None:
        self._model, self._balance = model, ForceBalance(model, disturbances)
        self._limits = np.column_stack((model.lower, model.upper))
        self._plain = model.nq == model.nv
        n, disturbed = model.nv, sum(one.size(model) for one in disturbances)
        self._found, self._before = (
            ImplicitStepResult(
                np.empty(model.nq), np.empty(n), np.empty((n, 2 * n + disturbed)),
                np.empty((n, n)), np.empty(n, np.int64), np.empty(model.nu),
            ) for _ in range(2)
        )  # fmt: skip
        self._acceleration = np.empty(n)
        self._terms: BalanceTerms | None = None  # the last balance, if the step had a solution
        self._last = np.empty(3 * n + model.nu + disturbed)  # its arguments

    def forget(self) -> None:
        """The next step does not begin on the linear model of the last one."""
        self._terms = None

    def __call__(
        self,
        q: np.ndarray,
        v: np.ndarray,
        commands: np.ndarray,
        d: np.ndarray,
        step: float,
        held: np.ndarray,
    ) -> ImplicitStepResult | None:
        """The state after a step; None if the iteration does not converge.

        Parameters
        ----------
        q, v : ndarray, (nq,), (n,)
            State.
        commands : ndarray, (m,)
            Constant inputs; for a winch the free length of its cable.
        d : ndarray, (nd,)
            Disturbances.
        step : float
            T (s).
        held : ndarray of int, (n,)
            The stops that held in the last step, a first guess.
        """
        self._found, self._before = self._before, self._found
        given, terms = (q, v, commands, d, step, held), self._terms
        self._terms = None
        if self._solve(*given, terms) or (terms and self._solve(*given, None)):
            return self._found
        return None

    def _solve(
        self,
        q: np.ndarray,
        v: np.ndarray,
        commands: np.ndarray,
        d: np.ndarray,
        step: float,
        held: np.ndarray,
        terms: BalanceTerms | None,
    ) -> bool:
        """Newton's method into `_found`, its first step on the linear model of these terms."""
        model, balance = self._model, self._balance
        plain = self._plain
        acceleration = self._acceleration
        there, speed, by_state, by_force, found_held, inputs = self._found
        acceleration[:], speed[:], found_held[:] = 0.0, v, held
        there[:] = q + step * v if plain else model.integrate(q, step * v)
        for _ in range(MOST):
            at = there if plain else model.coordinates(there)
            moved = speed, there, acceleration, q, v, at, self._limits, found_held, step
            try:
                if terms is not None:
                    _linear_newton(*moved, self._last, commands, d, *terms[:6])
                    terms = None
                    continue
                found = balance.trusted(there, speed, acceleration, commands, d)
                size = _newton(*moved, *found[:4])
            except np.linalg.LinAlgError:  # singular, or not finite
                return False
            if not plain:
                there[:] = model.integrate(q, step * speed)
            if size < NEAR:
                _, by_q, by_v, by_a, _, by_d, inputs[:] = found
                _derivatives(by_state, by_force, by_q, by_v, by_a, by_d, found_held, step)
                if plain:
                    np.concatenate((there, speed, acceleration, commands, d), out=self._last)
                    self._terms = found
                return True
        return False


def onto_stops(model: SoftModel, at: np.ndarray, asked: np.ndarray, P: np.ndarray) -> np.ndarray:
    """The correction (s,) that ends within the joint limits, nearest to `asked` in P⁻¹.

    It is the projection of Simon and Chia (2002). To clip each joint alone would leave the others
    where they fit a shape that the robot cannot have.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    at : ndarray, (n,)
        Joint coordinates that it corrects.
    asked : ndarray, (s,)
        A correction, of q first.
    P : ndarray, (s, s)
        Covariance of the errors.
    """
    n, change = model.nv, asked
    if _within(at, change, model.lower, model.upper):
        return change
    held = np.zeros(n, bool)
    for _ in range(n):
        there = at + change[:n]
        beyond = (there > model.upper + ROUNDED) | (there < model.lower - ROUNDED)
        beyond &= np.diag(P)[:n] > 0
        if not (beyond & ~held).any():
            break
        held |= beyond
        k = np.flatnonzero(held)
        wanted = at[k] + asked[k]
        target = np.clip(wanted, model.lower[k], model.upper[k]) - wanted
        variances = P[np.ix_(k, k)] + np.diag(RIDGE * np.diag(P)[k])
        change = asked + P[:, k] @ np.linalg.solve(variances, target)
    change[:n] = np.clip(at + change[:n], model.lower, model.upper) - at  # what rounding left
    return change


@compiled
def _within(at, change, lower, upper):
    outside = 0
    for i in range(len(at)):
        outside += not lower[i] <= at[i] + change[i] <= upper[i]
    return outside == 0


@compiled
def _linear_newton(
    speed, there, acceleration, q, v, at, limits, held, step, last, commands, d, residual, by_q,
    by_v, by_a, by_commands, by_d,
):  # fmt: skip
    """`_newton` on the linear model of the balance at the arguments `last`, where it is zero."""
    n, m = len(v), len(commands)
    for i in range(n):
        residual[i] = 0.0
        for j in range(n):
            residual[i] += by_q[i, j] * (there[j] - last[j]) + by_v[i, j] * (speed[j] - last[n + j])
            residual[i] += by_a[i, j] * (acceleration[j] - last[2 * n + j])
        for j in range(m):
            residual[i] += by_commands[i, j] * (commands[j] - last[3 * n + j])
        for j in range(len(d)):
            residual[i] += by_d[i, j] * (d[j] - last[3 * n + m + j])
    _newton(speed, there, acceleration, q, v, at, limits, held, step, residual, by_q, by_v, by_a)


@compiled
def _newton(
    speed, there, acceleration, q, v, at, limits, held, step, residual, by_q, by_v, by_a
):  # fmt: skip
    """One Newton step of v⁺ in place, and of q⁺ without continuous joints; its size (rad, m)."""
    change = _newton_step(residual, by_q, by_v, by_a, at, limits, held, step)
    size, plain = 0.0, len(q) == len(v)
    for i in range(len(v)):
        size = max(size, step * abs(change[i]))
        speed[i] += change[i]
        acceleration[i] = (speed[i] - v[i]) / step
        if plain:
            there[i] = q[i] + step * speed[i]
    return size


@compiled
def _newton_step(residual, by_q, by_v, by_a, at, limits, held, step):
    """The change of v⁺ (n,); updates `held`."""
    n = len(residual)
    A, change = _matrix(by_q, by_v, by_a, step), np.empty(n)
    for _ in range(ROUNDS):
        rows = _held_rows(A, held)
        for i in range(n):
            if held[i] == 0:
                change[i] = -residual[i]
            else:
                change[i] = (limits[i, (held[i] + 1) // 2] - at[i]) / step
        change = np.linalg.solve(rows, change)
        if not _changed(A, residual, change, at, limits, held, step):
            break
    return change


@compiled
def _matrix(by_q, by_v, by_a, step):
    n = len(by_q)
    A = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            A[i, j] = by_a[i, j] / step + by_v[i, j] + step * by_q[i, j]
    return A


@compiled
def _held_rows(A, held):
    """A with the identity's rows for joints that are held."""
    n, rows = len(A), A.copy()
    for i in range(n):
        if held[i] != 0:
            for j in range(n):
                rows[i, j] = 1.0 if i == j else 0.0
    return rows


@compiled
def _derivatives(by_state, by_force, by_q, by_v, by_a, by_d, held, step):
    """Fill in ∂v⁺ by the state (n, 2n + nd), and by a joint force (n, n)."""
    n, nd = len(by_q), by_d.shape[1]
    inverse = np.linalg.inv(_held_rows(_matrix(by_q, by_v, by_a, step), held))
    right = np.zeros((n, 2 * n + nd))
    for i in range(n):
        if held[i] != 0:
            right[i, i] = -1.0 / step
            continue
        for j in range(n):
            right[i, j] = -by_q[i, j]
            right[i, n + j] = by_a[i, j] / step
        for j in range(nd):
            right[i, 2 * n + j] = -by_d[i, j]
    by_state[:] = np.dot(inverse, right)
    for j in range(n):
        for i in range(n):
            by_force[i, j] = 0.0 if held[j] != 0 else inverse[i, j]


@compiled
def _changed(A, residual, change, at, limits, held, step):
    """Hold joints that leave their limits; else release those that are pulled outward."""
    n, changed = len(A), False
    for i in range(n):
        there = at[i] + step * change[i]
        if held[i] == 0 and (there > limits[i, 1] or there < limits[i, 0]):
            held[i] = 1 if there > limits[i, 1] else -1
            changed = True
    if changed:
        return True
    for i in range(n):
        if held[i] != 0:
            push = residual[i]  # the force of the stop
            for j in range(n):
                push += A[i, j] * change[j]
            if push * held[i] > 0:
                held[i] = 0
                changed = True
    return changed
