"""Targets of shape and input for the predictive controller: equilibria that hold the tip."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from threading import Thread
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from softdyn import SoftModel, statics
from softdyn.statics import Equilibrium, StaticsError

Result = TypeVar("Result")
WITHIN = 5e-3  # m: equilibria whose tips are this close to the reference count as equally near
SHAPES = 6  # random shapes from which the search starts
BENDS = (0.33, 0.42, 0.56, 0.67)  # of the joints: beyond them the bend is reversed
MORE = 2.5  # factor on shape and inputs there


@dataclass(frozen=True, eq=False)
class RestTarget:
    """An equilibrium (q*, u*) for a reference of the tip.

    Attributes
    ----------
    q : ndarray, (nq,)
        Configuration.
    u : ndarray, (nu,)
        Input.
    stable : bool
        Whether it is stable without control.
    distance : float
        From its tip to the reference (m).
    """

    q: np.ndarray
    u: np.ndarray
    stable: bool
    distance: float


def in_future(work: Callable[[], Result], background: bool) -> Future[Result]:
    """The result of some work, done at once or in a thread."""
    answer: Future[Result] = Future()

    def do() -> None:
        try:
            answer.set_result(work())
        except BaseException as error:  # the controller's thread has to see it
            answer.set_exception(error)

    if background:  # a daemon, so that the program's end does not wait for it
        Thread(target=do, daemon=True).start()
    else:
        answer.set_result(work())
    return answer


def instability(one: Equilibrium) -> tuple[float, float]:
    """Sum of the unstable poles' real parts, and the rightmost pole's (1/s)."""
    real = one.poles.real
    return float(real[real > 0].sum()), float(real[0])


def reversed_bends(
    model: SoftModel, q: np.ndarray, u: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Shapes bent more than q, and the other way beyond some joint, with inputs larger than u."""
    made = []
    for share in BENDS:
        shape = MORE * model.coordinates(q)
        shape[round(share * model.nv) :] *= -1.0
        shape = np.clip(shape, model.lower, model.upper)
        made.append((model.configuration(shape), np.clip(MORE * u, model.u_min, model.u_max)))
    return made


# the searches of each model, which all its controllers share
_ASKED: WeakKeyDictionary[SoftModel, dict[tuple[bool, bytes], Future[RestTarget | None]]]
_ASKED = WeakKeyDictionary()


class RestTargets:
    """The target of each set point, found once for a model and kept.

    The target is the equilibrium with the least sum of unstable poles, then the leftmost rightmost
    one, of those that `statics.inputs_for_tip` finds within 5 mm of the set point, or of the
    nearest. The sum bounds the effort of holding it. The search also starts at shapes that are bent
    more than the branch from rest, and the other way beyond some joint. It takes seconds, and its
    result depends on the robot and the set point alone.

    Parameters
    ----------
    model : SoftModel
        The robot.
    background : bool
        Whether to search in a thread, for a loop in real time.
    """

    def __init__(self, model: SoftModel, background: bool = False) -> None:
        self._model, self.background = model, background
        self._asked = _ASKED.setdefault(model, {})

    def ask(self, y: np.ndarray) -> Future[RestTarget | None]:
        """The target for the tip at y (3,); None if the robot has no equilibrium to start from."""
        key = self.background, np.asarray(y, float).tobytes()
        if key not in self._asked:
            self._asked[key] = in_future(partial(self._search, y), self.background)
        return self._asked[key]

    def __reduce__(self) -> tuple[Any, ...]:
        return RestTargets, (self._model, self.background)

    def _search(self, y: np.ndarray) -> RestTarget | None:
        model = self._model
        try:
            plain = statics.approach(statics.rest(model), y, stay_stable=True)
            bent = reversed_bends(model, plain.q, plain.u)
            search = statics.inputs_for_tip(model, y, [plain], guesses=bent, shapes=SHAPES)
        except (StaticsError, np.linalg.LinAlgError):
            return None
        within = max(WITHIN, search.distance(search.nearest))
        near = [one for one in search.found if search.distance(one) <= within]
        best = min(near, key=instability)
        return RestTarget(best.q, best.u, best.stable, search.distance(best))
