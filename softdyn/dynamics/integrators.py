"""One step of time integration of the analytic model under a constant input.

`ModelMotion` takes such steps between joint stops. With the input u(q, q̇), whose part along the
velocities is D_u = -B ∂u/∂q̇, and the force p of the stops at its end, its step is

    (M + h (D + D_u)) (v⁺ - v) = h (B u - h(q, v) + p),    q⁺ = q ⊕ h v⁺.

With forces of one's own D is D - ∂F/∂q̇. The torques z of Maxwell branches (`relaxation`) are those
at the step's begin; then they follow q⁺.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softdyn.checks import array, number
from softdyn.dynamics.derivatives import total_damping
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.relaxation import Branches
from softdyn.dynamics.stops import Stops

Step = tuple[np.ndarray, np.ndarray]
Pull = Callable[[State], tuple[np.ndarray, np.ndarray | None]]


def step_rk4(model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float) -> Step:
    """Classical Runge–Kutta of order 4; stable for h λmax(M⁻¹D) below about 2.8.

    Parameters
    ----------
    model : SoftModel
        Any robot's model.
    q, v, u : array_like, (nq,), (nv,), (nu,)
        Configuration, velocity, input.
    h : float
        Step (s), may be negative.

    Raises
    ------
    InputError
        For an argument of the wrong shape or not finite, or if the state overflows within the step.
    """
    h = number("h", h)
    a1 = model.forward_dynamics(q, v, u)
    v2 = v + h / 2 * a1
    a2 = model.forward_dynamics(model.integrate(q, h / 2 * v), v2, u)
    v3 = v + h / 2 * a2
    a3 = model.forward_dynamics(model.integrate(q, h / 2 * v2), v3, u)
    v4 = v + h * a3
    a4 = model.forward_dynamics(model.integrate(q, h * v3), v4, u)
    return (
        model.integrate(q, h / 6 * (v + 2 * v2 + 2 * v3 + v4)),
        v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4),
    )


def step_implicit(model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float) -> Step:
    """Semi-implicit Euler with implicit damping, (M + h D) a = B u - h(q, v); order 1.

    With one's own forces, and with dampers that are not linear, ∂(D q̇ - F)/∂q̇ stands for D on the
    left side. It is the scheme of MuJoCo's ``implicitfast``. It stays stable for any damping. This
    matters, because the damping is the stiff part of soft robots: λmax(M⁻¹D) is 1e4 and more.

    Parameters
    ----------
    model : SoftModel
        Any robot's model.
    q, v, u : array_like, (nq,), (nv,), (nu,)
        Configuration, velocity, input.
    h : float
        Step (s), may be negative.

    Raises
    ------
    InputError
        For an argument of the wrong shape or not finite.
    """
    h, u = number("h", h), array("u", u, (model.nu,))
    state = model.state(q, v)
    v = state.v + h * np.linalg.solve(state.M + h * total_damping(state), state.B @ u - state.h)
    return model.integrate(q, h * v), v


class ModelMotion:
    """The motion of the analytic model between its joint stops, step by step.

    A joint that would leave its limits ends at its stop, which pushes and does not pull
    (`Stops.solve`). Without a joint at a stop the steps are those of `step_implicit`, or of
    `step_rk4`. A step of the latter in which a joint meets its stop is one of the former.

    Parameters
    ----------
    model : SoftModel
        Any robot's model.
    step : float
        h (s).
    rk4 : bool
        Whether steps are of order 4. They are explicit: a step too long for the damping diverges.
        They have no Maxwell branches.

    Attributes
    ----------
    q, v : ndarray, (nq,), (n,)
        The present state.
    """

    def __init__(self, model: SoftModel, step: float, *, rk4: bool = False) -> None:
        self._model, self._h, self._rk4 = model, number("step", step, above=0.0), rk4
        creeps = any(joint.relaxation for joint in model.robot.joints)
        self._branches = Branches.of(model) if creeps else None
        self.start(model.q0, np.zeros(model.nv))

    def start(self, q: np.ndarray, v: np.ndarray) -> None:
        """Begin in a state. A stop beyond which a joint begins is where the joint is."""
        state = self._model.state(q, v)
        self.q, self.v = state.q, state.v
        at, stops = self._model.coordinates(self.q), Stops.of(self._model)
        self._stops = Stops(np.minimum(stops.lower, at), np.maximum(stops.upper, at))
        self._held = np.zeros(self._model.nv, np.int64)
        self._state: State | None = state
        self._torques = np.zeros(0 if self._branches is None else len(self._branches.time))

    @property
    def state(self) -> State:
        """The present state with its terms."""
        if self._state is None:
            self._state = self._model.state(self.q, self.v)
        return self._state

    def move(self, pull: Pull) -> None:
        """One step.

        Parameters
        ----------
        pull : Callable[[State], tuple[ndarray, ndarray or None]]
            The input u (m,) at a state, and its derivatives ∂u/∂ℓ̇ (m,) by the rates of the inputs'
            tendons times their moment arms (m, n); None where they are zero.

        Raises
        ------
        FloatingPointError
            The state would not be finite, or a step of order 4 is unstable.
        LinAlgError
            The matrix is singular, or no speeds balance the forces of joints and stops.
        """
        q, v = self._fourth_order(pull) if self._rk4 else (self.q, self.v)
        if not self._rk4 or not self._within(q):
            q, v = self._implicit(pull)
            if self._rk4 and not self._held.any():
                raise FloatingPointError("an explicit step that is too long for the damping")
        if not np.isfinite(q @ q + v @ v):
            raise FloatingPointError("a state that is not finite")
        self.q, self.v, self._state = q, v, None
        if (branches := self._branches) is not None:
            moved = self._h * (branches.rates @ v)
            self._torques *= branches.decay(self._h)
            self._torques += branches.gain(self._h) * moved

    def _within(self, q: np.ndarray) -> bool:
        if not np.isfinite(q).all():
            return True
        at = self._model.coordinates(q)
        return bool((self._stops.within(at) == at).all())

    def _implicit(self, pull: Pull) -> Step:
        model, h, state = self._model, self._h, self.state
        u, slopes = pull(state)
        h_all = state.h
        if self._branches is not None:
            h_all = h_all + self._torques @ self._branches.rates
        D = total_damping(state)
        A = state.M + h * (D if slopes is None else D - state.B @ slopes)
        if not self._held.any():
            v = state.v + h * np.linalg.solve(A, state.B @ u - h_all)
            q = model.integrate(state.q, h * v)
            if self._within(q):
                return q, v
        r = h_all - state.B @ u - A @ state.v / h
        at = model.coordinates(state.q)
        v, self._held = self._stops.solve(A / h, r, at, h, self._held)
        q = model.integrate(state.q, h * v)
        if model.nq == model.nv:  # no rounding beyond a stop
            q = np.where(self._held > 0, self._stops.upper, q)
            q = np.where(self._held < 0, self._stops.lower, q)
        return q, v

    def _fourth_order(self, pull: Pull) -> Step:
        model, h = self._model, self._h
        rates = list[Step]()
        for span in (0.0, h / 2, h / 2, h):
            state = self.state
            if rates:
                move, change = span * rates[-1][0], span * rates[-1][1]
                if not np.isfinite(move @ move + change @ change):
                    return np.full(model.nq, np.nan), change
                state = model.state(model.integrate(self.q, move), self.v + change)
            u, _ = pull(state)
            rates.append((state.v, np.linalg.solve(state.M, state.B @ u - state.h)))
        (v1, a1), (v2, a2), (v3, a3), (v4, a4) = rates
        q = model.integrate(self.q, h / 6 * (v1 + 2 * v2 + 2 * v3 + v4))
        return q, self.v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
