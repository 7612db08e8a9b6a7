"""The linear prediction model of the predictive controller, and its condensed QP.

About the present (q₀, q̇₀) and the input a₀ that acts, with p = q ⊖ q₀ (`docs/beyond.md`),

    M q̈ = f - D_t q̇ - K_t p + B (a - a₀),      f = B a₀ - h + D_t q̇₀ + d,

is integrated by the two-stage, second-order, L-stable SDIRK method (Alexander 1977). Its stages
share one matrix S = M + g D_t + g² K_t, g = (1 - 1/√2) Δt. With x = (p, q̇) and
Q = S⁻¹ [-g K_t, M], an implicit Euler step of length g without force is Z x = (p + g Q x, Q x).
A step of the method without force is

    Φ = (1 + √2) Z² - √2 Z.

The model does not change over the horizon, and three things follow:

- The response to an input in the first step, shifted, is the response to it in every later one.
- The changes x_(k+1) - x_k of the free motion follow Φ like such a response.
- An input that is piecewise linear is a sum of ramps that begin at the knots. All their responses
  are one response, shifted, so that their inner products need only the steps after the later begin.

It all happens in the coordinates z = metric · p, in which the weighted speeds are speeds.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from softdyn import State
from softdyn.compiled import compiled, compiled_or
from softdyn.controllers.qps.linear_algebra import dot, multiply, solve_rows

ROOT = 2.0**0.5
STAGE = 1.0 - 1.0 / ROOT
RIDGE = 1e-10  # of the mean diagonal of H, added to it


class Lookahead:
    """The steps that a prediction looks ahead, and the metric of the speeds.

    Parameters
    ----------
    knots : tuple of int
        Steps at whose ends the input is an unknown; the last one is their number N. The input runs
        straight from knot to knot, from w = 0 before the first step.
    step : float
        Δt (s).
    metric : ndarray, (n, n)
        Regular; the objective has ‖metric q̇‖².
    """

    def __init__(self, knots: tuple[int, ...], step: float, metric: np.ndarray) -> None:
        self.count, self.step = knots[-1], step
        self.begins = np.array((0, *knots))  # of the pieces, and the end
        self.metric, self.inverse = metric, np.linalg.inv(metric)
        rates = (np.eye(len(knots)) - np.eye(len(knots), k=-1)) / np.diff(self.begins)[:, None]
        self.bends = np.diff(rates, axis=0, prepend=0.0)  # changes of slope at begins, by knots


def condensed_qp(
    linear: tuple[np.ndarray, ...],
    force: np.ndarray,
    start: tuple[np.ndarray, np.ndarray],
    rows: np.ndarray,
    error: np.ndarray,
    pace: np.ndarray,
    lookahead: Lookahead,
    inputs: np.ndarray,
    offset: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Objective ½ xᵀHx + gᵀx + c over the inputs at the knots, x (knots m,) relative to a₀.

    It is Σ_k ‖error_k + rows p_k‖² + ‖metric q̇_k - pace_k‖² + xᵀ inputs x + 2 offsetᵀ x.

    Parameters
    ----------
    linear : (ndarray, ndarray, ndarray, ndarray)
        M, K_t, D_t (n, n), and B (n, m).
    force : ndarray, (n,)
        The force f at the point of linearisation.
    start : (ndarray, ndarray)
        The first p and q̇ (n,).
    rows : ndarray, (r, n)
        Outputs by p.
    error : ndarray, (N, r)
        Outputs' errors at p = 0.
    pace : ndarray, (N, n)
        Wanted metric q̇.
    lookahead : Lookahead
        The steps and the metric.
    inputs, offset : ndarray, (knots m, knots m), (knots m,)
        Costs of the inputs.
    """
    M, K, D, B = linear
    x = np.concatenate([lookahead.metric @ value for value in start])
    data = M, K, D, np.column_stack((force, B)), x, lookahead.inverse.T @ rows.T
    ramps, free, c = _ramp_products(
        *data, error, pace, lookahead.step, lookahead.metric, lookahead.inverse, lookahead.begins
    )
    # the inputs at the knots from the ramps that begin at the pieces
    bends, size = lookahead.bends.T, len(free)
    count, pieces = bends.shape
    m = size // pieces
    half = (bends @ ramps.reshape(pieces, m * size)).reshape(count * m, pieces, m)
    H = 2.0 * ((bends @ half).reshape(count * m, count * m) + inputs)
    H.flat[:: len(H) + 1] += RIDGE * np.trace(H) / len(H)
    return H, 2.0 * ((bends @ free.reshape(pieces, m)).ravel() + offset), c


def _by_products(M, K, D, forces, x, outputs, error, pace, step, metric, inverse, begins):
    """Stack all outputs of all ramps, in NumPy."""
    n, m, count, g = len(M), forces.shape[1] - 1, len(error), STAGE * step
    into = np.linalg.inv(M + g * D + g * g * K)
    Q, force = metric @ into @ np.hstack((-g * K @ inverse, M @ inverse)), metric @ into @ forces
    euler = np.vstack((g * Q, Q)) + np.diag(np.arange(2 * n) < n)
    method = (1 + ROOT) * euler @ euler - ROOT * euler
    later = (1 + ROOT) * (g * Q[:, :n] + Q[:, n:]) @ force
    speed = g * (force + later)
    first = np.vstack((g * (g * (1 + ROOT) * force + speed), speed))
    first[:, 0] += method @ x - x
    moves = [first]
    for _ in range(count - 1):
        moves.append(method @ moves[-1])
    y = np.stack([np.vstack((outputs.T @ z[:n], z[n:])) for z in moves])  # (N, r + n, 1 + m)
    sums = y.cumsum(axis=0)
    ramp = (sums - y / 2).cumsum(axis=0)[..., 1:]
    free = sums[..., 0] + np.concatenate((outputs.T @ x[:n], x[n:]))
    free += np.hstack((error, -pace))
    stacked = np.zeros((count, y.shape[1], len(begins) - 1, m))
    for i, begin in enumerate(begins[:-1]):
        stacked[begin:, :, i] = ramp[: count - begin]
    rows = stacked.reshape(free.size, -1)
    return rows.T @ rows, rows.T @ free.ravel(), float(np.sum(free * free))


@compiled_or(_by_products, reorder=True)
def _ramp_products(M, K, D, forces, x, outputs, error, pace, step, metric, inverse, begins):
    """Products of the outputs of all ramps (pieces m)², with the free ones, and of these."""
    n, m = len(M), forces.shape[1] - 1
    method, first = _method(M, K, D, forces, STAGE * step, metric, inverse)
    for j in range(2 * n):
        change = -x[j]
        for i in range(2 * n):
            change += x[i] * method[i, j]
        first[0, j] += change
    responses = np.empty((1 + m, len(error) * (outputs.shape[1] + n)))
    _respond(method, first, outputs, x, error, pace, responses)
    return _products(responses, begins, outputs.shape[1] + n)


@compiled
def _method(M, K, D, forces, g, metric, inverse):
    """Φᵀ (2n, 2n), and the first responses (c, 2n) to constant `forces` (n, c), in z and ż."""
    n, c = forces.shape
    sides, turned = np.empty((2 * n, n)), np.empty((2 * n, n))
    system = np.empty((n, 3 * n + c))
    for i in range(n):
        for j in range(n):
            system[i, j] = M[i, j] + g * D[i, j] + g * g * K[i, j]
            sides[i, j] = -g * K[i, j]
            sides[n + i, j] = M[i, j]
    multiply(sides, inverse, turned)
    for i in range(n):
        for j in range(n):
            system[i, n + j] = turned[i, j]
            system[i, 2 * n + j] = turned[n + i, j]
        for j in range(c):
            system[i, 3 * n + j] = forces[i, j]
    solve_rows(system)
    solved = system[:, n:].copy()
    Q, twice, both = np.empty((n, 2 * n + c)), np.empty((n, 2 * n + c)), np.empty((n, n))
    multiply(metric, solved, Q)  # Q, and the accelerations by the forces
    for i in range(n):
        for j in range(n):
            both[i, j] = g * Q[i, j] + Q[i, n + j]
    multiply(both, Q, twice)  # Q Z but for its first term, and the same of the accelerations
    method, first = np.empty((2 * n, 2 * n)), np.empty((c, 2 * n))
    for i in range(n):
        for j in range(n):
            twice[i, j] += Q[i, j]
        for j in range(2 * n):
            speed = (1 + ROOT) * twice[i, j] - ROOT * Q[i, j]
            method[j, n + i] = speed
            method[j, i] = g * (speed + (1 + ROOT) * Q[i, j])
        method[i, i] += 1.0
        for j in range(c):
            force = Q[i, 2 * n + j]
            speed = g * (force + (1 + ROOT) * twice[i, 2 * n + j])
            first[j, n + i] = speed
            first[j, i] = g * (g * (1 + ROOT) * force + speed)
    return method, first


@compiled
def _respond(method, now, outputs, x, error, pace, responses):
    """Fill `responses` (1 + m, N q): the free outputs, and those of one ramp of each input."""
    n, r = outputs.shape
    c, q = len(now), r + n
    after, place, tips = np.empty((c, 2 * n)), np.empty((c, n)), np.empty((c, r))
    sums = np.zeros((c, q))
    for i in range(n):
        sums[0, r + i] = x[n + i]
        for j in range(r):
            sums[0, j] += outputs[i, j] * x[i]
    for k in range(len(error)):
        for a in range(c):
            for i in range(n):
                place[a, i] = now[a, i]
        multiply(place, outputs, tips)
        for a in range(c):
            for i in range(q):
                change = tips[a, i] if i < r else now[a, n + i - r]
                sums[a, i] += change
                if a == 0:
                    value = sums[a, i] + (error[k, i] if i < r else -pace[k, i - r])
                else:
                    value = sums[a, i] - 0.5 * change
                    if k > 0:
                        value += responses[a, (k - 1) * q + i]
                responses[a, k * q + i] = value
        multiply(now, method, after)
        now, after = after, now


@compiled
def _products(responses, begins, q):
    """Products of all ramps (pieces m)², with the free outputs, and of these with themselves.

    Two ramps that begin d steps apart have the same products, up to the end of the horizon,
    whichever they are. So a pair goes on where a later one ended.
    """
    m, width = len(responses) - 1, responses.shape[1]
    pieces = len(begins) - 1
    ramps, free = np.zeros((pieces * m, pieces * m)), np.zeros(pieces * m)
    for i in range(pieces - 1, -1, -1):
        count = width - q * begins[i]
        for a in range(m):
            free[i * m + a] = dot(responses[1 + a, :count], responses[0, width - count :])
        for j in range(i + 1):
            lag, done = begins[i] - begins[j], 0
            for x in range(pieces - 1, i, -1):
                for y in range(x + 1):
                    if begins[x] - begins[y] == lag:
                        done = width - q * begins[x]
                        for a in range(m):
                            for b in range(m):
                                ramps[i * m + a, j * m + b] = ramps[x * m + a, y * m + b]
            _add_inner(responses, done, lag * q, count - done, ramps, i * m, j * m)
    for i in range(pieces * m):
        for j in range(i):
            ramps[j, i] = ramps[i, j]
    return ramps, free, dot(responses[0], responses[0])


@partial(compiled, reorder=True)
def _add_inner(rows, begin, shift, count, products, i, j):
    """Add the products of rows with shifted rows, four at a time."""
    m = len(rows) - 1
    for a in range(0, m - 1, 2):
        first, second = rows[1 + a, begin:], rows[2 + a, begin:]
        for b in range(0, m - 1, 2):
            third, fourth = rows[1 + b, begin + shift :], rows[2 + b, begin + shift :]
            t13 = t14 = t23 = t24 = 0.0
            for x in range(count):
                t13 += first[x] * third[x]
                t14 += first[x] * fourth[x]
                t23 += second[x] * third[x]
                t24 += second[x] * fourth[x]
            products[i + a, j + b] += t13
            products[i + a, j + b + 1] += t14
            products[i + a + 1, j + b] += t23
            products[i + a + 1, j + b + 1] += t24
    if m % 2:
        last, end = begin + shift, begin + count
        for a in range(m):
            products[i + a, j + m - 1] += dot(rows[1 + a, begin:end], rows[m, last:])
        for b in range(m - 1):
            products[i + m - 1, j + b] += dot(rows[m, begin:end], rows[1 + b, last:])


class Present(NamedTuple):
    """The state of a step, its linear model, and the state at which the command begins to act.

    Attributes
    ----------
    state : State
        The state at which the model is linearised.
    linear : tuple of ndarray
        M, K_t, D_t, B there.
    force : ndarray, (n,)
        The force that `ahead` takes, under the input that acts at present.
    first : tuple of ndarray, (n,), (n,)
        p = q ⊖ q₀ and q̇ at present.
    input : ndarray, (m,)
        The input that acts at present.
    p, v, acting : ndarray, (n,), (n,), (m,)
        p, q̇, and the input that acts, when the command begins to act.
    """

    state: State
    linear: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    force: np.ndarray
    first: tuple[np.ndarray, np.ndarray]
    input: np.ndarray
    p: np.ndarray
    v: np.ndarray
    acting: np.ndarray

    @property
    def q(self) -> np.ndarray:
        """The configuration (nq,) at which the command begins to act."""
        q: np.ndarray = self.state.model.integrate(self.state.q, self.p)
        return q


def ahead(
    linear: tuple[np.ndarray, ...],
    force: np.ndarray,
    start: tuple[np.ndarray, np.ndarray],
    changes: np.ndarray,
    step: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """p and q̇ (n,) after steps of backward Euler, and the matrix M + T D_t + T² K_t of one.

    Parameters
    ----------
    linear, force, start : tuple of ndarray, ndarray, tuple of ndarray
        As `condensed_qp` has them.
    changes : ndarray, (steps, m)
        Mean change of the input a - a₀ over each step.
    step : float
        A step's length T (s).
    """
    M, K, D, B = linear
    p, v = start
    matrix = M + step * D + step * step * K
    for change in changes:
        v = np.linalg.solve(matrix, M @ v + step * (force + B @ change - K @ p))
        p = p + step * v
    return p, v, matrix
