"""Every controller of the paper compared with its printed QP, at moving states."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from softdyn import Reference, SoftModel, State
from softdyn.controllers import CONTROLLERS, Gains
from tests.support import paper_qps
from tests.support.qp_solvers import LeastNorm, Quadprog, unknowns

TOLERANCE = 1e-6  # of the input range
# relative: a solver cannot distinguish minimisers of CLF-QP whose cost agrees to this
SAME_COST = 1e-9
RIDGE = 1e-7  # of the proximal iteration on CLF-QP's semidefinite QP
COLUMNS = (
    ("robot", "robot", ""),
    ("law", "controller", ""),
    ("states", "states", "d"),
    ("saturated", "saturated", "d"),
    ("difference / range", "max_error", ".1e"),
    ("other minimisers", "others", "d"),
    ("dearer by at most", "excess", ".1e"),
    ("", "verdict", ""),
)


def states(model: SoftModel, count: int, seed: int = 0) -> Iterator[tuple[State, Reference]]:
    """Random states, slow and fast, and references near and far, none of them at rest."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        lower, upper = np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0)
        q = model.configuration(0.7 * rng.uniform(lower, upper))
        state = model.state(q, rng.normal(size=model.nv) * (0.0, 0.02, 0.5)[k % 3])
        near, far = rng.normal(size=(2, 3)), (1e-4, 1e-2, 0.1, 1.0)[k // 3 % 4]
        y = state.y + far * near[0] / np.linalg.norm(near[0])
        yield state, Reference(y, 0.1 * near[1], 0.5 * rng.normal(size=3))


def textbook(name: str, state: State, reference: Reference, gains: Gains) -> np.ndarray:
    """The input (m,) by the paper's text, with every unknown explicit."""
    task = paper_qps.tip(state, reference)
    if name in paper_qps.PAPER_QPS:
        solver = LeastNorm(Quadprog(RIDGE)) if name == "clf-qp" else Quadprog()
        answer = solver.solve(paper_qps.PAPER_QPS[name](unknowns, state, task, gains))
        return answer["u"]
    torque = paper_qps.impedance(state, task, gains)
    if name == "uic":
        torque = paper_qps.underactuated(state, task, torque)
    u = paper_qps.inputs(state, torque)
    return np.clip(u, state.model.u_min, state.model.u_max)


def clf_cost(u: np.ndarray, state: State, reference: Reference, gains: Gains) -> float:
    """w1 ‖μ - μ_ref‖² + ρ δ² of CLF-QP under an input (m,)."""
    task = paper_qps.tip(state, reference)
    qdd = np.linalg.solve(state.M, state.B @ u - state.h)
    mu = state.J @ qdd + state.Jdot @ state.v - reference.yddot
    V, drift, slope = paper_qps.lyapunov(task, gains.eps)
    slack = max(0.0, drift + slope @ mu + V / gains.eps)
    return float(gains.w1 * np.sum((mu - task.mu_ref(gains)) ** 2) + gains.rho * slack**2)


def compare(
    model: SoftModel, name: str, count: int, seed: int = 0, tick: Callable[[], Any] = lambda: None
) -> dict[str, Any]:
    """The largest difference of a controller from its textbook form, relative to the input range.

    If CLF-QP's answer differs from the oracle's, their costs are compared. `excess` is the relative
    excess of the controller's cost, and `others` is the number of such states.
    """
    law = CONTROLLERS[name](model)
    span = float((model.u_max - model.u_min).max())
    low, high = model.u_min + TOLERANCE * span, model.u_max - TOLERANCE * span
    error, excess, others, saturated = 0.0, 0.0, 0, 0
    for state, reference in states(model, count, seed):
        ours = law(state, reference).u
        theirs = textbook(name, state, reference, law.gains)
        saturated += bool(((ours <= low) | (ours >= high)).any())
        apart = float(np.abs(ours - theirs).max()) / span
        if name == "clf-qp" and apart > TOLERANCE:
            others += 1
            inside = np.clip(theirs, model.u_min, model.u_max)
            mine, best = (clf_cost(u, state, reference, law.gains) for u in (ours, inside))
            excess = max(excess, (mine - best) / best)
        else:
            error = max(error, apart)
        tick()
    passed = error <= TOLERANCE and excess <= SAME_COST and law.guard.fallbacks == 0
    return {
        "robot": model.bundled or model.name, "controller": name, "states": count,
        "saturated": saturated, "max_error": error, "others": others, "excess": excess,
        "not_solved": law.guard.not_solved, "passed": passed,
        "verdict": "" if passed else "differs",
    }  # fmt: skip
