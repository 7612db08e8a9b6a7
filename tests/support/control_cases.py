"""Robots and states for tests of controllers: bundled, micro, recorded, random, hostile."""

from __future__ import annotations

from functools import cache

import numpy as np

import softdyn
from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.dynamics.integrators import step_implicit
from softdyn.validation import paper
from tests.support.robots import build, chain

BUNDLED = ("finger", "helix", "spirob", "spirob48")
GAINS = Gains(Kp=100.0, eps=0.1)  # for robots without published ones


_MICRO = {
    "one joint": chain("y", ((1.0,),)),
    "two identical tendons": chain("yxy", ((1, 0.5, 1), (1, 0.5, 1))),
    "three tendons of rank two": chain("yxyx", ((1, 0, 1, 0), (0, 1, 0, 1), (1, 1, 1, 1))),
    "more inputs than joints": chain("yx", ((1, 0), (0, 1), (1, -1))),
    "n < 3 + m": chain("yxy", ((1, 1, 0), (0, 1, 1))),
    "fully actuated": chain("xyz", ((1, 0, 0), (0, 1, 0), (0, 0, 1))),
    "sliding and turning": chain("pcyx", ((1, 0, 0, 0), (0, 1, 1, 0))),
    "planar": chain("yyyyy", ((1, 1, 1, 0, 0), (0, 0, 0, 1, 1))),
    "a fixed input": chain("yxyx", ((1, 1, 0, 0), (0, 0, 1, 1)), bound=0.0),
}
MICRO = tuple(_MICRO)
RANK_DEFICIENT = ("two identical tendons", "three tendons of rank two", "more inputs than joints")


@cache
def robot(name: str) -> SoftModel:
    """A bundled robot, or a micro one by its description."""
    if name in BUNDLED:
        return softdyn.load(name)
    return build(_MICRO[name])


def gains_of(name: str) -> Gains:
    """The published gains of a bundled robot's Soft ID-CLF-QP, `GAINS` for a micro one."""
    return SoftIdClfQp(robot(name), None if name in BUNDLED else GAINS).gains


@cache
def recorded(name: str, count: int = 12) -> tuple[tuple[State, SetPoint], ...]:
    """(state, set point) pairs of short closed loops from rest, denser at their beginning."""
    model, setup = robot(name), paper.setup(name)
    step = 5e-4
    pairs = []
    for theta in paper.THETAS:
        controller, goal = (
            SoftIdClfQp(model),
            paper.set_point(name, theta).reference(0.0),
        )
        share = -(-count // len(paper.THETAS))
        last = round(0.4 / setup.period)
        wanted = set(np.unique(np.geomspace(1, last + 1, share).round().astype(int) - 1))
        q, v = model.q0, np.zeros(model.nv)
        for k in range(last + 1):
            state = model.state(q, v)
            if k in wanted:
                pairs.append((state, goal))
            u = controller(state, goal).u
            for _ in range(round(setup.period / step)):
                q, v = step_implicit(model, q, v, u, step)
    return tuple(pairs)


@cache
def drawn(name: str, count: int = 18) -> tuple[tuple[State, Reference], ...]:
    """Random (state, reference) pairs: near and far, at rest, moving and accelerating."""
    model, rng, moves = robot(name), np.random.default_rng(7), np.random.default_rng(8)
    pairs = []
    for k in range(count):
        lower, upper = np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0)
        q = model.configuration(0.7 * rng.uniform(lower, upper))
        state = model.state(q, rng.normal(size=model.nv) * (0.0, 0.02, 0.5)[k % 3])
        offset = rng.normal(size=3) * (1e-4, 1e-2, 0.3)[k // 3 % 3]
        ydot, yddot = moves.normal(size=(2, 3)) * (k > 0) * ((0.1,), (0.5,))
        pairs.append((state, Reference(state.y + offset, ydot, yddot)))
    return tuple(pairs)
