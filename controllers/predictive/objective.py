"""The weights of the predictive controller's objective, from the robot at rest.

W and R are one metric, the dynamic stiffness over the horizon H, S = M/H² + D/H + diag(k), in
units of what it costs to move the tip (`docs/beyond.md`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.controllers.predictive.prediction import Lookahead
from softdyn.dynamics.derivatives import total_damping

SIZE = 1e-8  # weight of ‖u‖² beside that of its rate: it only picks among equal answers
HOLD = 1e-3  # κ, weight of u - u* beside the tip's error, input by input
FORM = 1e-2  # σ, weight of q - q*
BLIND = 1e-6  # of R's largest eigenvalue, its diagonal scaled to 1: below it R weighs nothing


@dataclass(frozen=True, eq=False)
class HorizonWeights:
    """Step, knots and weights of one horizon of N steps.

    Attributes
    ----------
    lookahead : Lookahead
        The steps, and a root of the weight of joint speeds.
    ahead : ndarray, (N, 1)
        Times of the steps' ends (s).
    rows : ndarray, (knots m, knots m)
        Commands at the knots from the acting inputs there.
    inputs, offset : ndarray, (knots m, knots m), (knots m, m)
        Weights of the inputs at the knots, and their product with the input that acts.
    hold, hold_offset : ndarray, (knots m, knots m), (knots m, m)
        The same towards a target's input.
    form : ndarray, (n, n)
        A root of the weight of the shape.
    """

    lookahead: Lookahead
    ahead: np.ndarray
    rows: np.ndarray
    inputs: np.ndarray
    offset: np.ndarray
    hold: np.ndarray
    hold_offset: np.ndarray
    form: np.ndarray

    @property
    def step(self) -> float:
        """Δt (s)."""
        return self.lookahead.step


def stiffness_at_rest(
    model: SoftModel, horizon: float, rows: np.ndarray | None = None
) -> tuple[State, np.ndarray, float]:
    """The state at rest, the dynamic stiffness S (n, n) there over a horizon (s), ‖J S⁻¹ Jᵀ‖.

    J (r, n) are `rows`, by default those of the tip.
    """
    state = model.state(model.q0, np.zeros(model.nv))
    S = state.M / horizon**2 + total_damping(state) / horizon + np.diag(model.stiffness)
    J = state.J if rows is None else rows
    return state, S, float(np.linalg.norm(J @ np.linalg.solve(S, J.T), 2))


def horizon_weights(
    model: SoftModel,
    knots: tuple[int, ...],
    horizon: float,
    speed: float,
    rate: float,
    lag: float,
    *,
    blind: bool = False,
    rows: np.ndarray | None = None,
) -> HorizonWeights:
    """The weights of a robot on one horizon.

    Parameters
    ----------
    model : SoftModel
    knots : tuple of int
        Steps at whose ends the inputs are unknown.
    horizon, speed, lag : float
        Horizon, unit of the joint speeds, lag of the actuators (s).
    rate : float
        Weight of the inputs' changes.
    blind : bool
        Whether changes that R does not see count, too, each input by its own entry of R.
    rows : ndarray, (r, n), optional
        The errors' Jacobian at rest, by default that of the tip.

    Raises
    ------
    InputError
        If no joint moves the tip, or the points of `rows`.
    """
    H, step = horizon, horizon / knots[-1]
    state, S, compliance = stiffness_at_rest(model, H, rows)
    if not compliance > 0:
        where, what = f"{model.robot.path}: <task>", f"{model.robot.task!r}, which stands still"
        raise InputError(where, "a frame that some joint moves at q = 0", what)
    factor = np.linalg.cholesky(S)
    R = rate * compliance * state.B.T @ np.linalg.solve(S, state.B)
    lengths = np.diff((0, *knots)).astype(float)
    differences = np.eye(len(knots)) - np.eye(len(knots), k=-1)
    rates = differences.T @ np.diag(1 / lengths) @ differences
    own = np.diag(np.diag(R)) * (HOLD / rate)
    change = R + unseen(R) if blind else R
    return HorizonWeights(
        lookahead=Lookahead(knots, step, speed * H * math.sqrt(compliance) * factor.T.copy()),
        ahead=step * np.arange(1.0, knots[-1] + 1)[:, None],
        rows=np.kron(command_rows(knots, lag, step), np.eye(model.nu)),
        inputs=np.kron(rates, change) + np.kron(np.diag(lengths), SIZE * R),
        offset=np.kron(lengths[:, None], SIZE * R),
        hold=np.kron(np.diag(lengths), own),
        hold_offset=np.kron(lengths[:, None], own),
        form=math.sqrt(FORM * compliance) * factor.T.copy(),
    )


def unseen(R: np.ndarray) -> np.ndarray:
    """The weight (m, m) of changes that R (m, m) does not see: diag(R) on R's null space."""
    size = np.sqrt(np.diag(R))
    scale = np.outer(size, size)
    values, vectors = np.linalg.eigh(R / np.maximum(scale, 1e-300))
    null = vectors[:, values < BLIND * values[-1]]
    result: np.ndarray = scale * (null @ null.T)
    return result


def command_rows(knots: tuple[int, ...], lag: float, step: float) -> np.ndarray:
    """Rows (knots, knots) of the commands at the knots: w_k + λ (w_k - w_(k-1)) / L_k.

    Along a ramp the command is largest in size of its change at the end, so its bounds there serve
    the whole ramp.
    """
    lead = lag / (step * np.diff((0, *knots)))
    return np.diag(1.0 + lead) - np.diag(lead[1:], k=-1)
