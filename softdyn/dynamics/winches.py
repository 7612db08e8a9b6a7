"""Winches: the input that a commanded free length of cable gives, its derivatives, its inverse.

A winch holds the free length c + z of a cable with stiffness k and damping d: its command c plus
the offset z of its motor. At the length ℓ of its tendon and the rate ℓ̇, the tension and the input
are

    T = max(0, k (ℓ - c - z) + d ℓ̇),    u = -T / gear, clipped to [lower, upper].

A tendon that may be slack has the same tension with its rest length in place of c + z. Where
neither bound acts,

    ∂u/∂ℓ = -k / gear,    ∂u/∂ℓ̇ = -d / gear,    ∂u/∂c = k / gear.

The derivatives are zero where the cable is slack or u is at a bound.
`softdyn.dynamics.balance.ForceBalance` has the joint forces under commands, and their Jacobians.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from softdyn.checks import read_only, vector
from softdyn.description.rig import Actuator
from softdyn.dynamics.model import SoftModel, State, check_model, check_state
from softdyn.dynamics.projection import underlying_tree


class MotorInputs(NamedTuple):
    """The inputs under commands, with their derivatives.

    Attributes
    ----------
    u : ndarray, (m,)
        The inputs.
    by_length, by_rate, by_command : ndarray, (m,)
        Derivatives of each input by the length and the rate of its tendon, and by its command.
    """

    u: np.ndarray
    by_length: np.ndarray
    by_rate: np.ndarray
    by_command: np.ndarray


class Winches:
    """The inputs u (m,) that a robot's motors give under commands (m,), in the order of u.

    The command of a motor that regulates its force is u itself. The command of a winch is its free
    length of cable less the motor's offset (m). A winch whose driver regulates the velocity has the
    free length as a state of its own, which the driver integrates, ċ = command, within its bounds.
    The methods then take this free length as the command.

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
    tendon : ndarray of int, (m,)
        The tendon of each input.
    stiffness, damping : ndarray, (m,)
        The winch cable's k (N/m) and d (N s/m); zero for other motors.
    lower, upper : ndarray, (m,)
        Bounds of the commands: of the free lengths less their offsets (m), and of u for other
        motors.
    offset : ndarray, (m,)
        Free length at the command 0 (m); zero for other motors.
    """

    def __init__(self, model: SoftModel, actuators: tuple[Actuator, ...] | None = None) -> None:
        self.model = check_model(model)
        tree, _ = underlying_tree(model)
        actuators = model.robot.actuators if actuators is None else actuators
        self.winds = np.array([actuator.is_winch for actuator in actuators], bool)
        self.winds.flags.writeable = False
        self.stiffness = read_only([actuator.stiffness for actuator in actuators])
        self.damping = read_only([actuator.damping for actuator in actuators])
        self.offset = read_only([actuator.zero for actuator in actuators])
        self.lower, self.upper = (
            read_only(np.where(self.winds, np.subtract(lengths, self.offset), inputs))
            for lengths, inputs in (
                ([actuator.length_lower for actuator in actuators], model.u_min),
                ([actuator.length_upper for actuator in actuators], model.u_max),
            )
        )
        self._actuators, self.tendon = tuple(actuators), tree.actuated
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
            Commands of the winches (m), and u of the other motors.

        Raises
        ------
        InputError
            For a State of another robot, a wrong shape or a number that is not finite, as in
            `commands`.
        """
        check_state(self.model, state)
        commands = vector("commands", commands, self.model.nu)
        return self.inputs(state.lengths, state.moment_arms @ state.v, commands).u

    def commands(self, state: State, u: np.ndarray) -> np.ndarray:
        """The commands (m,) that give the inputs u: the inverse of `tensions` within the bounds.

        The command of a winch is c = ℓ - (T - d ℓ̇) / k - z with T = -gear u, clipped to the
        winch's bounds. u = 0 gives the length at which the cable is just slack.

        Parameters
        ----------
        state : State
            The robot's state.
        u : array_like, (m,)
            Inputs.
        """
        check_state(self.model, state)
        u = vector("u", u, self.model.nu)
        lengths, rates = state.lengths[self.tendon], (state.moment_arms @ state.v)[self.tendon]
        free = lengths + (self._gear * u + self.damping * rates) / self._divisor
        return np.where(self.winds, np.clip(free - self.offset, self.lower, self.upper), u)

    def inputs(self, lengths: np.ndarray, rates: np.ndarray, commands: np.ndarray) -> MotorInputs:
        """The inputs at these lengths and rates (tendons,) under commands (m,), and derivatives."""
        lengths, rates = lengths[self.tendon], rates[self.tendon]
        tension = self.stiffness * (lengths - commands - self.offset) + self.damping * rates
        free = -np.maximum(tension, 0.0) / self._gear
        u = np.clip(free, self.model.u_min, self.model.u_max)
        inside = self.winds & (tension > 0) & (u == free)
        by_length = np.where(inside, -self.stiffness / self._gear, 0.0)
        return MotorInputs(
            np.where(self.winds, u, commands),
            by_length,
            np.where(inside, -self.damping / self._gear, 0.0),
            np.where(self.winds, -by_length, 1.0),
        )
