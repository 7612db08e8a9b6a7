"""Strict reading of XML: no DTD, no entities, no recovery; numbers must be finite."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, cast

from lxml import etree

from softdyn.checks import did_you_mean
from softdyn.exceptions import UrdfError, one_line

T = TypeVar("T")
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
MAX_BYTES = 16 * 2**20  # the largest URDF of example-robot-data is 0.2 MB
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
LARGEST = 1e50  # beyond any robot, and far enough from overflow for mass · length² and its sums


@dataclass(frozen=True)
class Element:
    """An XML element that knows its file, so that every error names its place."""

    file: Path
    node: etree._Element
    label: str

    def error(self, expected: str, got: object) -> UrdfError:
        """The exception to raise about this element."""
        line = self.node.sourceline  # missing in the type stubs
        return UrdfError(self.file, self.label, expected, got, cast("int | None", line))

    @property
    def tag(self) -> str:
        """The element's name, with its namespace if it has one."""
        return str(self.node.tag)

    def children(self, tag: str | None = None) -> Iterator[Element]:
        """Child elements in document order; those named `tag`, or all."""
        for node in self.node:
            if isinstance(node.tag, str) and tag in (None, node.tag):
                key = "reference" if node.tag == "gazebo" else "name"
                name, shown = node.get(key), node.tag
                if node.prefix:
                    shown = f"{node.prefix}:{etree.QName(node).localname}"
                label = f'<{shown} {key}="{name}">' if name else f"<{shown}>"
                prefix = "" if self.node.getparent() is None else self.label
                yield Element(self.file, node, prefix + one_line(label))

    def child(self, tag: str) -> Element | None:
        """The only child named `tag`, or None; several are an error."""
        found = list(self.children(tag))
        if len(found) > 1:
            raise found[1].error(f"one <{tag}>", f"{len(found)} of them")
        return found[0] if found else None

    def unique(self, tag: str, convert: Callable[[Element], T]) -> dict[str, T]:
        """Children named `tag`, converted and keyed by their name, which must not repeat."""
        found: dict[str, T] = {}
        for element in self.children(tag):
            name = element.text("name")
            if name in found:
                raise element.error(f"a unique {tag} name", f"a second {name!r}")
            found[name] = convert(element)
        return found

    def text(self, attribute: str) -> str:
        """A required, non-empty attribute."""
        value = self.node.get(attribute)
        if value is None or not value.strip():
            raise self.error(f'attribute {attribute}="…"', "none" if value is None else "nothing")
        return str(value)

    def one_of(self, attribute: str, names: Collection[str], expected: str) -> str:
        """A required attribute that is one of `names`; `expected` is for the message."""
        name = self.text(attribute)
        if name not in names:
            raise self.error(expected, did_you_mean(name, names))
        return name

    def choice(self, attribute: str, words: Sequence[str], default: str | None = None) -> str:
        """An attribute that is one of a few words; required if there is no default."""
        if self.node.get(attribute) is None and default is not None:
            return default
        *most, last = words
        return self.one_of(attribute, words, f"{attribute} {', '.join(most)} or {last}")

    def flag(self, attribute: str) -> bool:
        """An attribute that is ``true`` or ``false``; false by default."""
        value = self.node.get(attribute, "false")
        if value not in ("true", "false"):
            raise self.error(f'{attribute}="true" or "false"', repr(value))
        return bool(value == "true")

    def number(self, attribute: str, default: float | None = None) -> float:
        """A finite number in an attribute; required if there is no default."""
        value = self.node.get(attribute)
        if value is None and default is not None:
            return default
        return self.to_number(self.text(attribute), attribute)

    def vector(
        self, attribute: str, default: tuple[float, float, float] | None = None
    ) -> tuple[float, float, float]:
        """Three finite numbers in an attribute."""
        if self.node.get(attribute) is None and default is not None:
            return default
        words = self._words(attribute)
        if len(words) != 3:
            raise self.error(f"three numbers as {attribute}", repr(self.node.get(attribute)))
        x, y, z = (self.to_number(word, attribute) for word in words)
        return x, y, z

    def pair(
        self, attribute: str, default: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[float, float]:
        """Two finite numbers in an attribute."""
        if self.node.get(attribute) is None:
            return default
        words = self._words(attribute)
        if len(words) != 2:
            raise self.error(f"two numbers as {attribute}", repr(self.node.get(attribute)))
        one, other = (self.to_number(word, attribute) for word in words)
        return one, other

    def components(self, attribute: str, size: int, default: float = 0.0) -> tuple[float, ...]:
        """One finite number, or `size` of them."""
        if self.node.get(attribute) is None:
            return (default,)
        words = self._words(attribute)
        if len(words) not in (1, size):
            expected = "one number" if size == 1 else f"one number or {size}"
            raise self.error(f"{expected} as {attribute}", repr(self.node.get(attribute)))
        return tuple(self.to_number(word, attribute) for word in words)

    def numbers(self, attribute: str, most: int) -> tuple[float, ...]:
        """At most `most` finite numbers; none if the attribute is missing."""
        if self.node.get(attribute) is None:
            return ()
        words = self._words(attribute)
        if len(words) > most:
            raise self.error(f"at most {most} numbers as {attribute}", len(words))
        return tuple(self.to_number(word, attribute) for word in words)

    def _words(self, attribute: str) -> list[str]:
        return [word for word in self.text(attribute).split(" ") if word]

    def to_number(self, text: str, what: str) -> float:
        """`text` as a finite float; refuses spellings that engines read differently.

        Python's ``1_0``, ``inf`` and ``nan`` are refused. So are blanks around a number: if one
        follows a mass, Pinocchio's parser silently drops the inertia.
        """
        if not NUMBER.fullmatch(text) or not math.isfinite(value := float(text)):
            raise self.error(f"a finite number as {what}", repr(text))
        if abs(value) > LARGEST:
            raise self.error(f"a number within ±{LARGEST:g} as {what}", text)
        return value

    def non_negative(self, attribute: str, default: float | None = 0.0) -> float:
        """A finite number ≥ 0 in an attribute."""
        value = self.number(attribute, default)
        if value < 0:
            raise self.error(f"{attribute} >= 0", value)
        return value

    def allow(self, *attributes: str, children: tuple[str, ...] = ()) -> None:
        """Refuse every attribute and every child element that is not listed."""
        for name in self.node.attrib:
            if name not in attributes:
                raise self.error(f"no attribute but {', '.join(attributes)}", one_line(name))
        for child in self.children():
            if child.tag not in children:
                expected = " or ".join(f"<{tag}>" for tag in children) or "no element inside"
                raise child.error(expected, f"<{child.tag}>")


def read(path: Path, what: str = "URDF") -> Element:
    """Parse the file strictly and return its root; messages call the file `what`.

    Raises
    ------
    UrdfError
        If the file is unreadable, empty, too large, malformed or truncated, or has a DTD.
    """
    return read_bytes(path, content(path, what))


def content(path: Path, what: str = "URDF") -> bytes:
    """Read at most `MAX_BYTES` + 1 bytes of a file; the extra byte shows that it is too large.

    Raises
    ------
    UrdfError
        If the file is unreadable.
    """
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or error
        raise UrdfError(path, "file", f"a readable {what} file", reason) from None


def read_bytes(path: Path, data: bytes) -> Element:
    """Parse bytes strictly and return the root; `path` is for messages."""
    if len(data) > MAX_BYTES:
        raise UrdfError(path, "file", f"at most {MAX_BYTES} bytes", "more")
    parser = etree.XMLParser(
        resolve_entities=False, load_dtd=False, no_network=True, recover=False, huge_tree=False
    )
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        line = error.lineno or None
        raise UrdfError(path, "file", "well-formed XML", error.msg or "nothing", line) from None
    mark = data.find(BYTE_ORDER_MARK, 1)
    if mark > 0:  # lxml takes it as a letter of a name, where nobody sees it
        line = data.count(b"\n", 0, mark) + 1
        raise UrdfError(path, "file", "a byte order mark at the begin only", "another", line)
    if root.getroottree().docinfo.internalDTD is not None:
        raise UrdfError(path, "<!DOCTYPE>", "no DTD and no entities", "a document type declaration")
    return Element(path, root, one_line(f"<{root.tag}>"))
