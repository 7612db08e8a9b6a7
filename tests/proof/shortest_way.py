"""The way of `best` to two targets of the finger, beside an iLQR on the full model.

Each row changes one thing: the weight of the joints' speeds, the horizon, or the one linearisation,
in whose place an iLQR solves the same problem on the full model in each period. In the last row an
iLQR plans all 5 s, and only the tip counts; its gains follow the plan in the simulation. Where
several equilibria hold the target, it is the best of the plans that begin with their inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from time import process_time
from typing import Any, NamedTuple

import numpy as np

import softdyn
from softdyn import SetPoint, SoftModel, statics
from softdyn.commands import cli
from softdyn.controllers import Mpc, MpcParameters, RestTargets
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.dynamics import DiscreteStep, discrete_step
from softdyn.validation import Log, paper, simulate

EPILOG = "exit codes: 0 done; 2 bad input; 130 interrupted.\n"
SECONDS, PERIOD, STEP = 5.0, 0.005, 0.01  # s; `best` has the control period of the paper
CURLED = np.array([-0.16, -0.2])  # N m: the second target is the tip of this equilibrium
RIDGE = 1e-9  # of the inputs' changes beside those of the target
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of an iteration's step
VARIANTS = {
    "`best`": {},
    "speed 0.03 s": {"speed": 0.03},
    "horizon 0.15 s": {"horizon": 0.15},
    "horizon 0.6 s": {"horizon": 0.6},
    "rate 1e-5": {"rate": 1e-5},
}
FULL = {
    "full model in each period": {},
    "full model, speed 0.03 s": {"speed": 0.03},
}

parser = cli.Parser(__doc__, EPILOG)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table as Markdown; returns the exit code."""
    parser.parse_args(argv)
    model = softdyn.load("finger")
    half = paper.set_point("finger", theta=0.5).reference(0.0).y
    targets = half, statics.settle(model, CURLED).y
    heads = ["θ = 0.5π: rms", "at 5 s", "curled: rms", "at 5 s", "ms a period"]
    print("| controller |", " | ".join(heads), "|")
    print("| --- |", " | ".join(["---"] * len(heads)), "|", flush=True)
    for name, changes in VARIANTS.items():
        _row(model, targets, name, PERIOD, partial(_best, changes))
    for name, changes in FULL.items():
        _row(model, targets, name, STEP, partial(_Receding, changes))
    _row(model, targets, "full model, all 5 s, the tip alone", STEP, _planned)
    return cli.PASSED


def _best(changes: dict[str, float], model: SoftModel, _: np.ndarray) -> Mpc:
    return Mpc(model, changes, targets=RestTargets(model))


def _row(
    model: SoftModel,
    targets: Sequence[np.ndarray],
    name: str,
    period: float,
    make: Callable[[SoftModel, np.ndarray], Callable[..., Any]],
) -> None:
    cells, spent = [], 0.0
    for y in targets:
        controller, before = make(model, y), process_time()
        log: Log = simulate(model, controller, SetPoint(y), duration=SECONDS, period=period)
        spent += process_time() - before
        rms = 100 * np.sqrt(np.mean(np.sum(log.error**2, axis=1)))
        cells += [f"{rms:.2f}", f"{log.final_error_cm:.2f}"]
    cells.append(f"{1e3 * spent / (len(targets) * SECONDS / period):.1f}")
    print(f"| {name} |", " | ".join(cells), "|", flush=True)


class _Visited(NamedTuple):
    """A state (q, v), the input a before it, and the step that it takes."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    step: DiscreteStep


class _Plan(NamedTuple):
    """Inputs (steps, m), the states on the way, the gains, and the cost."""

    u: np.ndarray
    path: list[_Visited]
    gains: np.ndarray
    cost: float


class _Ilqr:
    """min Σ ‖e‖² + speed² ‖v‖²_W + rate ‖Δu‖²_R with bounded inputs, the terms of `Mpc`.

    The state is (q, v, a) with the input a before; A and B are those of `discrete_step`.
    """

    def __init__(self, model: SoftModel, y: np.ndarray, parameters: MpcParameters) -> None:
        self.model, self.y, horizon = model, y, parameters.horizon
        state, S, compliance = stiffness_at_rest(model, horizon)
        self._W = (parameters.speed * horizon) ** 2 * compliance * S
        R = state.B.T @ np.linalg.solve(S, state.B)
        self._R = compliance * (parameters.rate * R + RIDGE * np.eye(model.nu))

    def forward(
        self, start: tuple[np.ndarray, ...], u: np.ndarray, gains: np.ndarray | None = None,
        old: Sequence[_Visited] = (),
    ) -> _Plan:  # fmt: skip
        """The path under inputs, or under gains about an old path."""
        (q, v, a), model, path, used, cost = start, self.model, [], [], 0.0
        for k, given in enumerate(u):
            now = given
            if gains is not None:
                away = np.concatenate((q - old[k].q, v - old[k].v, a - old[k].a))
                now = np.clip(given + gains[k] @ away, model.u_min, model.u_max)
            step = discrete_step(model, q, v, now, STEP)
            error = model.state(step.q, step.v).y - self.y
            cost += error @ error + step.v @ self._W @ step.v + (now - a) @ self._R @ (now - a)
            path.append(_Visited(q, v, a, step))
            used.append(now)
            q, v, a = step.q, step.v, now
        return _Plan(np.array(used), path, np.zeros(0) if gains is None else gains, float(cost))

    def backward(self, plan: _Plan, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the inputs and gains; inputs that would leave their bounds stay there."""
        model, n, m = self.model, self.model.nv, self.model.nu
        s, S = np.zeros(2 * n + m), np.zeros((2 * n + m, 2 * n + m))
        changes, gains = np.zeros(plan.u.shape), np.zeros((*plan.u.shape, 2 * n + m))
        for k in reversed(range(len(plan.u))):
            u, (_, _, a, step) = plan.u[k], plan.path[k]
            state = model.state(step.q, step.v)
            s[:n] += 2 * state.J.T @ (state.y - self.y)
            s[n : 2 * n] += 2 * self._W @ step.v
            S[:n, :n] += 2 * state.J.T @ state.J
            S[n : 2 * n, n : 2 * n] += 2 * self._W
            A, B = np.zeros(S.shape), np.vstack((step.B, np.eye(m)))
            A[: 2 * n, : 2 * n] = step.A
            R, slope = 2 * self._R, 2 * self._R @ (u - a)
            by_u, by_uu, by_ux = B.T @ s + slope, B.T @ S @ B + R, B.T @ S @ A
            by_ux[:, 2 * n :] -= R
            free = ~((u <= model.u_min) & (by_u > 0) | (u >= model.u_max) & (by_u < 0))
            inverse = np.linalg.inv((by_uu + damping * np.eye(m))[free][:, free])
            changes[k, free] = -inverse @ by_u[free]
            gains[k, free] = -inverse @ by_ux[free]
            s, S = A.T @ s, A.T @ S @ A
            s[2 * n :] -= slope
            S[2 * n :, 2 * n :] += R
            s += gains[k].T @ (by_uu @ changes[k] + by_u) + by_ux.T @ changes[k]
            S += gains[k].T @ by_uu @ gains[k] + gains[k].T @ by_ux + by_ux.T @ gains[k]
        return changes, gains

    def solve(
        self, start: tuple[np.ndarray, ...], u: np.ndarray, most: int, enough: float
    ) -> _Plan:
        """A local minimum, from a first guess (steps, m); it ends with a gain below `enough`."""
        plan, damping = self.forward(start, u), 1e-9
        for _ in range(most):
            changes, gains = self.backward(plan, damping)
            before = plan.cost
            for share in SHARES:
                tried = self.forward(start, plan.u + share * changes, gains, plan.path)
                if tried.cost < before:
                    plan, damping = tried, damping / 10
                    break
            else:
                damping = max(100 * damping, 1e-8)
                if damping > 1.0:
                    break
            if 0 < before - plan.cost < enough * before:
                break
        return plan._replace(gains=self.backward(plan, damping)[1])


class _Receding:
    """The iLQR over the horizon in each period, from the last plan."""

    def __init__(self, changes: dict[str, float], model: SoftModel, y: np.ndarray) -> None:
        parameters = MpcParameters(**changes)
        self._solver, self._a = _Ilqr(model, y, parameters), model.relaxed
        self._u = np.tile(model.relaxed, (round(parameters.horizon / STEP), 1))

    def __call__(self, state: softdyn.State, _: object) -> np.ndarray:
        found = self._solver.solve((state.q, state.v, self._a), self._u, 8, 1e-4)
        self._u, self._a = np.vstack((found.u[1:], found.u[-1:])), found.u[0]
        return self._a


def _planned(model: SoftModel, y: np.ndarray) -> Callable[..., np.ndarray]:
    """The inputs of the best plan of all 5 s, with its gains."""
    solver = _Ilqr(model, y, MpcParameters(speed=1e-9))
    start, steps = (model.q0, np.zeros(model.nv), model.relaxed), round(SECONDS / STEP)
    goals = statics.inputs_for_tip(model, y).found
    near = [one for one in goals if one.stable and np.linalg.norm(one.y - y) < 1e-5]
    plans = [solver.solve(start, np.tile(one.u, (steps, 1)), 60, 1e-5) for one in near]
    plan = min(plans, key=lambda one: one.cost)
    last, number = model.relaxed, 0

    def follow(state: softdyn.State, _: object) -> np.ndarray:
        nonlocal last, number
        k = min(number, steps - 1)
        there = plan.path[k]
        away = np.concatenate((state.q - there.q, state.v - there.v, last - there.a))
        last = np.clip(plan.u[k] + plan.gains[k] @ away, model.u_min, model.u_max)
        number += 1
        return last

    return follow
