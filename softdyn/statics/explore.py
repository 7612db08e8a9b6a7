"""Find equilibria with the tip near a point, from arbitrary shapes, by bounded least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softdyn.checks import array, whole
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.stops import Stops
from softdyn.statics.branch import approach, input_scale
from softdyn.statics.equilibria import balance, rest
from softdyn.statics.equilibrium import Equilibrium, StaticsError
from softdyn.statics.samples import balancing_input
from softdyn.statics.stops import SoftStops, locked_inputs

STAGES = (1.0, 0.1, 0.03, 0.01, 0.0)  # weights of the tip's error, relative to the forces
SOFTNESS = (1e-2, 1e-3, 1e-4)  # softness of the stops over a joint's force times its range


def explore(
    model: SoftModel, target: np.ndarray, q: np.ndarray, u: np.ndarray, steps: int = 100
) -> Equilibrium:
    """An equilibrium, stable or not, with its tip near `target`, from an arbitrary shape.

    The method is bounded least squares on (q, u) (SciPy's reflective trust region). The residuals
    are the forces, the tip's error, and u with a small weight, which prefers small inputs. The
    weight of the tip's error falls until only the forces count. Joint limits are `SoftStops` first.
    `approach` then continues with falling softness, and ends with exact stops.

    Parameters
    ----------
    target : ndarray, (3,)
        The target in the world (m).
    q, u : ndarray, (nq,), (nu,)
        The first configuration and input.
    steps : int
        Largest number of evaluations for each weight.

    Raises
    ------
    StaticsError
        If the least squares end at no equilibrium.
    """
    from scipy.optimize import least_squares  # imported only here, because it is slow to import

    target, steps = array("target", target, (3,)), whole("steps", steps, 1)
    q, u = array("q", q, (check_model(model).nq,)), array("u", u, (model.nu,))
    problem = TipProblem.build(model, target)
    x = problem.unknowns(q, u)
    for weight in STAGES:
        value, slope = problem.functions(SOFTNESS[0], weight)
        x = problem.inside(x)
        x = least_squares(
            value, x, slope, bounds=(problem.low, problem.high), max_nfev=steps, ftol=1e-6,
            xtol=1e-8, gtol=1e-12,
        ).x  # fmt: skip
    q, u = problem.shape(np.clip(x, problem.low, problem.high))
    if not problem.near_stops(q):
        try:
            found = balance(model, u, q)
        except StaticsError:  # u also balances the soft stops, and no stiffness takes their place
            found = balance(model, balancing_input(model, q), q)
        return approach(found, target)
    for soft in map(problem.stops, SOFTNESS):
        here = approach(balance(model, u, q, soft), target, 30, soft)
        u, q = here.u, here.q
    coordinates = problem.to_stops(model.coordinates(q))
    return approach(balance(model, u, model.configuration(coordinates)), target)


@dataclass(frozen=True, eq=False)
class TipProblem:
    """The least-squares problem of `explore`, in scaled unknowns.

    The unknowns are the joint coordinates and the inputs that have room between their limits. The
    others keep the one value that they can have.
    """

    model: SoftModel
    target: np.ndarray
    free: np.ndarray  # (unknowns,) their places among (coordinates, u)
    fixed: np.ndarray  # (nv + nu,) the values of the others
    scale: np.ndarray  # (nv + nu,) size of coordinates and inputs
    force: np.ndarray  # (nv,) size of the residual's rows
    length: float  # size of the tip's error (m)
    low: np.ndarray  # (unknowns,)
    high: np.ndarray

    @classmethod
    def build(cls, model: SoftModel, target: np.ndarray) -> TipProblem:
        """The problem of a robot, with scales from its equilibrium `rest`."""
        start = rest(model)
        locked = Stops.of(model).locked
        span = np.where(locked, 1.0, np.minimum(model.upper - model.lower, 1.0))
        force = np.abs(np.diag(start.stiffness)) * span
        inputs = input_scale(model, start)
        if force.max() <= start.rounding:  # no stiffness at rest: the inputs alone
            force = np.abs(start.state.B) @ inputs
        force = np.maximum(force, 1e-3 * force.max())
        force = np.where(force > 0, force, 1.0)
        scale = np.concatenate((span, inputs))
        fixed = np.concatenate((model.lower, model.u_min))
        free = np.flatnonzero(~np.concatenate((locked, locked_inputs(model))))
        low = fixed[free] / scale[free]
        high = np.concatenate((model.upper, model.u_max))[free] / scale[free]
        length = max(float(np.linalg.norm(start.y)), 1e-3) / 30
        return cls(model, target, free, fixed, scale, force, length, low, high)

    def stops(self, softness: float) -> SoftStops:
        """The soft stops for one of `SOFTNESS`."""
        model = self.model
        return SoftStops(softness * self.force * self.scale[: model.nv], model.lower, model.upper)

    def unknowns(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The unknowns of a configuration (nq,) and an input (nu,)."""
        return (np.concatenate((self.model.coordinates(q), u)) / self.scale)[self.free]

    def values(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joint coordinates (nv,) and input (nu,) of the unknowns."""
        z = self.fixed.copy()
        z[self.free] = x * self.scale[self.free]
        return z[: self.model.nv], z[self.model.nv :]

    def shape(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Configuration (nq,) and input (nu,) of the unknowns."""
        coordinates, u = self.values(x)
        return self.model.configuration(coordinates), u

    def functions(
        self, softness: float, weight: float
    ) -> tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]:
        """Residual and Jacobian as functions of x, for one softness and one weight of the tip."""
        model, n, stops = self.model, self.model.nv, self.stops(softness)
        inputs = self.free >= n
        little = 1e-3

        def value(x: np.ndarray) -> np.ndarray:
            coordinates, u = self.values(x)
            state = model.state(model.configuration(coordinates), np.zeros(n))
            r = state.K + state.bias - state.B @ u
            forces, _ = stops.push(coordinates, r)
            tip = weight * (state.y - self.target) / self.length
            return np.concatenate(((r - forces) / self.force, tip, little * weight * x[inputs]))

        def slope(x: np.ndarray) -> np.ndarray:
            coordinates, u = self.values(x)
            q = model.configuration(coordinates)
            state = model.state(q, np.zeros(n))
            H = stiffness(model, q, u) + np.diag(stops.stiffness(coordinates))
            rows = np.zeros((n + 3, n + model.nu))
            rows[:n, :n] = H / self.force[:, None]
            rows[:n, n:] = -state.B / self.force[:, None]
            rows[n:, :n] = weight * state.J / self.length
            rows[:n][stops.locked] = 0.0
            small = np.eye(len(x))[inputs]
            return np.vstack((self.scaled(rows), little * weight * small))

        return value, slope

    def scaled(self, rows: np.ndarray, size: np.ndarray | float = 1.0) -> np.ndarray:
        """Rows by coordinates and inputs as rows by the unknowns, over the rows' size (k, 1)."""
        return np.take(rows * (self.scale / size), self.free, axis=1)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """x strictly between its bounds."""
        margin = 1e-6 * np.minimum(self.high - self.low, 1.0)
        return np.clip(x, self.low + margin, self.high - margin)

    def near_stops(self, q: np.ndarray) -> bool:
        """Whether any joint with room is within a tenth of its scale of a limit."""
        model = self.model
        at, near = model.coordinates(q), 0.1 * self.scale[: model.nv]
        there = (at < model.lower + near) | (at > model.upper - near)
        return bool((there & ~Stops.of(model).locked).any())

    def to_stops(self, coordinates: np.ndarray) -> np.ndarray:
        """Move a joint to its limit if only the soft stop keeps it away."""
        near = 1e-3 * self.scale[: self.model.nv]
        lower, upper = self.model.lower, self.model.upper
        coordinates = np.where(coordinates < lower + near, lower, coordinates)
        return np.where(coordinates > upper - near, upper, coordinates)
