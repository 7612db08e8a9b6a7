"""Mutated robot files, determined by a base file, a seed and an index.

A mutant is a base file after one to four random changes. Each changes bytes, tokens, numbers or the
tree. In the tree, elements and attributes are moved, doubled, deleted or renamed, and subtrees are
repeated until they are deep or many. Half of the tree's changes affect the annotations.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lxml import etree

NUMBER = re.compile(rb"(?<=[\"> ])[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?(?=[\"< ])")
QUOTED = re.compile(rb'"[^"]*"')
NUMBERS = (
    "0", "-0", "1", "-1", "1e-320", "5e-324", "1e-300", "1e-9", "1e3", "1e9", "1e49", "1e50",
    "1.0000001e50", "1e155", "1e300", "1e308", "1e309", "1e999", "-1e300", "nan", "NaN", "-nan",
    "inf", "-inf", "Infinity", "0x10", "1_0", "0,1", "1.", ".5", "+.5", "--1", "1e", "1e+", "e1",
    "0.1f", "1d3", "1 2", " 1", "1 ", "1\t", "\u0661", "\uff11", "\u22121", "1" * 400,
    "0." + "0" * 400 + "1", "true", "", " ", "pi", "${x}", "1;2", "#", "00012", "1e0000000000003",
)  # fmt: skip
VECTORS = (
    "0 0 0", "1 0 0", "0 0 1e-7", "1e-5 0 0", "1e7 0 0", "1 2", "1 2 3 4", "nan 0 0", "inf 0 0",
    "1e300 0 0", "0,0,1", "0  0   1", " 0 0 1 ", "0\t0\t1", "0\u00a00\u00a01", "x y z", "0 0 1e50",
)  # fmt: skip
NAMES = (
    "", " ", "world", "universe", "root_joint", "base", "tip", "fixed", "floating", "planar",
    "ball", "revolute", "continuous", "prismatic", "a/b", "../a", "a b", "a\nb",
    "\u00e9", "\U0001f916",
    "force", "length", "velocity", "gyro", "pose", "axis", "true", "false",
    "x" * 3000, "&lt;", "%s%n", "__init__", "None", "\u202eabc", "A", "0",
)  # fmt: skip
TAGS = (
    "link", "joint", "inertial", "mass", "inertia", "origin", "axis", "limit", "dynamics", "parent",
    "child", "mimic", "gazebo", "softdyn", "tendon", "actuator", "task", "site", "visual",
    "collision", "robot", "springStiffness", "sensor", "x", "{u}link", "linkk", "Joint", "inertail",
)  # fmt: skip
CHUNKS = (
    b"<!-- c -->", b"<![CDATA[1]]>", b"<?pi?>", b"&amp;", b"&#0;", b"&#49;", b"&e;", b"\0", b"\xff",
    b"\xef\xbb\xbf", b"<", b">", b"/>", b'"', b"<!DOCTYPE robot>", b"</robot>", b'<robot name="b">',
    b'<softdyn version="1"/>', b"<link/>", b"]]>", b"\r\n", b"<!--", b'<?xml version="1.1"?>',
    b'<?xml version="1.0" encoding="UTF-16"?>',
    b"<xi:include xmlns:xi='http://www.w3.org/2001/XInclude' href='x.urdf'/>",
)  # fmt: skip

Change = Callable[[random.Random, bytes], bytes]


@dataclass(frozen=True)
class Base:
    """A file to damage: a URDF, or the annotations of the URDF `of`."""

    data: bytes
    of: bytes | None = None


def mutant(bases: Sequence[Base], seed: int, index: int) -> Base:
    """The input number `index` of a seed; independent of all others."""
    rng = random.Random(f"{seed}:{index}")
    base = rng.choice(bases)
    data = base.data
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        change = rng.choices((changed_bytes, _tokens, _number, _tree), (1, 1, 3, 7))[0]
        data = change(rng, data)
    return Base(data, base.of)


def changed_bytes(rng: random.Random, data: bytes) -> bytes:
    """Flip, insert, cut, truncate or repeat bytes."""
    if not data:
        return data
    at = rng.randrange(len(data))
    kind = rng.randrange(5)
    if kind == 0:
        return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    if kind == 1:
        return data[:at] + rng.choice(CHUNKS) + data[at:]
    if kind == 2:
        return data[:at] + data[at + rng.randrange(1, 200) :]
    if kind == 3:
        return data[:at]
    return data[:at] + data[at : at + rng.randrange(1, 400)] * 2 + data[at:]


def _tokens(rng: random.Random, data: bytes) -> bytes:
    """Swap two quoted values, or replace one by another text."""
    found = [m.span() for m in QUOTED.finditer(data)]
    if not found:
        return data
    start, end = rng.choice(found)
    other = rng.choice(found)
    pool = (*NUMBERS, *VECTORS, *NAMES)
    new = (
        data[slice(*other)]
        if rng.random() < 0.5
        else b'"' + rng.choice(pool).encode().replace(b'"', b"'") + b'"'
    )
    return data[:start] + new + data[end:]


def _number(rng: random.Random, data: bytes) -> bytes:
    """Replace or scale a number."""
    found = [m.span() for m in NUMBER.finditer(data)]
    if not found:
        return data
    start, end = rng.choice(found)
    if rng.random() < 0.5:
        new = rng.choice(NUMBERS).encode()
    else:
        factor = rng.choice((-1, 0.0, 1e-3, 1e3, 57.29577951308232, 1.1, 1e-6, 1e6, 1e12, -1e-12))
        try:
            new = repr(float(data[start:end]) * factor).encode()
        except ValueError:
            return data
    return data[:start] + new + data[end:]


def _tree(rng: random.Random, data: bytes) -> bytes:
    """Change the document's tree; data that is not XML stays unchanged."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False)
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError):
        return data
    elements = [e for e in root.iter() if isinstance(e.tag, str)]
    inner = elements[1:]
    block = [e for e in inner if any(a.tag == "softdyn" for a in (e, *e.iterancestors()))]
    if block and rng.random() < 0.5:
        inner = block
    if not inner:
        return data
    element = rng.choice(inner)
    rng.choices(
        (_delete, _double, _move, _rename, _text, _attribute, _swap, _repeat),
        (2, 1, 2, 1, 1, 6, 1, 0.4),
    )[0](rng, element, elements)
    try:
        return etree.tostring(root)
    except etree.LxmlError:
        return data


def _delete(rng: random.Random, element: etree._Element, elements: list) -> None:
    if (parent := element.getparent()) is not None:
        parent.remove(element)


def _double(rng: random.Random, element: etree._Element, elements: list) -> None:
    element.addnext(_copy(element))


def _move(rng: random.Random, element: etree._Element, elements: list) -> None:
    below = set(element.iter())
    rng.choice([e for e in elements if e not in below]).append(element)


def _rename(rng: random.Random, element: etree._Element, elements: list) -> None:
    element.tag = rng.choice(TAGS)


def _text(rng: random.Random, element: etree._Element, elements: list) -> None:
    element.text = _sayable(rng.choice((*NUMBERS, *NAMES)))


def _attribute(rng: random.Random, element: etree._Element, elements: list) -> None:
    names = sorted(map(str, element.attrib))
    if not names:
        return
    name = rng.choice(names)
    kind = rng.randrange(6)
    value = element.get(name, "")
    if kind == 0:
        del element.attrib[name]
    elif kind == 1:
        del element.attrib[name]
        element.set(rng.choice(("x", "{u}x", name + "s", name.upper(), name[1:] or "y")), value)
    elif kind == 2:
        element.set(name, _sayable(rng.choice((*NUMBERS, *VECTORS))))
    elif kind == 3:
        element.set(name, _sayable(rng.choice(NAMES)))
    else:  # the value of another element, from the same or any attribute
        values = [e.get(name) for e in elements if e.get(name)] if kind == 4 else []
        values = values or [v for e in elements for v in e.attrib.values()]
        element.set(name, rng.choice(values))


def _swap(rng: random.Random, element: etree._Element, elements: list) -> None:
    others = [e for e in elements if e.tag == element.tag]
    other = rng.choice(others)
    mine, theirs = list(element.attrib.items()), list(other.attrib.items())
    for one, attributes in ((element, theirs), (other, mine)):
        one.attrib.clear()
        for name, value in attributes:
            one.set(name, value)


def _repeat(rng: random.Random, element: etree._Element, elements: list) -> None:
    """Repeat an element side by side, or nested."""
    count = rng.choice((3, 30, 300))
    if rng.random() < 0.5:
        for k in range(count):
            twin = _copy(element)
            if twin.get("name"):
                twin.set("name", f"{twin.get('name')}_{k}")
            element.addnext(twin)
        return
    for _ in range(count):
        inner = etree.SubElement(element, element.tag)
        for name, value in element.attrib.items():
            inner.set(name, value)
        element = inner


def _copy(element: etree._Element) -> etree._Element:
    return etree.fromstring(etree.tostring(element, with_tail=False))


def _sayable(text: str) -> str:
    """`text` without characters that XML cannot contain."""
    return "".join(c for c in text if c >= " " or c in "\t\n")
