"""Samples: inputs, shapes, and the stable equilibria where a robot can rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from softdyn.checks import instances, whole
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.statics.branch import approach
from softdyn.statics.equilibria import rest, settle
from softdyn.statics.equilibrium import Equilibrium, StaticsError

STATIONS = 12  # equilibria along a ray of inputs


def sample_rests(model: SoftModel, rays: int, seed: int = 0) -> Iterator[Equilibrium]:
    """Stable equilibria that raising random inputs from rest leads to, all along the way.

    A robot's useful tensions may be a small part of what its bounds allow, so a ray goes from a
    thousandth of its end to all of it in equal ratios.

    Parameters
    ----------
    rays : int
        So many inputs are raised, `STATIONS` equilibria each.
    seed : int
        Of the random inputs.
    """
    rng = np.random.default_rng(whole("seed", seed))
    start = rest(model)
    for end in random_inputs(model, whole("rays", rays), seed):
        here = start
        for part in np.geomspace(1e-3, 1.0, STATIONS) * 10 ** -rng.uniform(0.0, 3 / STATIONS):
            try:
                here = settle(model, start.u + part * (end - start.u), here.q)
            except StaticsError:
                break
            yield here


def sample_between(
    samples: Sequence[Equilibrium], count: int, seed: int = 0
) -> Iterator[Equilibrium]:
    """More stable equilibria, with tips where `samples` has few.

    Each goes from the sample closest to a random point of the box around all tips towards that
    point as far as it stays stable: points within the reachable set are met, others mark its edge.

    Parameters
    ----------
    samples : sequence of Equilibrium
        Stable equilibria to start from.
    count : int
        So many.
    seed : int
        Of the points.
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
    """Inputs (count, nu) on the surface of the box of bounds, seen from the least input."""
    rng, count = np.random.default_rng(whole("seed", seed)), whole("count", count)
    origin = np.clip(np.zeros(check_model(model).nu), model.u_min, model.u_max)
    ends = rng.uniform(model.u_min, model.u_max, (count, model.nu)) - origin
    room = np.where(ends > 0, model.u_max - origin, model.u_min - origin)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.nanmax(np.where(room == 0, 0.0, ends / room), axis=1, initial=1e-300)
    return np.clip(origin + ends / part[:, None], model.u_min, model.u_max)


def random_shapes(
    model: SoftModel, count: int, seed: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Random (q, u): joints within 0.7 rad and their limits, the input that balances them best."""
    from scipy.optimize import lsq_linear  # slow to import, and not every process comes here

    rng = np.random.default_rng(whole("seed", seed))
    check_model(model)
    for _ in range(whole("count", count)):
        wild = model.coordinates(model.q0) + rng.uniform(-0.7, 0.7, model.nv)
        q = model.configuration(np.clip(wild, model.lower, model.upper))
        u = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
        if model.nu:
            state = model.state(q, np.zeros(model.nv))
            bounds = (model.u_min, np.maximum(model.u_max, model.u_min + 1e-12))
            u = lsq_linear(state.B, state.K + state.g, bounds, method="bvls").x
        yield q, u
