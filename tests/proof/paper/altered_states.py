"""States that a controller sees as the reference implementation computes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softdyn import Reference, State
from softdyn.controllers import Command

View = Callable[[State], State]


def seen(state: State, **changes: Any) -> State:
    """A read-only copy of `state` with other terms; `C` and `g` can be replaced, too."""
    own: dict[str, Any] = {name: changes.pop(name) for name in ("C", "g") if name in changes}
    for value in (*changes.values(), *own.values()):
        value.flags.writeable = False
    copy = replace(state, **changes)
    vars(copy).update(own)
    return copy


def wrong_sign(state: State) -> State:
    """Springs and dampers enter h with the wrong sign, so that they are doubled, not cancelled."""
    return seen(state, K=-state.K, D=-state.D, h=state.bias - state.D @ state.v - state.K)


def no_coriolis(state: State) -> State:
    """C = 0, and g is the whole bias C q̇ + g."""
    return seen(state, C=np.zeros_like(state.M), g=np.array(state.bias))


class Stale:
    """M, bias and passive forces are one control step old; J, B and the tip are current."""

    def __init__(self) -> None:
        self._last: State | None = None

    def __call__(self, state: State) -> State:
        """The state that the controller sees instead of `state`."""
        last, self._last = self._last or state, state
        passive = last.h - last.bias
        return seen(
            state,
            M=np.array(last.M), bias=np.array(last.bias), h=np.array(last.h),
            K=passive - state.D @ state.v,  # then D q̇ + K is the old passive force
            g=np.array(last.g), C=np.array(last.C),
        )  # fmt: skip


def always(view: View) -> View:
    """A factory for a view without memory."""
    return view


@dataclass(frozen=True)
class AlteredStates:
    """Puts a controller behind altered states.

    Attributes
    ----------
    views : tuple of Callable[[], View]
        Makers of functions that alter a state before the controller sees it; each is called once
        a run.
    late : bool
        Whether the first input is zero, whatever the controller would answer.
    """

    views: tuple[Callable[[], View], ...] = ()
    late: bool = False

    def __call__(self, controller: Any) -> Linked:
        """`controller` behind the altered states."""
        return Linked(controller, [view() for view in self.views], late=self.late)


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
            return Command(state.model.relaxed)
        return self._controller(state, reference)
