"""Copies of objects: read-only arrays stay read-only, and nothing that a use changes is shared."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
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


def freeze(values: Iterable[Any]) -> None:
    """Make arrays read-only, also those in mappings and sequences; all else stays as it is."""
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        elif isinstance(value, Mapping):
            freeze(value.values())
        elif isinstance(value, tuple | list):
            freeze(value)
