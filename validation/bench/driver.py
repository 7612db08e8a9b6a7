"""The driver of a rig, which its user writes: its contract, and its readings in order."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.controllers.registry import find_controller, one_line_errors

METHODS = ("start", "read", "send", "stop")
FUTURE = 0.01  # s; a stamp may be so much newer than the clock


class Driver(Protocol):
    """A rig's driver, built as ``CLASS(model)``; the constructor opens nothing.

    Readings are in the order of the file's sensors: `softdyn.SoftModel.measure` names them.
    Commands are in the order of the file's actuators and of their kind: forces (u), free lengths
    (m) or velocities (m/s).
    """

    def start(self) -> None:
        """Open the rig."""

    def read(self) -> tuple[Any, Any]:
        """The newest readings (k,), and their times of measurement (k,) in `time.monotonic()` (s).

        A value is NaN where nothing is new; one that is not finite counts as none. It must not wait
        for a reading.
        """

    def send(self, commands: np.ndarray) -> None:
        """Give the motors their commands (nu,), which act until the next ones."""

    def stop(self) -> None:
        """Relax the cables; it may be called at any time, before `start` and twice."""


def check_driver(driver: Any) -> Driver:
    """The driver; refuses what lacks one of its methods.

    Raises
    ------
    InputError
        A class instead of an object, or a missing method.
    """
    missing = [name for name in METHODS if not callable(getattr(driver, name, None))]
    if isinstance(driver, type) or missing:
        expected = "an object with start(), read(), send(commands) and stop()"
        raise InputError("driver", expected, "a class" if not missing else f"no {missing[0]}()")
    found: Driver = driver
    return found


def make_driver(name: str, model: SoftModel) -> Driver:
    """The driver of FILE.py:CLASS, built as CLASS(model).

    Raises
    ------
    InputError
        No such file or class, or one that is no driver.
    """
    try:
        cls = find_controller(name)
    except InputError as error:
        raise InputError("driver", error.expected.rpartition(" or ")[2], error.got) from None
    with one_line_errors(name, "a driver"):
        return check_driver(cls(model))


def another(driver: Driver, model: SoftModel) -> Driver:
    """A second driver of the same rig.

    Raises
    ------
    InputError
        Its class cannot be built as CLASS(model).
    """
    cls: Any = type(driver)
    try:
        return check_driver(cls(model))
    except InputError:
        raise
    except Exception as error:
        got = f"{type(error).__name__}: {error}"
        raise InputError("driver", f"{cls.__name__}(model) for the watchdog", got) from error


class NewestReadings:
    """The newest value of every reading, with its time of measurement.

    A stamp that is not newer than the last one of its reading brings nothing, and neither does a
    value that is not finite.

    Parameters
    ----------
    size : int
        The number k of readings.

    Attributes
    ----------
    values, stamps : ndarray, (k,)
        The newest values, and their times on the clock of `time.monotonic` (s); NaN before the
        first.
    new : ndarray, (k,)
        The values that the last `take` brought, NaN for the others.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.clear()

    def clear(self) -> None:
        """Forget all readings."""
        self.values, self.stamps, self.new = np.full((3, self._size), np.nan)
        self._before = np.full(self._size, -np.inf)

    def take(self, values: Any, stamps: Any, now: float) -> None:
        """Add what a driver has read by the time `now` (s).

        Raises
        ------
        InputError
            Arrays of another size, or stamps that are not on this clock.
        """
        size = len(self.values)
        found = np.asarray(values, float), np.asarray(stamps, float)
        for name, array in zip(("values", "stamps"), found, strict=True):
            if array.shape != (size,):
                raise InputError(f"read(): {name}", f"{size} numbers", f"shape {array.shape}")
        given = np.isfinite(found[0]) & ~np.isnan(found[1])
        if (found[1][given] > now + FUTURE).any():
            latest = float(found[1][given].max())
            raise InputError(
                "read(): stamps", f"times up to {now:.3f} s of time.monotonic()", latest
            )
        new = given & (found[1] > self._before)
        self.new = np.where(new, found[0], np.nan)
        self.values[new], self.stamps[new] = found[0][new], found[1][new]
        self._before[new] = found[1][new]
