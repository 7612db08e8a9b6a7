"""Differences of discrete steps, an oracle of their Jacobians."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from softdyn import SoftModel
from softdyn.dynamics import DiscreteStep, Winches, discrete_step
from softdyn.dynamics.model import taut_gains
from softdyn.dynamics.motors import Motors


def moved(model: SoftModel, q: np.ndarray, there: np.ndarray) -> np.ndarray:
    """dq (n,) with q ⊕ dq = there."""
    step = model.coordinates(there) - model.coordinates(q)
    step = np.where(np.abs(step) > np.pi, step - 2 * np.pi * np.sign(step), step)
    if model.robot.floating:
        step[:6] = pin.liegroups.SE3().difference(q[:7], there[:7])
    return step


def differences(
    model: SoftModel,
    q: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    period: float,
    found: DiscreteStep,
    acting: np.ndarray | None = None,
    **settings: bool,
) -> np.ndarray:
    """∂x⁺ by (x, u) with x = (q, v, acting), of fourth order.

    Columns are NaN where a neighbour holds other joints, has other cables slack or inputs at their
    bounds at its end, or takes another number of steps.
    """
    n, size, h, columns = model.nv, len(found.A), 1e-4, []
    if acting is not None:
        settings["motors"] = True
    winched = settings.get("winches") or settings.get("motors")

    def pulls(step: DiscreteStep, begin: np.ndarray | None, commands: np.ndarray) -> list[bool]:
        """Whether each cable's spring and each winch's act at the end of a step."""
        state = model.state(step.q, step.v)
        rates = state.moment_arms @ state.v
        some = [taut_gains(model, state.lengths, rates)[0] != 0]
        if winched:
            felt = commands if begin is None else Motors(model).over(begin, commands, period).mean
            some.append(Winches(model).inputs(state.lengths, rates, felt).by_length != 0)
        return np.concatenate(some).tolist()

    here = pulls(found, acting, u)
    for axis in np.eye(size + model.nu):
        ends = []
        for k in (1, -1, 2, -2):
            x = k * h * axis
            begin = None if acting is None else acting + x[2 * n : size]
            near = discrete_step(
                model, model.integrate(q, x[:n]), v + x[n : 2 * n], u + x[size:], period,
                acting=begin, **settings,
            )  # fmt: skip
            same = near.substeps == found.substeps and (near.held == found.held).all()
            same = same and pulls(near, begin, u + x[size:]) == here
            changes = moved(model, found.q, near.q), near.v - found.v, near.acting - found.acting
            ends.append(np.concatenate(changes) if same else np.full(size, np.nan))
        columns.append((8 * (ends[0] - ends[1]) - ends[2] + ends[3]) / (12 * h))
    return np.array(columns).T
