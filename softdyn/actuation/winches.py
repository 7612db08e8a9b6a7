"""Winches: the input that a commanded free length of cable gives, its derivatives, its inverse.

A winch holds the free length c of a cable with stiffness k and damping d. The tendon has the length
ℓ and the moment arms a = ∂ℓ/∂q, so ℓ̇ = a q̇. The tension and the input are

    T = max(0, k (ℓ - c) + d ℓ̇),    u = -T / gear, clipped to [lower, upper].

A tendon that may be slack has the same tension with its rest length in place of c. Where neither
bound acts,

    ∂u/∂q = -(k a + d ȧ) / gear,    ∂u/∂q̇ = -d a / gear,    ∂u/∂c = k / gear,

with ȧ = (∂a/∂q) q̇. The derivatives are zero where the cable is slack or u is at a bound.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from softdyn.checks import read_only, vector
from softdyn.description.rig import Actuator
from softdyn.dynamics.derivatives import (
    Derivatives,
    acceleration_derivatives,
    tendon_curvature,
)
from softdyn.dynamics.model import SoftModel, State, check_model, check_state
from softdyn.dynamics.projection import underlying_tree


class Winches:
    """The inputs u (m,) that a robot's motors give under commands (m,), in the order of u.

    The command of a motor that regulates its force is u itself. The command of a winch is its free
    length c of cable (m). A winch whose driver regulates the velocity has the free length as a
    state of its own, which the driver integrates, ċ = command, within its bounds. The methods then
    take this free length as the command.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    actuators : tuple of Actuator, optional
        Actuators that replace those of the robot, one for each input.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    winds : ndarray of bool, (m,)
        Whether each input is a winch.
    stiffness, damping : ndarray, (m,)
        The winch cable's k (N/m) and d (N s/m); zero for other motors.
    lower, upper : ndarray, (m,)
        Bounds of the commands: of the free lengths (m), and of u for other motors.
    """

    def __init__(self, model: SoftModel, actuators: tuple[Actuator, ...] | None = None) -> None:
        self.model = check_model(model)
        tree, _ = underlying_tree(model)
        actuators = model.robot.actuators if actuators is None else actuators
        self.winds = np.array([actuator.is_winch for actuator in actuators], bool)
        self.winds.flags.writeable = False
        self.stiffness = read_only([actuator.stiffness for actuator in actuators])
        self.damping = read_only([actuator.damping for actuator in actuators])
        self.lower, self.upper = (
            read_only(np.where(self.winds, lengths, inputs))
            for lengths, inputs in (
                ([actuator.length_lower for actuator in actuators], model.u_min),
                ([actuator.length_upper for actuator in actuators], model.u_max),
            )
        )
        self._actuators, self._tendon = tuple(actuators), tree.actuated
        # results for other motors are discarded; 1 avoids a division by zero
        self._gear = np.where(self.winds, tree.gear, 1.0)
        self._divisor = np.where(self.winds, self.stiffness, 1.0)

    def __reduce__(self) -> tuple[Any, ...]:
        return Winches, (self.model, self._actuators)

    def tensions(self, state: State, commands: np.ndarray) -> np.ndarray:
        """The inputs u (m,): u = T / |gear| of a cable that pulls; a commanded force unchanged.

        Parameters
        ----------
        state : State
            The robot's state.
        commands : array_like, (m,)
            Free lengths of the winches (m), and u of the other motors.

        Raises
        ------
        InputError
            For a State of another robot, a wrong shape or a number that is not finite, as in the
            other methods.
        """
        commands = self._checked(state, commands)
        return np.where(self.winds, self._wound(state, commands)[0], commands)

    def commands(self, state: State, u: np.ndarray) -> np.ndarray:
        """The commands (m,) that give the inputs u: the inverse of `tensions` within the bounds.

        The free length of a winch is c = ℓ - (T - d ℓ̇) / k with T = -gear u, clipped to the
        winch's bounds. u = 0 gives the length at which the cable is just slack.

        Parameters
        ----------
        state : State
            The robot's state.
        u : array_like, (m,)
            Inputs.
        """
        u = self._checked(state, u)
        lengths, rates, _ = self._cables(state)
        free = lengths + (self._gear * u + self.damping * rates) / self._divisor
        return np.where(self.winds, np.clip(free, self.lower, self.upper), u)

    def derivatives(self, state: State, commands: np.ndarray) -> Derivatives:
        """`tensions` and its Jacobians by q and q̇ (m, n), and by the commands (m, m).

        Parameters
        ----------
        state : State
            The robot's state.
        commands : array_like, (m,)
            Free lengths of the winches (m), and u of the other motors.
        """
        commands = self._checked(state, commands)
        wound, inside = self._wound(state, commands)
        arms = self._cables(state)[2]
        by_length = np.where(inside, -self.stiffness / self._gear, 0.0)
        by_rate = np.where(inside, -self.damping / self._gear, 0.0)
        by_q = by_length[:, None] * arms
        if by_rate.any():
            none = np.zeros(len(state.lengths))
            _, arm_rates = tendon_curvature(self.model, state.q, none, state.v)
            by_q += by_rate[:, None] * arm_rates[self._tendon]
        by_command = np.diag(np.where(self.winds, -by_length, 1.0))
        u = np.where(self.winds, wound, commands)
        return Derivatives(u, by_q, by_rate[:, None] * arms, by_command)

    def acceleration_derivatives(
        self, q: np.ndarray, v: np.ndarray, commands: np.ndarray
    ) -> Derivatives:
        """q̈ under constant commands and its Jacobians by q, q̇ (n, n) and the commands (n, m).

        Parameters
        ----------
        q : array_like, (nq,)
            Configuration.
        v : array_like, (n,)
            Velocity.
        commands : array_like, (m,)
            Free lengths of the winches (m), and u of the other motors.
        """
        inputs = self.derivatives(self.model.state(q, v), commands)
        found = acceleration_derivatives(self.model, q, v, inputs.value)
        return Derivatives(
            found.value,
            found.q + found.u @ inputs.q,
            found.v + found.u @ inputs.v,
            found.u @ inputs.u,
        )

    def _checked(self, state: State, commands: np.ndarray) -> np.ndarray:
        check_state(self.model, state)
        return vector("commands", commands, self.model.nu)

    def _cables(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Length and rate (m,) and moment arms (m, n) of the tendon of each input."""
        arms = state.moment_arms[self._tendon]
        return state.lengths[self._tendon], arms @ state.v, arms

    def _wound(self, state: State, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u (m,) of each input as a winch, and whether it is one without an active bound."""
        lengths, rates, _ = self._cables(state)
        tension = self.stiffness * (lengths - commands) + self.damping * rates
        u = -np.maximum(tension, 0.0) / self._gear
        low, high = self.model.u_min, self.model.u_max
        return np.clip(u, low, high), self.winds & (tension > 0) & (u > low) & (u < high)
