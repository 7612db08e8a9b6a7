"""Checks of arguments: numbers that are numbers, arrays of the stated shape, or `InputError`."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from functools import cache
from numbers import Real
from typing import Any

import numpy as np

from softdyn.exceptions import InputError

FLOAT = np.dtype(float)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``'name'``, with the known name that was meant, if one is like it."""
    lowered = {one.lower(): one for one in known}
    found = difflib.get_close_matches(name.lower(), lowered, 1)
    return f"{name!r}; did you mean {lowered[found[0]]!r}?" if found else repr(name)


def in_degrees(angle: float, low: float, high: float) -> bool:
    """Whether an angle is beyond its limits (rad), and within them if it is meant in degrees."""
    return abs(angle) > math.pi and not low <= angle <= high and low <= math.radians(angle) <= high


def number(name: str, value: Any, *, lower: float = -math.inf, above: float = -math.inf) -> float:
    """`value` as a finite float, ``>= lower`` and ``> above``.

    Raises
    ------
    InputError
        For anything that is not a real number (text and booleans are not), NaN and infinities.
    """
    if isinstance(value, Real) and not isinstance(value, bool | np.bool_):
        try:
            result = float(value)
        except OverflowError:  # an int beyond the floats
            result = math.inf
        if math.isfinite(result) and result >= lower and result > above:
            return result
    try:
        got = repr(value)
    except ValueError:  # Python refuses to write thousands of digits
        got = "a number of thousands of digits"
    bound = f" >= {lower:g}" if lower > -math.inf else ""
    bound += f" > {above:g}" if above > -math.inf else ""
    raise InputError(name, f"a finite number{bound}", got)


def array(name: str, value: Any, shape: tuple[int, ...], *, finite: bool = True) -> np.ndarray:
    """`value` as a new read-only float array of `shape`.

    Raises
    ------
    InputError
        For text, complex numbers, ragged lists, another shape, NaN and infinities, and for a masked
        array that hides some of its numbers.
    """
    if np.ma.is_masked(value):
        raise _not_an_array(name, finite, shape, "a mask that hides some")
    try:
        given = np.asarray(value)
    except ValueError:  # ragged
        raise _not_an_array(name, finite, shape, repr(value)) from None
    if given.dtype.kind not in "fiu":
        raise _not_an_array(name, finite, shape, repr(value))
    if given.shape != shape:
        raise _not_an_array(name, finite, shape, f"shape {given.shape}")
    result = np.array(given, dtype=float, order="C")
    if finite and not np.isfinite(result).all():
        raise _not_an_array(name, finite, shape, repr(value))
    result.flags.writeable = False
    return result


def vector(name: str, value: Any, size: int) -> np.ndarray:
    """`value` as a new finite float array (size,), checked in a third of `array`'s time.

    One may write to it: compiled kernels take such arrays faster, too.

    Raises
    ------
    InputError
        For text, complex numbers, ragged lists, another shape, NaN and infinities.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT and value.shape == (size,):
        result = np.array(value)
        # one dot product instead of a temporary; it overflows for no number, so nothing warns
        if math.isfinite(result.dot(_small(size))):
            return result
    return array(name, value, (size,)).copy()


@cache
def _small(size: int) -> np.ndarray:
    return np.full(size, 1e-150)


def read_only(values: Any) -> np.ndarray:
    """A new read-only float array of values that need no check."""
    result = np.array(values, float)
    result.flags.writeable = False
    return result


def _not_an_array(name: str, finite: bool, shape: tuple[int, ...], got: str) -> InputError:
    """Made only where it is raised: arrays are checked in every control step."""
    return InputError(name, f"{'finite ' if finite else ''}numbers of shape {shape}", got)
