"""Equilibria under the measured inputs, and their derivatives by the unknown parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from softdyn.actuation.capstan import Capstan
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.tree import tree_of
from softdyn.identification.parameters import Parameter, columns_of
from softdyn.identification.unknowns.kinds import Around, MotionSample
from softdyn.statics.equilibria import newton, settle
from softdyn.statics.friction import Rubbing, follow, stated

PULLED = 1e-6  # of the largest pull; the friction of a cable with less moves nothing
PART = 0.02  # of a cable's friction; a row in which less of it acts the other way slid as a whole


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
    rubs = any(tendon.rubs for tendon in model.robot.tendons)
    rubs |= bool(inputs.loss.any()) or any(one.kind.measures == "input." for one in unknowns)
    capstan, ways = Capstan(model), directions(model, inputs) if rubs else None
    start = None
    for k, row in enumerate(inputs.u):
        way = None if ways is None else ways[k]
        u = row if way is None else _less(model, row, inputs.loss, way)
        rest = settle(model, u, inputs.guesses.get(u.tobytes(), start))
        start = inputs.guesses[u.tobytes()] = rest.q
        state, held, H, slid = rest.state, rest.held, rest.stiffness, None
        if way is not None:
            slid = _of_tendons(model, way)
            if len(capstan.tendon):
                friction = Rubbing(capstan, u, stated(slid[capstan.tendon], model))
                here, H = newton(model, u, rest.q, friction)
                state, held = here.state, here.held
        path[k] = model.coordinates(state.q)
        if count:
            sample, free = MotionSample(state, np.zeros(n), u, around, slid), ~held
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


def directions(model: SoftModel, inputs: Inputs) -> np.ndarray:
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


def slid(model: SoftModel, u: np.ndarray, loss: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last direction of each cable along slow rows, and the rows in which it slid as a whole.

    A cable that turns back sticks at first, and then slides from its driven end on, guide by guide
    (`softdyn.statics.friction`). Until it slides at all of them, its tensions depend on the rows
    before. At the motor, the tension stays where it is while the input is within ± `loss` of it.

    Parameters
    ----------
    model : SoftModel
        The robot with the friction of its cables.
    u : ndarray, (N, m)
        The inputs of the rows in the order of time; before them the robot has no input.
    loss : ndarray, (m,)
        As in `Inputs`.

    Returns
    -------
    direction : ndarray, (N, m)
        1 pulled in, -1 paid out.
    whole : ndarray of bool, (N,)

    Raises
    ------
    StaticsError
        If no slow motion from row to row is found.
    """
    found, capstan = directions(model, Inputs(u, loss)), Capstan(model)
    whole, tension, last = np.ones(len(u), bool), np.zeros(model.nu), np.zeros(model.nu)
    tensions = np.empty_like(u)
    for k, row in enumerate(u):
        low = np.where((row >= 0) & (model.u_min >= 0), np.maximum(row - loss, 0), row - loss)
        tension = tensions[k] = np.clip(tension, low, row + loss)
        turned = row != last
        whole[k] = not (turned & (low < tension) & (tension < row + loss)).any()
        whole[k] &= k == 0 or whole[k - 1] or turned.any()
        last = row
    if not len(capstan.tendon):
        return found, whole
    driven = tree_of(model).actuated
    path = follow(capstan, [np.zeros(model.nu), *tensions])[1:]
    for k, rest in enumerate(path):
        guides = capstan.at(rest.state)
        pull = np.abs(guides.pull(rest.u))
        rubbing = capstan.friction * guides.angles
        for m, tendon in enumerate(driven):
            own = capstan.tendon == tendon
            if pull[tendon] <= PULLED * pull.max() or not own.any():
                continue
            way = np.sign(rubbing[own] @ rest.direction[own]) or found[k, m]
            found[k, m] = way
            missing = rubbing[own] @ np.abs(rest.direction[own] - way)
            whole[k] &= missing <= PART * rubbing[own].sum()
    return found, whole
