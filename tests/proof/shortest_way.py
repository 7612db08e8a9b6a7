"""The way of `best` to targets of the finger and of an arm, beside an iLQR on the full model.

The arm has two sections and 22 joints; its second target moves. Each row changes one thing: the
weight of the joints' speeds, the horizon, or the one linearisation, in whose place an iLQR solves
the same problem on the full model in each period. In the last row of the finger an iLQR plans all
5 s, and only the tip counts; its gains follow the plan in the simulation. Where several equilibria
hold the target, it is the best of the plans that begin with their inputs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np

import softdyn
from softdyn import Reference, SetPoint, SoftModel, design, statics
from softdyn.commands import cli
from softdyn.controllers import Mpc, MpcParameters, RestTargets
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.dynamics import DiscreteStep, discrete_step
from softdyn.validation import Log, paper, simulate
from softdyn.validation.loop.setups import setup_of
from tests.support.arms import loaded

EPILOG = "exit codes: 0 done; 2 bad input; 130 interrupted.\n"
SECONDS, PERIOD, STEP = 5.0, 0.005, 0.01  # s; `best` has the control period of the paper
# inputs of the equilibria whose tips are the curled targets: N m of the finger, N of the arm
CURLED, CURLED_ARM = np.array([-0.16, -0.2]), np.array([10.0, 0, 0, 15.0, 0, 0])
OMEGA = 0.3  # π rad/s, on the arm's ellipse
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

Way = Callable[[float], Reference]
parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robot", choices=("finger", "arm"), help="one of the tables; default: both")


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables as Markdown; returns the exit code."""
    only = parser.parse_args(argv).robot
    if only != "arm":
        model = softdyn.load("finger")
        half = paper.set_point("finger", theta=0.5).reference
        _table(model, {"θ = 0.5π": half, "curled": SetPoint(statics.settle(model, CURLED).y)})
    if only != "finger":
        with tempfile.TemporaryDirectory() as folder:
            model = two_sections(Path(folder))
            curled = SetPoint(statics.settle(model, CURLED_ARM).y)
            _table(model, {"curled": curled, "path": setup_of(model).ellipse(OMEGA)})
    return cli.PASSED


def two_sections(folder: Path) -> SoftModel:
    """An arm of 22 joints with six cables."""
    rubber = design.Material(0.25e6, 0.49, 1070)
    lower = design.Section(0.12, (0.02, 0.017), rubber, 6, ("bend_y", "bend_z"))
    upper = design.Section(0.10, (0.017, 0.014), rubber, 5, ("bend_y", "bend_z"))
    cables = [
        design.Cable(angle + np.pi / 3 * end, offset, False, 20.0, 0, end, name=f"{end}_{k}")
        for end, offset in enumerate(((0.015, 0.012), (0.014, 0.010)))
        for k, angle in enumerate(2 * np.pi / 3 * np.arange(3))
    ]
    arm = design.Arm(
        (lower, upper), cables=tuple(cables), damping=design.Damping(ratio=0.15),
        name="two_sections",
    )  # fmt: skip
    return loaded(arm, folder)


def _table(model: SoftModel, ways: dict[str, Way]) -> None:
    heads = [head for name in ways for head in (f"{name}: rms", "at 5 s")]
    print(f"| {model.name} |", " | ".join([*heads, "ms a period"]), "|")
    print("| --- |", " | ".join(["---"] * (len(heads) + 1)), "|", flush=True)
    row = partial(_row, model, tuple(ways.values()))
    for name, changes in VARIANTS.items():
        row(name, PERIOD, partial(_best, changes))
    for name, changes in FULL.items():
        row(name, STEP, partial(_Receding, changes))
    if all(isinstance(way, SetPoint) for way in ways.values()):
        row("full model, all 5 s, the tip alone", STEP, _planned)


def _best(changes: dict[str, float], model: SoftModel, _: Way) -> Mpc:
    return Mpc(model, changes, targets=RestTargets(model))


def _row(
    model: SoftModel,
    ways: Sequence[Way],
    name: str,
    period: float,
    make: Callable[[SoftModel, Way], Callable[..., Any]],
) -> None:
    cells, spent = [], 0.0
    for way in ways:
        controller, before = make(model, way), process_time()
        log: Log = simulate(model, controller, way, duration=SECONDS, period=period)
        spent += process_time() - before
        rms = 100 * np.sqrt(np.mean(np.sum(log.error**2, axis=1)))
        cells += [f"{rms:.2f}", f"{log.final_error_cm:.2f}"]
    cells.append(f"{1e3 * spent / (len(ways) * SECONDS / period):.1f}")
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

    def __init__(self, model: SoftModel, way: Way, parameters: MpcParameters) -> None:
        self.model, self.way, horizon = model, way, parameters.horizon
        self.begin = 0.0  # s, of the horizon
        state, S, compliance = stiffness_at_rest(model, horizon)
        self._W = (parameters.speed * horizon) ** 2 * compliance * S
        R = state.B.T @ np.linalg.solve(S, state.B)
        self._R = compliance * (parameters.rate * R + RIDGE * np.eye(model.nu))

    def target(self, k: int) -> np.ndarray:
        """The target (3,) at the end of step k."""
        return self.way(self.begin + (k + 1) * STEP).y

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
            error = model.state(step.q, step.v).y - self.target(k)
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
            s[:n] += 2 * state.J.T @ (state.y - self.target(k))
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

    def __init__(self, changes: dict[str, float], model: SoftModel, way: Way) -> None:
        parameters = MpcParameters(**changes)
        self._solver, self._a = _Ilqr(model, way, parameters), model.relaxed
        self._u = np.tile(model.relaxed, (round(parameters.horizon / STEP), 1))

    def __call__(self, state: softdyn.State, _: object) -> np.ndarray:
        found = self._solver.solve((state.q, state.v, self._a), self._u, 8, 1e-4)
        self._u, self._a = np.vstack((found.u[1:], found.u[-1:])), found.u[0]
        self._solver.begin += STEP
        return self._a


def _planned(model: SoftModel, way: Way) -> Callable[..., np.ndarray]:
    """The inputs of the best plan of all 5 s to a set point, with its gains."""
    solver, y = _Ilqr(model, way, MpcParameters(speed=1e-9)), way(0.0).y
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
