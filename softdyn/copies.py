"""Copies of objects: read-only arrays stay read-only, and nothing that a use changes is shared.

Some objects keep the arguments of their making, so that a run's record can make them again.
"""

from __future__ import annotations

import copy
import hashlib
import pickle
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, Self

import numpy as np


class Frozen:
    """Data whose arrays are read-only, those of its copies too."""

    def __setstate__(self, values: dict[str, Any]) -> None:
        vars(self).update(values)
        freeze(values.values())


class Separate:
    """An object that its use changes: `copy.copy` copies it whole, as `copy.deepcopy` does."""

    def __copy__(self) -> Self:
        return copy.deepcopy(self)


PLAIN = (bool, int, float, complex, str, bytes, tuple, list, dict, np.ndarray, np.generic)
MADE_BY = "_made_by"  # the attribute with an object's `Making`


class Making:
    """The call that has made an object. A copy shares it, a pickle does not contain it.

    Attributes
    ----------
    maker : Callable
        The class or function.
    arguments, named : tuple, dict of str to Any
        Its arguments.
    """

    def __init__(
        self,
        maker: Callable[..., Any] | None = None,
        arguments: tuple[Any, ...] = (),
        named: Mapping[str, Any] | None = None,
    ) -> None:
        self.maker, self.arguments, self.named = maker, arguments, dict(named or {})

    def __deepcopy__(self, memo: object) -> Making:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return Making, ()


class KeepsMaking:
    """An object that keeps the call that made it."""

    def __new__(cls, *arguments: Any, **named: Any) -> Self:  # noqa: D102
        made = super().__new__(cls)
        keep_making(made, cls, arguments, named)
        return made


def keep_making(
    made: object, maker: Callable[..., Any], arguments: tuple[Any, ...], named: Mapping[str, Any]
) -> None:
    """Let an object keep the call that made it, if it can have attributes."""
    with suppress(AttributeError, TypeError):
        object.__setattr__(made, MADE_BY, Making(maker, arguments, named))


def making_of(made: object) -> Making | None:
    """The call that made an object; None if it does not keep it."""
    found = getattr(made, MADE_BY, None)
    return found if isinstance(found, Making) and found.maker is not None else None


def freeze(values: Iterable[Any]) -> None:
    """Make arrays read-only, also those in mappings and sequences; all else stays as it is."""
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        elif isinstance(value, Mapping):
            freeze(value.values())
        elif isinstance(value, tuple | list):
            freeze(value)


def content(value: Any, inside: tuple[int, ...] = ()) -> str:
    """The content of an object as text: the same for a copy, also in another process.

    It has the class's name and all fields, to any depth, also plain ones of the class itself.

    Parameters
    ----------
    value : Any
        An object that can be pickled.
    inside : tuple of int
        The objects that contain it, by their `id`.
    """
    if id(value) in inside:
        return "itself"
    within = (*inside, id(value))
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return repr(value)
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind != "O":
        numbers = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"array {value.shape} {value.dtype.str} {numbers}"
    if isinstance(value, Mapping):
        pairs = (f"{content(k, within)}: {content(x, within)}" for k, x in value.items())
        return f"{{{', '.join(sorted(pairs))}}}"
    if isinstance(value, tuple | list | set | frozenset):
        parts = [content(one, within) for one in value]
        return f"[{', '.join(sorted(parts) if isinstance(value, set | frozenset) else parts)}]"
    if isinstance(value, type) or (callable(value) and hasattr(value, "__qualname__")):
        return f"{value.__qualname__}"
    state = value.__getstate__()
    if state is None and type(value).__reduce__ is not object.__reduce__:
        state = pickle.dumps(value)
    shared: dict[str, Any] = {}
    for kind in reversed(type(value).__mro__):
        shared.update(vars(kind))
    plain = {
        name: one for name, one in shared.items()
        if not name.startswith("__") and isinstance(one, PLAIN)
    }  # fmt: skip
    return f"{type(value).__qualname__} {content(plain, within)} {content(state, within)}"
