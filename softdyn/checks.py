"""Checks of arguments: finite numbers, arrays of a stated shape; else `InputError`."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cache
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np

from softdyn.exceptions import InputError

FLOAT = np.dtype(float)
ROUNDING = 1e-9  # of a limit
Kind = TypeVar("Kind")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``'name'``, followed by the most similar known name, if there is one."""
    lowered = {one.lower(): one for one in known}
    found = difflib.get_close_matches(name.lower(), lowered, 1)
    return f"{name!r}; did you mean {lowered[found[0]]!r}?" if found else repr(name)


def in_degrees(angle: float, low: float, high: float) -> bool:
    """Whether an angle is outside its limits (rad), but inside them if read as degrees."""
    return abs(angle) > math.pi and not low <= angle <= high and low <= math.radians(angle) <= high


def number(
    name: str,
    value: Any,
    *,
    lower: float = -math.inf,
    above: float = -math.inf,
    upper: float = math.inf,
    finite: bool = True,
) -> float:
    """`value` as a finite float, ``>= lower``, ``> above`` and ``<= upper``.

    Raises
    ------
    InputError
        For anything but a real number (text and booleans are none), for NaN, and for infinities;
        +∞ is allowed if `finite` is False.
    """
    with suppress(InputError):
        result = real(name, value)
        allowed = math.isfinite(result) or (not finite and result > 0)
        if allowed and above < result >= lower and result <= upper:
            return result
    try:
        got = repr(value)
    except ValueError:  # Python refuses to print thousands of digits
        got = "a number of thousands of digits"
    bound = f" >= {lower:g}" if lower > -math.inf else ""
    bound += f" > {above:g}" if above > -math.inf else ""
    bound += f" and <= {upper:g}" if upper < math.inf else ""
    raise InputError(name, f"a {'finite ' if finite else ''}number{bound}", got)


def beyond(value: float, limit: float) -> bool:
    """Whether a value exceeds a limit by more than the rounding of sums and of units.

    0.13 + 0.11 + 0.09 is less than 0.33.
    """
    return value > limit + ROUNDING * abs(limit)


def real(name: str, value: Any) -> float:
    """`value` as a float, maybe not finite.

    Raises
    ------
    InputError
        For anything but a real number; text and booleans are none.
    """
    if isinstance(value, Real) and not isinstance(value, bool | np.bool_):
        try:
            return float(value)
        except OverflowError:  # an int too large for a float
            return math.inf
    raise InputError(name, "a number", repr(value))


def whole(name: str, value: Any, lower: int = 0) -> int:
    """`value` as a whole number ``>= lower``.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= lower:
        return int(value)
    raise InputError(name, f"a whole number >= {lower}", repr(value))


def flag(name: str, value: Any) -> bool:
    """`value` if it is True or False.

    Raises
    ------
    InputError
        For anything else.
    """
    return bool(instance(name, value, (bool, np.bool_), "True or False"))


def instance(
    name: str, value: Any, kind: type[Kind] | tuple[type[Kind], ...], expected: str
) -> Kind:
    """`value` if it is an object of `kind`.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(value, kind):
        return value
    raise InputError(name, expected, repr(value))


def instances(name: str, values: Any, kind: type[Kind], expected: str) -> tuple[Kind, ...]:
    """The objects of `kind` in a sequence or another iterable; text is none.

    Raises
    ------
    InputError
        For anything that is not iterable, or an object of another kind.
    """
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        raise InputError(name, f"a sequence, each {expected}", repr(values))
    try:
        found = tuple(values)
    except TypeError:  # an array without axes
        raise InputError(name, f"a sequence, each {expected}", repr(values)) from None
    return tuple(instance(f"{name}[{k}]", one, kind, expected) for k, one in enumerate(found))


def length(name: str, value: Any) -> int:
    """The number of items in `value`.

    Raises
    ------
    InputError
        For anything without a length.
    """
    try:
        return len(value)
    except TypeError:
        raise InputError(name, "a sequence", repr(value)) from None


def array(name: str, value: Any, shape: tuple[int, ...], *, finite: bool = True) -> np.ndarray:
    """`value` as a new read-only float array of `shape`.

    Raises
    ------
    InputError
        For text, complex numbers, ragged lists, another shape, NaN and infinities, and for an array
        with masked numbers.
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


def fill(name: str, value: Any, into: np.ndarray) -> np.ndarray:
    """Copy numbers, maybe not finite, into an array of their shape; it is returned.

    Raises
    ------
    InputError
        For text, complex numbers, ragged lists, or another shape.
    """
    plain = type(value) is np.ndarray and value.dtype is FLOAT and value.shape == into.shape
    into[:] = value if plain else array(name, value, into.shape, finite=False)
    return into


def vector(name: str, value: Any, size: int) -> np.ndarray:
    """`value` as a new finite float array (size,), checked in a third of `array`'s time.

    Returns a writable copy; Numba dispatches writable arrays faster.

    Raises
    ------
    InputError
        For text, complex numbers, ragged lists, another shape, NaN and infinities.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT and value.shape == (size,):
        result = np.array(value)
        # One dot product needs no temporary array. It never overflows, so NumPy never warns.
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


def unit(name: str, value: Any) -> np.ndarray:
    """A direction (3,) as a read-only unit vector.

    Raises
    ------
    InputError
        For anything but three finite numbers that are not all zero.
    """
    given = array(name, value, (3,))
    largest = float(np.abs(given).max())
    if largest == 0:
        raise InputError(name, "a direction", repr(value))
    scaled = given / largest  # squares of tiny or huge numbers would be 0 or infinite
    return read_only(scaled / np.linalg.norm(scaled))


def _not_an_array(name: str, finite: bool, shape: tuple[int, ...], got: str) -> InputError:
    """The error to raise; built only then, because every control step checks arrays."""
    return InputError(name, f"{'finite ' if finite else ''}numbers of shape {shape}", got)
