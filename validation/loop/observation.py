"""An observer in a closed loop: from the readings of sensors to the controller's state."""

from __future__ import annotations

from time import perf_counter_ns
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError, SoftModel, State
from softdyn.controllers.registry import find_controller, is_own, one_line_errors
from softdyn.estimation import Ekf, Observer
from softdyn.exceptions import errors_in
from softdyn.validation.twin.rig import Rig, RiggedPlant, rig_of

WORDS = "the names of disturbances, or FILE.py:CLASS"


class Observation:
    """The observer of one run.

    Parameters
    ----------
    observer : Observer
        An `Ekf`, or a class of your own with `step` and maybe `reset`. One with `disturbance_units`
        has the estimates' `disturbances` and their `deviations` in the log.
    model : SoftModel
        The model that the controller has.

    Attributes
    ----------
    nanoseconds : int
        Time that the last estimate took.
    units : dict of str to str
        Units of the components of the estimated disturbances by their names.
    disturbances : ndarray, (2, nd)
        The last estimate of these, and its deviations.

    Raises
    ------
    InputError
        An object without a method `step`, or one for other sensors than those of the rig.
    """

    def __init__(self, observer: Observer, model: SoftModel, rig: RiggedPlant | None) -> None:
        _check(observer)
        if rig is None or len(rig.readings.names) == 0:
            raise InputError("observer", 'a rig with sensors, such as rig="file"', "none")
        if rig.alters_states:
            expected = "a rig that alters readings alone: no noise, bias or latency of q and v"
            raise InputError("observer", expected, "one that alters q and v")
        takes = getattr(observer, "components", len(rig.readings.names))
        if takes != len(rig.readings.names):
            raise InputError(
                "observer", f"one for {len(rig.readings.names)} readings", f"for {takes}"
            )
        self._observer, self._model, self.nanoseconds = observer, model, 0
        self.units: dict[str, str] = getattr(observer, "disturbance_units", {})
        self.disturbances = np.full((2, len(self.units)), np.nan)

    def reset(self) -> None:
        """Begin a run."""
        if hasattr(self._observer, "reset"):
            self._observer.reset()

    def __call__(self, t: float, measured: np.ndarray, sent: np.ndarray) -> State:
        """The estimated state; it has the estimate's `covariance`, if there is one.

        Parameters
        ----------
        t : float
            Time (s).
        measured : ndarray, (k,)
            The sensors' readings at t.
        sent : ndarray, (nu,)
            The commands sent at the last control step.
        """
        began = perf_counter_ns()
        estimate = self._observer.step(t, measured, sent)
        with errors_in("the observer's estimate"):
            state = self._model.state(estimate.q, estimate.v)
        if self.units:
            try:
                np.concatenate([*estimate.disturbances.values()], out=self.disturbances[0])
                np.concatenate([*estimate.deviations.values()], out=self.disturbances[1])
            except (AttributeError, TypeError, ValueError):
                expected = f"disturbances and deviations of {len(self.units)} components"
                raise InputError("the observer's estimate", expected, "others") from None
        covariance = getattr(estimate, "covariance", None)
        if covariance is not None:
            state = State.trusted(**vars(state), covariance=covariance)
        self.nanoseconds = perf_counter_ns() - began
        return state


def make_observer(model: SoftModel, rig: Rig | str | None, words: str) -> Any:
    """The observer that a command's option means: an `Ekf` of the rig, or a user's class.

    Parameters
    ----------
    model : SoftModel
        The robot.
    rig : Rig or str or None
        The rig of the run; its motors and sensors are those of the `Ekf`.
    words : str
        Names of disturbances, separated by commas, maybe none; or FILE.py:CLASS, which is built as
        CLASS(model).

    Raises
    ------
    InputError
        No rig, an unknown disturbance, a class that cannot be made.
    """
    given = rig_of(rig)
    if given is None:
        raise InputError("observer", 'a rig with sensors, such as rig="file"', "none")
    rigged = softdyn.build(given.robot(model.robot), model.bundled)
    if is_own(words):
        with one_line_errors(words, "an observer"):
            return _check(find_controller(words)(rigged))
    return Ekf(rigged, disturbances=[word for word in words.split(",") if word])


def _check(observer: Any) -> Any:
    if isinstance(observer, type) or not callable(getattr(observer, "step", None)):
        raise InputError("observer", "an object with step(t, measurements, u)", repr(observer))
    return observer
