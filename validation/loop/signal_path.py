"""The path of signals between plant and controller: delay, lag, noise, altered states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import Reference, State
from softdyn.controllers import Command
from softdyn.controllers.predictive.actuation import Actuation
from softdyn.validation.twin.rig import Noise
from softdyn.validation.twin.twin import Twin

View = Callable[[State], State]


@dataclass(frozen=True)
class SignalPath:
    """The path of signals between plant and controller.

    Attributes
    ----------
    delay : float
        Time (s) from a state to the begin of the input that answers it. Before the first input
        arrives, zero input acts, or the one nearest to it within the bounds.
    lag : float
        Time constant (s) with which the inputs follow the commands.
    noise : float
        Noise of q and q̇ that the controller sees, given by its effect on the tip: the root mean
        square (m) of ‖J δq‖ at q = 0. Each joint's standard deviation is the same share of its
        range (of 1 rad or 1 m without limits). The noise of q̇ is that of q over one control period.
    seed : int
        Seed of the noise.
    views : tuple of Callable[[], View]
        Makers of functions that alter a state before the controller sees it; each is called once
        a run.
    late : bool
        Whether the first input is zero, whatever the controller would answer.
    """

    delay: float = 0.0
    lag: float = 0.0
    noise: float = 0.0
    seed: int = 0
    views: tuple[Callable[[], View], ...] = ()
    late: bool = False

    def around(self, controller: Any, period: float) -> Any:
        """`controller` behind the altered states; itself where the states pass unaltered."""
        views = [view() for view in self.views]
        if self.noise > 0:
            views.insert(0, Noise(self.noise, period, self.seed))
        return Linked(controller, views, late=self.late) if views or self.late else controller

    def between(self, twin: Callable[..., Twin]) -> Callable[..., Twin]:
        """A maker of plants whose inputs arrive late and lag; `twin` itself where neither does.

        Both are exact for any time: each plant step gets the mean of the input that acts in it.
        """
        if self.delay == self.lag == 0:
            return twin

        def make(*arguments: Any, **options: Any) -> Twin:
            plant = twin(*arguments, **options)
            path, advance = Actuation(self.delay, self.lag), plant.advance
            path.reset(plant.model.opt.timestep, np.clip(0.0, *plant.model.actuator_ctrlrange.T))

            def later(u: np.ndarray, steps: int = 1) -> None:
                for _ in range(steps):
                    advance(path.send(u))

            plant.advance = later  # type: ignore[method-assign]
            return plant

        return make


class Linked:
    """A controller that sees states through views.

    A `late` one answers its first state with zero input. Everything else, its gains and counts, is
    the inner controller's.
    """

    def __init__(self, controller: Any, views: list[View], *, late: bool = False) -> None:
        self._controller, self._views, self._late = controller, views, late

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_controller"], name)

    def __call__(self, state: State, reference: Reference) -> Any:
        """The answer to the state that the controller sees."""
        for view in self._views:
            state = view(state)
        if self._late:
            self._late = False
            return Command(np.clip(np.zeros(state.model.nu), state.model.u_min, state.model.u_max))
        return self._controller(state, reference)
