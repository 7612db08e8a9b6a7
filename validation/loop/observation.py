"""An observer in a closed loop: from the readings of sensors to the controller's state."""

from __future__ import annotations

from time import perf_counter_ns
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.controllers.channels import LogChannel
from softdyn.controllers.registry import find_controller, is_own, one_line_errors
from softdyn.dynamics.reduced import rebuild
from softdyn.estimation import Ekf, Observer
from softdyn.exceptions import errors_in
from softdyn.validation.loop.plants import Plant
from softdyn.validation.twin.rig import Rig, rig_of

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
    plant : Plant
        The plant, which has the readings.

    Attributes
    ----------
    observer : Observer
        As above.
    nanoseconds : int
        Time that the last estimate took.
    channels : tuple of LogChannel
        The estimated disturbances and their deviations.
    values : dict of str to ndarray, (nd,)
        The last of these, by the channels' names.

    Raises
    ------
    InputError
        An object without a method `step`, or one for other readings than those of the plant.
    """

    def __init__(self, observer: Observer, model: SoftModel, plant: Plant) -> None:
        _check(observer)
        readings = [n for c in plant.channels if c.name == "measured" for n in c.columns or ()]
        if not readings:
            raise InputError("observer", 'a rig with sensors, such as rig="file"', "none")
        if plant.alters_states:
            expected = "a rig that alters readings alone: no noise, bias or latency of q and v"
            raise InputError("observer", expected, "one that alters q and v")
        takes = getattr(observer, "components", len(readings))
        if takes != len(readings):
            raise InputError("observer", f"one for {len(readings)} readings", f"for {takes}")
        self.observer, self._model, self.nanoseconds = observer, model, 0
        units: dict[str, str] = getattr(observer, "disturbance_units", {})
        self._count = len(units)
        titles = {"disturbances": "estimated", "deviations": "deviation"} if units else {}
        self.channels = tuple(LogChannel.of(n, units.items(), title) for n, title in titles.items())
        self.values: dict[str, np.ndarray] = {}

    def reset(self) -> None:
        """Begin a run."""
        if hasattr(self.observer, "reset"):
            self.observer.reset()

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
        estimate = self.observer.step(t, measured, sent)
        with errors_in("the observer's estimate"):
            state = self._model.state(estimate.q, estimate.v)
        for channel in self.channels:
            found = np.empty(self._count)
            try:
                np.concatenate([*getattr(estimate, channel.name).values()], out=found)
            except (AttributeError, TypeError, ValueError):
                expected = f"{channel.name} of {self._count} components"
                raise InputError("the observer's estimate", expected, "others") from None
            self.values[channel.name] = found
        covariance = getattr(estimate, "covariance", None)
        if covariance is not None:
            state = State.trusted(**vars(state), covariance=covariance)
        self.nanoseconds = perf_counter_ns() - began
        return state


def make_observer(model: SoftModel, rig: Rig | str | None, observer: Observer | str | None) -> Any:
    """The observer that words mean: an `Ekf` of the rig, or a user's class.

    Parameters
    ----------
    model : SoftModel
        The robot.
    rig : Rig or str or None
        The rig of the run; its motors and sensors are those of the `Ekf`.
    observer : Observer or str, optional
        Names of disturbances, separated by commas, maybe none; or FILE.py:CLASS, which is built as
        CLASS(model). An observer, or None, is returned as it is.

    Raises
    ------
    InputError
        No rig, an unknown disturbance, a class that cannot be made.
    """
    if not isinstance(observer, str):
        return observer
    given = rig_of(rig)
    if given is None:
        raise InputError("observer", 'a rig with sensors, such as rig="file"', "none")
    rigged = rebuild(model, given.robot(model.robot))
    if is_own(observer):
        with one_line_errors(observer, "an observer"):
            return _check(find_controller(observer)(rigged))
    return Ekf(rigged, disturbances=[word for word in observer.split(",") if word])


def _check(observer: Any) -> Any:
    if isinstance(observer, type) or not callable(getattr(observer, "step", None)):
        raise InputError("observer", "an object with step(t, measurements, u)", repr(observer))
    return observer
