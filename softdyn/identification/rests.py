"""Equilibria under the measured inputs, and their derivatives by the unknown parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from softdyn.actuation.capstan import Capstan
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.tree import tree_of
from softdyn.identification.parameters import Parameter, columns_of
from softdyn.identification.unknowns.kinds import Around, MotionSample, capstan_forces
from softdyn.statics.equilibria import move, settle
from softdyn.statics.equilibrium import Equilibrium, StaticsError

NEWTON = 40  # iterations with friction, which bends at every joint's zero
LARGEST = 0.2  # largest motion of a joint in one of them (rad, m)
BALANCED = 1e-7  # residual over the largest force; friction has kinks


@dataclass(frozen=True, eq=False)
class Inputs:
    """The inputs of static rows, and what friction needs to know of them.

    Attributes
    ----------
    u : ndarray, (N, m)
    loss : ndarray, (m,)
        The part of each input that friction at the driven end takes.
    direction : ndarray, (N, m), optional
        Last direction of each cable: 1 pulled in, -1 paid out, 0 unknown. By default that of the
        cable's length from the row before; before the first row the robot has no input.
    guesses : dict
        Where the search starts, by the input's bytes; the results are kept there. An input that is
        not there starts from the equilibrium of the row before.
    """

    u: np.ndarray
    loss: np.ndarray
    direction: np.ndarray | None = None
    guesses: dict[bytes, np.ndarray] = field(default_factory=dict)


def rests(
    model: SoftModel, unknowns: Sequence[Parameter], inputs: Inputs, around: Around
) -> tuple[np.ndarray, np.ndarray]:
    """Joint coordinates (N, n) at rest under each input, and their derivatives (N, n, P).

    ∂q/∂θ = -(∂r/∂q)⁻¹ ∂r/∂θ on the joints that no stop holds.

    Raises
    ------
    StaticsError
        If no stable equilibrium is found.
    """
    n, count = model.nv, len(unknowns)
    path, by = np.empty((len(inputs.u), n)), np.zeros((len(inputs.u), n, count))
    rubs = any(tendon.friction for tendon in model.robot.tendons)
    rubs |= bool(inputs.loss.any()) or any(one.kind.measures == "input." for one in unknowns)
    capstan, ways = Capstan(model), _directions(model, inputs) if rubs else None
    start = None
    for k, row in enumerate(inputs.u):
        way = None if ways is None else ways[k]
        u = row if way is None else _less(model, row, inputs.loss, way)
        rest = settle(model, u, inputs.guesses.get(u.tobytes(), start))
        start = inputs.guesses[u.tobytes()] = rest.q
        sample = MotionSample(rest.state, np.zeros(n), u, around)
        H = rest.stiffness
        if way is not None:
            sample = sample._replace(direction=_of_tendons(model, way))
            if len(capstan.tendon):
                sample, H = _with_friction(model, capstan, rest, sample)
        path[k] = model.coordinates(sample.state.q)
        if count:
            free = ~rest.held
            block = H[np.ix_(free, free)]
            by[k, free] = -np.linalg.solve(block, columns_of(unknowns, sample, count)[free])
    return path, by


def _less(model: SoftModel, u: np.ndarray, loss: np.ndarray, way: np.ndarray) -> np.ndarray:
    """The inputs (m,) without what friction takes; one that cannot push ends at zero."""
    less = u - loss * way
    return np.where((u >= 0) & (model.u_min >= 0), np.maximum(less, 0), less)


def _of_tendons(model: SoftModel, way: np.ndarray) -> np.ndarray:
    found = np.zeros(len(model.tendons.names))
    found[tree_of(model).actuated] = way
    return found


def _directions(model: SoftModel, inputs: Inputs) -> np.ndarray:
    """The last direction (N, m) of each input's cable, as `Inputs.direction`."""
    if inputs.direction is not None:
        return inputs.direction
    driven = tree_of(model).actuated
    at = settle(model, np.zeros(model.nu))
    before, last = at.state.lengths[driven], np.ones(model.nu)
    found = np.empty_like(inputs.u)
    for k, row in enumerate(inputs.u):
        at = settle(model, row, at.q)
        change = at.state.lengths[driven] - before
        last = np.where(np.abs(change) > 1e-9, -np.sign(change), last)
        found[k], before = last, at.state.lengths[driven]
    return found


def _with_friction(
    model: SoftModel, capstan: Capstan, rest: Equilibrium, sample: MotionSample
) -> tuple[MotionSample, np.ndarray]:
    """The equilibrium near `rest` of cables that rub, and its tangent stiffness (n, n).

    It is Newton's method on K + g - B u - τ = 0, with the friction τ in the sample's directions.
    """
    assert sample.direction is not None
    ways = sample.direction[capstan.tendon]
    u = sample.u
    free = np.flatnonzero(~rest.held)
    state, size, step = rest.state, np.inf, np.zeros(model.nv)
    q = before = rest.q
    for _ in range(NEWTON):
        sample = sample._replace(state=state)
        r = state.K + state.bias - state.B @ u - capstan_forces(sample, capstan)
        left = float(np.abs(r[free]).max(initial=0.0))
        scale = max(float(np.abs(state.B @ u).max(initial=0.0)), 1e-12)
        if left < size:
            size, before = left, q
            H = stiffness(model, q, u) - capstan.derivatives(state, u, ways).q
            if left <= BALANCED * scale:
                return sample, H
            step[free] = -np.linalg.solve(H[np.ix_(free, free)], r[free])
            step *= min(1.0, LARGEST / float(np.abs(step).max()))
        else:
            step /= 2
        q = move(model, before, step)
        state = model.state(q, np.zeros(model.nv))
    raise StaticsError(f"no equilibrium of {model.name} with its friction", size)
