"""Channels of a log: what a controller or a plant declares, and the values of a command."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from softdyn import InputError

DECLARED = "the controller's channels"


@dataclass(frozen=True, eq=False)
class LogChannel:
    """A quantity of a run. A plant and a controller, also a user's own, declare theirs.

    Attributes
    ----------
    name : str
        Its name in a log, a Python name that is no attribute of a log yet.
    columns, units : tuple of str or None, tuple of str
        Name and unit of each of its columns; None for one number per row, maybe with a unit.
    held : bool
        Whether a value is held from one sample to the next, as an input is. A run of N control
        steps has N such values, and N + 1 of any other channel.
    title : str
        First part of its columns' names in CSV, e.g. ``tip``.
    text : bool
        Whether it is text instead of numbers.
    gaps : bool
        Whether a controller's command may lack a finite value, which then is NaN (or no text) in
        the log. `softdyn.testing.check_controller` refuses such a command of any other channel.
    values : np.ndarray, (N,) or (N + 1,), or with a second axis of the columns
        Its values; none before the run.
    """

    name: str
    columns: tuple[str, ...] | None = None
    units: tuple[str, ...] = ()
    held: bool = False
    title: str = ""
    text: bool = False
    gaps: bool = False
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(
        cls,
        name: str,
        columns: Iterable[tuple[str, str]],
        title: str = "",
        held: bool = False,
        gaps: bool = False,
    ) -> LogChannel:
        """A channel from the (name, unit) of its columns."""
        pairs = list(columns)
        named, units = tuple(n for n, _ in pairs), tuple(u for _, u in pairs)
        return cls(name, named, units, held, title, gaps=gaps)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its columns in CSV, e.g. ``tip.x``."""
        title = self.title or self.name
        return (title,) if self.columns is None else tuple(f"{title}.{n}" for n in self.columns)

    @property
    def titles(self) -> tuple[str, ...]:
        """The same with units, e.g. ``tip.x (m)``."""
        units = self.units or ("",) * len(self.names)
        return tuple(f"{n} ({u})" if u else n for n, u in zip(self.names, units, strict=True))

    def empty(self, samples: int) -> np.ndarray:
        """An array for a number of samples, without a value yet: NaN, or no text."""
        rows = samples - self.held
        if self.text:
            return np.full(rows, "", dtype=object)
        return np.full(rows if self.columns is None else (rows, len(self.columns)), np.nan)

    def filled(self, values: np.ndarray) -> LogChannel:
        """The same channel with these values."""
        return replace(self, values=values)


# The phase of a controller of the package. A fallback may lack it.
PHASE = LogChannel("phase", text=True, gaps=True)


def channels_of(controller: object) -> tuple[LogChannel, ...]:
    """The channels that a controller declares, each with one value in every control period.

    Parameters
    ----------
    controller : object
        It may have `channels`, a sequence of `LogChannel`.

    Raises
    ------
    InputError
        Something else, two channels or two columns of one name, units of other columns.
    """
    declared = getattr(controller, "channels", ())
    if not isinstance(declared, tuple | list):
        raise InputError(DECLARED, "a tuple of LogChannel", repr(declared))
    for one in declared:
        if not isinstance(one, LogChannel):
            raise InputError(DECLARED, "a LogChannel", repr(one))
        words = (one.name, one.title, *(one.columns or ()), *one.units)
        if not all(isinstance(word, str) for word in words):
            raise InputError(f"{DECLARED}: {one.name}", "names and units as text", repr(words))
        if len(one.units) not in (0, len(one.names)):
            raise InputError(f"{DECLARED}: {one.name}", f"{len(one.names)} units", one.units)
    titles = [title for one in declared for title in one.names]
    for names in ([one.name for one in declared], titles):
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(DECLARED, "names that differ", f"{twice[0]} twice")
    return tuple(replace(one, held=True) for one in declared)


def values_of(channels: Iterable[LogChannel], answer: object) -> dict[str, Any]:
    """The values of declared channels in a controller's answer, by name.

    Parameters
    ----------
    channels : iterable of LogChannel
        The channels that the controller declares.
    answer : object
        A `Command`, or another object that may have `values`. A user's controller that returns
        the command of one of ours need not declare its `PHASE`.

    Returns
    -------
    dict of str to ndarray or str
        As `checked_values` returns them.

    Raises
    ------
    InputError
        As `checked_values` does.
    """
    given, channels = getattr(answer, "values", None), tuple(channels)
    if given is None:
        return {}
    if isinstance(given, Mapping) and PHASE.name not in [one.name for one in channels]:
        given = {name: value for name, value in given.items() if name != PHASE.name}
    return checked_values(channels, given, "the values of a command")


def checked_values(channels: Iterable[LogChannel], given: Any, of: str) -> dict[str, Any]:
    """Values of declared channels.

    Parameters
    ----------
    channels : iterable of LogChannel
        The channels.
    given : mapping of str to Any
        The values by the channels' names; some may be missing.
    of : str
        What has them, for messages.

    Returns
    -------
    dict of str to ndarray () or (columns,), or str
        Numbers need not be finite.

    Raises
    ------
    InputError
        A value of no declared channel, of another shape, or of another kind.
    """
    if not isinstance(given, Mapping):
        raise InputError(of, "a dict of the values by the channels' names", repr(given))
    known = {channel.name: channel for channel in channels}
    found: dict[str, Any] = {}
    for name, value in given.items():
        if name not in known:
            expected = f"names of declared channels, {', '.join(known) or 'none'}"
            raise InputError(of, expected, repr(name))
        channel = known[name]
        if channel.text:
            if not isinstance(value, str):
                raise InputError(f"{of}: {name}", "text", repr(value))
            found[name] = value
            continue
        shape = () if channel.columns is None else (len(channel.columns),)
        try:
            numbers = np.array(value, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{of}: {name}", "numbers", repr(value)) from None
        if numbers.shape != shape and (numbers.shape, shape) != ((), (1,)):
            raise InputError(f"{of}: {name}", f"shape {shape}", f"shape {numbers.shape}")
        found[name] = numbers
    return found
