"""Cells where `best` ends behind what statics finds: its error, and its error without one cause.

docs/beyond.md has the table. Each cell is run as it is, and then with one thing changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.linalg import solve_discrete_are

import softdyn
from softdyn import SoftModel
from softdyn.commands import cli
from softdyn.controllers import RestTargets, Staged, best
from softdyn.controllers.predictive import objective, plan
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.controllers.schedule import tuned
from softdyn.dynamics import discrete_step
from softdyn.validation import Log, Rig, paper, simulate

EPILOG = "exit codes: 0 done; 2 bad input; 130 interrupted.\n"
PERIOD = 0.002  # s, SpiRob's
PUSH = 1e-6  # weight of an input (N²) beside the tip's error (m²), and of a joint's place (rad²)
AGAIN = 4  # times that the input at the end becomes the next run's input without cost
parser = cli.Parser(__doc__, EPILOG)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the cells; returns the exit code."""
    chosen = parser.parse_args(argv).cells
    for name in chosen or CELLS:
        for label, value in CELLS[name]():
            print(f"{name}: {label}: {value:.3g}", flush=True)
    return cli.PASSED


def leaves(theta: float) -> Iterator[tuple[str, float]]:
    """A rest with unstable poles that feedback of the tip does not see."""
    model, case = softdyn.load("spirob"), paper.set_point("spirob", theta)
    yield "as it is (cm)", simulate(model, best(model), case).final_error_cm
    rests = RestTargets(model).find(case.reference(0.0).y, waits=True)
    assert rests
    q, feedback = rests[0].q, ShapeFeedback(model, rests[0], PERIOD)
    for label, law in {"": best(model), ", with feedback of all joints": feedback}.items():
        controller: Any = law
        yield f"from the rest{label} (cm)", simulate(model, controller, case, q0=q).final_error_cm


class ShapeFeedback:
    """The linear feedback of all joints that holds a rest with least cost (LQR).

    Parameters
    ----------
    model : SoftModel
    rest : RestTarget
    period : float
        Control period (s).
    """

    def __init__(self, model: SoftModel, rest: RestTarget, period: float) -> None:
        self._model, self._q, self._u = model, model.coordinates(rest.q), rest.u
        n = model.nv
        still = np.zeros(n)
        step, J = discrete_step(model, rest.q, still, rest.u, period), model.state(rest.q, still).J
        weight, push = np.zeros((2 * n, 2 * n)), PUSH * np.eye(model.nu)
        weight[:n, :n] = J.T @ J + PUSH * np.eye(n)
        P = solve_discrete_are(step.A, step.B, weight, push)
        self._gain = np.linalg.solve(step.B.T @ P @ step.B + push, step.B.T @ P @ step.A)

    def __call__(self, state: softdyn.State, _: object) -> np.ndarray:
        """The input (nu,) at a state."""
        model = self._model
        away = np.concatenate((model.coordinates(state.q) - self._q, state.v))
        return np.clip(self._u - self._gain @ away, model.u_min, model.u_max)


def tension(theta: float) -> Iterator[tuple[str, float]]:
    """The tuned controller's cost of inputs beside 20 N."""
    model, case = softdyn.load("spirob"), paper.set_point("spirob", theta)
    schedule = tuned(model)
    assert schedule is not None
    log = simulate(model, Staged(model, schedule), case)
    yield "as it is (cm)", log.final_error_cm
    for _ in range(AGAIN):
        stay: Any = replace(schedule.stay, u_ref=log.u[-1].mean())
        log = simulate(model, Staged(model, replace(schedule, stay=stay)), case)
    yield "the input that holds has no cost (cm)", log.final_error_cm


def jump(omega: float) -> Iterator[tuple[str, float]]:
    """A path that begins far from the robot at rest."""
    model, case = softdyn.load("helix"), paper.tracking("helix", omega)
    log = simulate(model, best(model), case)
    yield "as it is (cm²)", log.mse_cm2
    half = len(log.t) // 2
    error = np.linalg.norm(log.y - log.y_ref, axis=1)
    yield "second cycle alone (cm²)", 1e4 * float(np.mean(error[half:] ** 2))


def late(theta: float, label: str, module: Any, **constants: Any) -> Iterator[tuple[str, float]]:
    """Constants of the way to a rest, where motors lag by 10 ms."""
    yield "as it is (cm)", _late(theta).final_error_cm
    with patch.multiple(module, **constants):
        yield f"{label} (cm)", _late(theta).final_error_cm


def _late(theta: float) -> Log:
    model = softdyn.load("spirob")
    case = paper.set_point("spirob", theta)
    return simulate(model, best(model), case, rig=Rig(lag=0.01, file=False))


CELLS: dict[str, Callable[[], Iterator[tuple[str, float]]]] = {
    "spirob-0": lambda: leaves(0),
    "spirob-0.5": lambda: tension(0.5),
    "spirob-1.75": lambda: leaves(1.75),
    "lag-0.25": lambda: late(0.25, "steps of 5 ms", plan, STEP=0.005, STEPS=300),
    "lag-0.3": lambda: late(0.3, "no weight of the shape", objective, FORM=0.0),
    "helix-0.35": lambda: jump(0.35),
}
parser.add_argument(
    "cells", nargs="*", choices=[*CELLS, []], metavar="CELL", help=f"{', '.join(CELLS)}"
)
