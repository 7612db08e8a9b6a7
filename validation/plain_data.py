"""A user's values as JSON values, with the same text in every process."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Set
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

LARGEST = 2**63


def to_plain_data(value: Any) -> Any:
    """`value` with dataclasses, arrays and sets as dicts and lists, and other objects as text.

    Memory addresses are removed from such a text and sets are sorted, because both change from
    process to process.
    """
    if isinstance(value, int) and abs(value) > LARGEST:
        return hex(value)  # Python refuses to write thousands of digits
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain_data(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(to_plain_data(key)): to_plain_data(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_plain_data(value.tolist())
    if isinstance(value, list | tuple):
        return [to_plain_data(item) for item in value]
    if isinstance(value, Set):
        return sorted(map(to_plain_data, value), key=json.dumps)
    return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(value))
