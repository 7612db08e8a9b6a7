"""Text and table of the rig's attributes in ``docs/format.md``, from the dataclasses' docstrings.

``python -m tests.support.rig_tables`` writes them, and a test compares the two.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections.abc import Iterator

from softdyn.description.rig import Actuator, CommandKind, Sensor
from tests.support.misuses import FORMAT

START = (
    "<!-- rig: written by tests/support/rig_tables.py from the docstrings of Actuator, Sensor -->"
)
END = "<!-- end of rig -->"
LINE = re.compile(r"^(?P<names>\w[\w, ]*) : .*\n(?P<text>(?:    .*\n?)+)", re.M)
IN_FILE = {"kind": "type"}
DEFAULTS = {
    "gear": "1",
    "tendon": "required",
    "link": "required",
    "joint": "required",
    "to": "required",
    "unit": "a force",
    "area_growth": "none",
    "area_length": "none",
}


def described(part: type) -> Iterator[tuple[list[str], str]]:
    """Names and text of each attribute in a class's docstring."""
    _, _, attributes = inspect.cleandoc(part.__doc__ or "").partition("----------\n")
    for line in LINE.finditer(attributes):
        yield line["names"].split(", "), " ".join(line["text"].split())


def default(part: type, name: str) -> str:
    """The default of an attribute in the file."""
    value = {field.name: field.default for field in dataclasses.fields(part)}[name]
    if name in DEFAULTS or value is dataclasses.MISSING:
        return DEFAULTS.get(name, "required")
    if isinstance(value, CommandKind):
        return f"`{value.value}`"
    if isinstance(value, tuple) and all(map(math.isfinite, value)):
        return " ".join(f"{number:g}" for number in value)
    bounded = not isinstance(value, tuple) and math.isfinite(value)
    return f"{value:g}" if bounded else "no bound"


def prose(part: type) -> str:
    """The paragraphs of a class's docstring, without its list of attributes."""
    text, _, _ = inspect.cleandoc(part.__doc__ or "").partition("\n\nAttributes")
    text = text.replace("``", "`").replace("[lower, upper]", "[`lower`, `upper`]")
    return f"**`<{part.__name__.lower()}>`**: {text}"


def tables() -> str:
    """The text, and the rows of both elements."""
    rows = [prose(Actuator), "", prose(Sensor), ""]
    rows += ["| element | attribute | default | meaning |", "|---|---|---|---|"]
    for part in (Actuator, Sensor):
        element = f"`<{part.__name__.lower()}>`"
        for names, text in described(part):
            words = ", ".join(f"`{IN_FILE.get(name, name)}`" for name in names)
            rows.append(f"| {element} | {words} | {default(part, names[0])} | {text} |")
            element = ""
    return "\n".join(rows).strip()


def documented() -> str:
    """The tables in the document."""
    return FORMAT.read_text().partition(START)[2].partition(END)[0].strip()


def main() -> None:
    """Update the document."""
    before, _, rest = FORMAT.read_text().partition(START)
    FORMAT.write_text(f"{before}{START}\n\n{tables()}\n\n{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
