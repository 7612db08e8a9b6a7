"""The path of signals between plant and controller: delay, lag, noise, altered states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softdyn import Reference, State
from softdyn.controllers import Command

View = Callable[[State], State]


@dataclass(frozen=True)
class SignalPath:
    """The path of signals between plant and controller.

    Attributes
    ----------
    delay : float
        Time (s) from a state to the input that answers it, in whole control periods.
    lag : float
        Time constant (s) with which the inputs follow the commands.
    noise : float
        Standard deviation (m) of each coordinate of the tip that the controller sees.
    seed : int
        Seed of the noise.
    views : tuple of Callable[[], View]
        Factories of functions that alter a state before the controller sees it. Each is called once
        per run.
    late : bool
        Whether the first input is zero instead of the controller's answer.
    """

    delay: float = 0.0
    lag: float = 0.0
    noise: float = 0.0
    seed: int = 0
    views: tuple[Callable[[], View], ...] = ()
    late: bool = False

    def around(self, controller: Any, period: float) -> Any:
        """`controller` with this path in between, or `controller` itself if the path is ideal."""
        if self == SignalPath(seed=self.seed):
            return controller
        views = [view() for view in self.views]
        if self.noise > 0:
            views.insert(0, Noise(self.noise, self.seed))
        linked = Linked(controller, views, wait=round(self.delay / period), late=self.late)
        return Lagging(linked, self.lag) if self.lag > 0 else linked


class Noise:
    """A view of the state with normal noise of a standard deviation (m) on the tip."""

    def __init__(self, deviation: float, seed: int) -> None:
        self._deviation, self._random = deviation, np.random.default_rng(seed)

    def __call__(self, state: State) -> State:
        """The state that the controller sees instead of `state`."""
        return replace(state, y=state.y + self._deviation * self._random.normal(size=3))


class Linked:
    """A controller that sees states through views and answers `wait` periods later.

    Until the first delayed answer is due, it returns the first answer. A `late` one answers its
    first state with zero input. All other attributes, such as gains and counts, are the inner
    controller's.
    """

    def __init__(
        self, controller: Any, views: list[View], *, wait: int = 0, late: bool = False
    ) -> None:
        self._controller, self._views = controller, views
        self._wait, self._late = wait, late
        self._waiting: list[Any] = []

    def reset(self, period: float) -> None:
        """Begin a run: clear the waiting answers, and reset the controller if it has `reset`."""
        self._waiting.clear()
        if hasattr(self._controller, "reset"):
            self._controller.reset(period)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_controller"], name)

    def __call__(self, state: State, reference: Reference) -> Any:
        """The input that reaches the plant when it is in `state`."""
        for view in self._views:
            state = view(state)
        if self._late:
            self._late = False
            return Command(np.clip(np.zeros(state.model.nu), state.model.u_min, state.model.u_max))
        self._waiting.append(self._controller(state, reference))
        return self._waiting[0] if len(self._waiting) <= self._wait else self._waiting.pop(0)


class Lagging:
    """A controller behind actuators that follow with a time constant λ and start at zero input.

    Over a period T, a command u moves the acting input from a to u + (a - u) e^(-T/λ). The plant
    holds its input, so it gets the mean of this curve. All other attributes are the inner
    controller's.
    """

    def __init__(self, controller: Any, lag: float) -> None:
        self._controller, self._lag = controller, lag

    def reset(self, period: float) -> None:
        """Begin a run: the acting input is zero."""
        share = period / self._lag
        self._left, self._mean = np.exp(-share), -np.expm1(-share) / share
        self._acts: np.ndarray | float = 0.0
        if hasattr(self._controller, "reset"):
            self._controller.reset(period)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_controller"], name)

    def __call__(self, state: State, reference: Reference) -> Any:
        """The mean input that acts over the next period."""
        command = self._controller(state, reference)
        asked = np.asarray(getattr(command, "u", command), float)
        rest = self._acts - asked
        self._acts = asked + self._left * rest
        u = np.clip(asked + self._mean * rest, state.model.u_min, state.model.u_max)
        return Delivered(command, u)


class Delivered:
    """A command whose input was altered on its way."""

    def __init__(self, command: Any, u: np.ndarray) -> None:
        self._command, self.u = command, u

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_command"], name)
