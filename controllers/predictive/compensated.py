"""Any controller behind actuators with a known lag and delay, and cables with known friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.checks import vector
from softdyn.controllers.channels import values_of
from softdyn.controllers.controller import IDEAL, SILENT, Command, KnownRig, WrappingController
from softdyn.controllers.predictive.actuation import Actuation
from softdyn.controllers.predictive.prediction import ahead
from softdyn.controllers.predictive.pulls import FrictionPulls
from softdyn.controllers.predictive.stops import held_joints, stop_stiffness
from softdyn.dynamics.derivatives import tangent_dynamics

STEP = 2e-3  # s; the longest step of the prediction


class Compensated(WrappingController):
    """A controller that gets the state at which its command will begin to act.

    The state is predicted over the delay by backward Euler, with the dynamics linearised at the
    present state and the inputs that are on their way. The reference is moved by the delay along
    y + t ẏ + ½ t² ÿ. The command is the one under which the input that acts reaches the
    controller's answer in one period: c = a + (u - a) / (1 - e^(-T/λ)), within the bounds.

    Where the robot's cables rub, the pulls make up for it (`controllers.predictive.pulls`). This
    serves controllers that estimate no disturbance. Soft ID-CLF-QP on the finger at μ = 0.1 tracks
    with a mean square error of 0.22 cm² without it, of 0.05 with it and of 0.03 without friction.
    A μ twice too large makes it chatter: 1.2 cm², with changes of the input by a third of its range
    in each period. Half of the true μ gives 0.13 cm².

    Two things limit it. One-sided inputs cannot fall faster than e^(-t/λ), so a long lag cannot be
    inverted. The prediction is as good as the delay that it is given.

    Parameters
    ----------
    controller : Callable[[State, Reference], Command]
        Any controller, also a user's own.
    model : SoftModel
        The robot.
    lag, delay : float, optional
        Lag and delay of the actuators (s); by default those of the plant that `reset` names, else
        the longest of the robot's file.
    friction : float or array_like, (tendons,), optional
        Coefficients of the cables' friction; by default as for lag and delay.

    Raises
    ------
    InputError
        A controller that cannot be called, one of tasks behind a delay, a time that is negative, a
        delay of more than 10 s.
    """

    def __init__(
        self,
        controller: Callable[[State, Reference], Any],
        model: SoftModel,
        *,
        lag: float | None = None,
        delay: float | None = None,
        friction: np.ndarray | float | None = None,
    ) -> None:
        super().__init__(controller, model, "compensated {}")
        self._model, self._given = model, (delay, lag, friction)
        self.reset(STEP)

    def reset(self, period: float, rig: KnownRig | None = None) -> None:
        """Begin a run with a control period (s), on a plant behind a rig; by default the file's.

        The other controller begins as on a plant without a rig, which this one makes of it.

        Raises
        ------
        InputError
            As `Actuation.reset` does, and for tasks behind a delay.
        """
        super().reset(period, IDEAL)
        delay, lag, friction = self._given
        self.actuation = Actuation.of(self._model, delay, lag, rig)
        self._pulls = FrictionPulls(self._model, friction, rig)
        if self.tasks and self.actuation.delay > 0:  # it moves one reference only
            raise InputError("controller", "best or mpc, for tasks behind a delay", self.inner)
        self.actuation.reset(period, self.guard.held)

    @SILENT
    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        link = self.actuation
        acting = link.acting
        if link.delay > 0:
            state, acting = self._predicted(state)
            t = link.delay
            reference = Reference(
                reference.y + t * reference.ydot + 0.5 * t * t * reference.yddot,
                reference.ydot + t * reference.yddot,
                reference.yddot,
            )
        answer = self.inner(state, reference)
        u = self._admit(getattr(answer, "u", answer))
        command = self.guard.accept(
            link.command_for(u, acting), getattr(answer, "V", np.nan),
            getattr(answer, "delta", np.nan), clamped=True,
        )  # fmt: skip
        link.send(command.u)
        u = self._pulls(command.u, state) if self._pulls.rubs else command.u
        return replace(
            command, u=u, distance=getattr(answer, "distance", np.nan),
            values=values_of(self.channels, answer),
        )  # fmt: skip

    def applied(self, u: np.ndarray) -> None:
        """The input u (nu,) was sent instead of the last command's.

        Raises
        ------
        InputError
            For a wrong shape or a number that is not finite.
        """
        self.actuation.send_instead(self._pulls.inputs(vector("u", u, self._model.nu)))

    def _predicted(self, state: State) -> tuple[State, np.ndarray]:
        """The state and the acting input (nu,) after the delay."""
        model, link = self._model, self.actuation
        acting, v = link.acting, state.v
        K, D = tangent_dynamics(model, state.q, v, acting)
        means, u = link.over_delay(STEP)
        step = link.delay / len(means)
        stops = stop_stiffness(state, held_joints(state), step)
        linear = state.M, K + np.diag(stops), D, state.B
        force = state.B @ acting - state.h + D @ v
        p, speed, _ = ahead(linear, force, (np.zeros(model.nv), v), means - acting, step)
        if not np.isfinite(p @ p + speed @ speed):
            return state, u
        return model.state(model.integrate(state.q, p), speed), u
