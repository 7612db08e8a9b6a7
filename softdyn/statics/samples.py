"""Random samples of inputs, shapes and stable equilibria."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from softdyn.checks import instances, whole
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.stops import Stops
from softdyn.statics.branch import approach
from softdyn.statics.equilibria import move, rest, settle
from softdyn.statics.equilibrium import Equilibrium, StaticsError, locked_inputs

STATIONS = 12  # equilibria along a ray of inputs
PUSHES = 1e-9  # singular values below this share of the largest are rounding


def sample_rests(model: SoftModel, rays: int, seed: int = 0) -> Iterator[Equilibrium]:
    """Raise random inputs from rest, and yield the stable or neutral equilibria on the way.

    A robot's useful tensions may be much smaller than its bounds. Each ray of inputs therefore goes
    from a thousandth of its end to its end in equal ratios.

    A direction without stiffness, such as the turn of a continuous joint about a vertical axis, has
    an equilibrium anywhere, and none under an input that pushes along it. There each ray begins
    at a random place, within ±π (rad, m), and does not push.

    Parameters
    ----------
    rays : int
        Number of random inputs; each gives up to `STATIONS` equilibria.
    seed : int
        Seed of the random inputs.
    """
    rng = np.random.default_rng(whole("seed", seed))
    start = rest(model)
    loose = start.loose
    push = loose.T @ start.state.B
    still = np.eye(model.nu) - np.linalg.pinv(push, rcond=PUSHES) @ push
    for end in random_inputs(model, whole("rays", rays), seed):
        q = start.q
        ray = end - start.u
        if loose.size:
            q = move(model, q, loose @ rng.uniform(-math.pi, math.pi, loose.shape[1]))
            ray = still @ ray  # a projection may leave the bounds
            room = np.where(ray > 0, model.u_max - start.u, model.u_min - start.u)
            moved = ray != 0
            ray *= float(np.min(room[moved] / ray[moved], initial=1.0))
        for part in np.geomspace(1e-3, 1.0, STATIONS) * 10 ** -rng.uniform(0.0, 3 / STATIONS):
            try:
                here = settle(model, start.u + part * ray, q)
            except StaticsError:
                break
            q = here.q
            yield here


def sample_between(
    samples: Sequence[Equilibrium], count: int, seed: int = 0
) -> Iterator[Equilibrium]:
    """More stable or neutral equilibria, with tips in the gaps between those of `samples`.

    For each one a random point is drawn in the box around all tips. The search starts at the sample
    closest to the point, and goes towards the point until it turns unstable. It reaches points
    within the reachable set; for other points it ends at the edge of the set.

    Parameters
    ----------
    samples : sequence of Equilibrium
        Equilibria to start from.
    count : int
        Number of equilibria.
    seed : int
        Seed of the points.
    """
    rng = np.random.default_rng(whole("seed", seed))
    known = list(instances("samples", samples, Equilibrium, "an Equilibrium"))
    tips = [one.y for one in known]
    for _ in range(whole("count", count) if known else 0):
        low, high = np.min(tips, axis=0), np.max(tips, axis=0)
        point = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low))
        start = known[int(np.argmin(np.linalg.norm(np.array(tips) - point, axis=1)))]
        one = approach(start, point, 15, stay_stable=True)
        known.append(one)
        tips.append(one.y)
        yield one


def random_inputs(model: SoftModel, count: int, seed: int = 0) -> np.ndarray:
    """Inputs (count, nu) on the surface of the box of bounds, along rays from the least input."""
    rng, count = np.random.default_rng(whole("seed", seed)), whole("count", count)
    origin = check_model(model).relaxed
    ends = rng.uniform(model.u_min, model.u_max, (count, model.nu)) - origin
    room = np.where(ends > 0, model.u_max - origin, model.u_min - origin)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.nanmax(np.where(room == 0, 0.0, ends / room), axis=1, initial=1e-300)
    return np.clip(origin + ends / part[:, None], model.u_min, model.u_max)


def random_shapes(
    model: SoftModel, count: int, seed: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Random (q, u): joints within 0.7 rad and their limits, u the input that balances q best."""
    rng = np.random.default_rng(whole("seed", seed))
    check_model(model)
    for _ in range(whole("count", count)):
        wild = model.coordinates(model.q0) + rng.uniform(-0.7, 0.7, model.nv)
        q = model.configuration(Stops.of(model).within(wild))
        yield q, balancing_input(model, q)


def balancing_input(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """The input (nu,) within its bounds that balances a configuration q (nq,) best."""
    from scipy.optimize import lsq_linear  # imported only here, because it is slow to import

    u = check_model(model).relaxed
    locked = locked_inputs(model)
    free = np.flatnonzero(~locked)
    if free.size:
        state = model.state(q, np.zeros(model.nv))
        goal = state.h - state.B @ np.where(locked, u, 0.0)
        B = state.B if free.size == model.nu else state.B[:, free]
        bounds = (model.u_min[free], model.u_max[free])
        u[free] = lsq_linear(B, goal, bounds, method="bvls").x
    return u
