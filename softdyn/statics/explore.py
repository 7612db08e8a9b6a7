"""Find equilibria with the tip near a point, from arbitrary shapes, by bounded least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softdyn.checks import array, whole
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.statics.branch import approach, input_scale
from softdyn.statics.equilibria import balance, rest
from softdyn.statics.equilibrium import Equilibrium, StaticsError
from softdyn.statics.samples import balancing_input
from softdyn.statics.stops import SoftStops

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
    x = np.concatenate((model.coordinates(q), u)) / problem.scale
    for weight in STAGES:
        value, slope = problem.functions(SOFTNESS[0], weight)
        x = problem.inside(x)
        x = least_squares(
            value, x, slope, bounds=(problem.low, problem.high), max_nfev=steps, ftol=1e-6,
            xtol=1e-8, gtol=1e-12,
        ).x  # fmt: skip
    x = np.clip(x, problem.low, problem.high) * problem.scale
    q, u = model.configuration(x[: model.nv]), x[model.nv :]
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
    """The least-squares problem of `explore` in scaled unknowns x = (coordinates, u) / scale."""

    model: SoftModel
    target: np.ndarray
    scale: np.ndarray  # (nv + nu,) size of the unknowns
    force: np.ndarray  # (nv,) size of the residual's rows
    length: float  # size of the tip's error (m)
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def build(cls, model: SoftModel, target: np.ndarray) -> TipProblem:
        """The problem of a robot, with scales from its equilibrium `rest`."""
        start = rest(model)
        span = np.minimum(model.upper - model.lower, 1.0)
        force = np.abs(np.diag(start.stiffness)) * span
        inputs = input_scale(model, start)
        if force.max() <= start.rounding:  # no stiffness at rest: the inputs alone
            force = np.abs(start.state.B) @ inputs
        force = np.maximum(force, 1e-3 * force.max())
        force = np.where(force > 0, force, 1.0)
        scale = np.concatenate((span, inputs))
        low = np.concatenate((model.lower, model.u_min)) / scale
        high = np.concatenate((model.upper, model.u_max)) / scale
        length = max(float(np.linalg.norm(start.y)), 1e-3) / 30
        return cls(model, target, scale, force, length, low, np.maximum(high, low + 1e-12))

    def stops(self, softness: float) -> SoftStops:
        """The soft stops for one of `SOFTNESS`."""
        model = self.model
        return SoftStops(softness * self.force * self.scale[: model.nv], model.lower, model.upper)

    def functions(
        self, softness: float, weight: float
    ) -> tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]:
        """Residual and Jacobian as functions of x, for one softness and one weight of the tip."""
        model, n, stops = self.model, self.model.nv, self.stops(softness)
        little = 1e-3

        def value(x: np.ndarray) -> np.ndarray:
            z = x * self.scale
            state = model.state(model.configuration(z[:n]), np.zeros(n))
            r = state.K + state.bias - state.B @ z[n:]
            forces, _ = stops.push(z[:n], r)
            tip = weight * (state.y - self.target) / self.length
            return np.concatenate(((r - forces) / self.force, tip, little * weight * x[n:]))

        def slope(x: np.ndarray) -> np.ndarray:
            z = x * self.scale
            q = model.configuration(z[:n])
            state = model.state(q, np.zeros(n))
            H = stiffness(model, q, z[n:]) + np.diag(stops.stiffness(z[:n]))
            rows = np.zeros((n + 3 + model.nu, n + model.nu))
            rows[:n, :n] = H / self.force[:, None]
            rows[:n, n:] = -state.B / self.force[:, None]
            rows[n : n + 3, :n] = weight * state.J / self.length
            rows *= self.scale
            rows[n + 3 :, n:] = little * weight * np.eye(model.nu)
            return rows

        return value, slope

    def inside(self, x: np.ndarray) -> np.ndarray:
        """x strictly between its bounds."""
        margin = 1e-6 * np.minimum(self.high - self.low, 1.0)
        return np.clip(x, self.low + margin, self.high - margin)

    def near_stops(self, q: np.ndarray) -> bool:
        """Whether any joint is within a tenth of its scale of a limit."""
        at, near = self.model.coordinates(q), 0.1 * self.scale[: self.model.nv]
        return bool(((at < self.model.lower + near) | (at > self.model.upper - near)).any())

    def to_stops(self, coordinates: np.ndarray) -> np.ndarray:
        """Move a joint to its limit if only the soft stop keeps it away."""
        near = 1e-3 * self.scale[: self.model.nv]
        lower, upper = self.model.lower, self.model.upper
        coordinates = np.where(coordinates < lower + near, lower, coordinates)
        return np.where(coordinates > upper - near, upper, coordinates)
