"""XML elements with exact numbers, and unique names."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from lxml import etree


def words(values: Iterable[float] | float) -> str:
    """Numbers as text that reads back as the same floats."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(np.asarray(values, float)))


def add(parent: etree._Element, tag: str, **attributes: object) -> etree._Element:
    """Add a child element; `words` writes numbers, and None is left out."""
    node = etree.SubElement(parent, tag)
    for name, value in attributes.items():
        if value is not None:
            text = value if isinstance(value, str) else words(value)  # type: ignore[arg-type]
            node.set(name.rstrip("_"), text)
    return node


def text(root: etree._Element, comment: str) -> str:
    """The indented document with a comment at the top."""
    etree.indent(root)
    return f"<!-- {comment.replace('--', '- -')} -->\n{etree.tostring(root, encoding='unicode')}\n"


class Names:
    """Unique names; a repeated name gets a number."""

    def __init__(self, *taken: str) -> None:
        self._taken = set(taken)

    def new(self, name: str) -> str:
        """`name`, or `name` with the next free number."""
        found, count = name, 2
        while found in self._taken or not found:
            found, count = f"{name or 'unnamed'}_{count}", count + 1
        self._taken.add(found)
        return found
