"""The promised names that docs/api.md lists, with their signatures as tests/api.txt holds them.

`python -m tests.support.promised_names` writes tests/api.txt anew.
"""

from __future__ import annotations

import ast
import enum
import importlib
import inspect
import re
from collections.abc import Iterator
from typing import Any

from tests.support import ROOT

SNAPSHOT = ROOT / "tests" / "api.txt"
LIST = re.compile(r"^\*Names of `([\w.]+)`:\* (.+)$", re.M)
NAME = re.compile(r"`(\w+)`(°?)")
MEMBER = re.compile(r"`(\w+\.\w+)`°")  # of a stable class


API = (ROOT / "docs/api.md").read_text("utf-8")
ROOMS = {module for module, _ in LIST.findall(API)}  # from which names are imported


def promised() -> dict[str, bool]:
    """Each promised name with its module, and whether it is stable."""
    return {
        f"{module}.{name}": not mark
        for module, names in LIST.findall(API)
        for name, mark in NAME.findall(names)
    }


def provisional_members() -> set[str]:
    """Members of stable classes that are provisional themselves."""
    listed = LIST.findall(API)
    return {f"{module}.{one}" for module, names in listed for one in MEMBER.findall(names)}


def snapshot() -> str:
    """The promised names with their signatures, and those of the members of stable classes."""
    lines = []
    for name, stable in sorted(promised().items()):
        lines += _lines(name, _found(name), "" if stable else "° ")
    return "\n".join(lines) + "\n"


def used_names(code: str) -> set[str]:
    """Names of softdyn that a program imports, or reads as attributes of an imported module."""
    tree, modules, found = ast.parse(code), {}, set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for one in node.names:
                if one.name.partition(".")[0] == "softdyn":
                    modules[one.asname or "softdyn"] = one.name if one.asname else "softdyn"
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "softdyn":
            for one in node.names:
                full = f"{node.module}.{one.name}"
                if full in ROOMS:
                    modules[one.asname or one.name] = full
                found.add(full)
    for node in ast.walk(tree):
        words = _dotted(node)
        if words and words[0] in modules:
            found.add(".".join([modules[words[0]], *words[1:]]))
    return {_without_members(name) for name in found}


def _dotted(node: ast.AST) -> list[str]:
    """The words of ``a.b.c``; nothing for other nodes."""
    if isinstance(node, ast.Name):
        return [node.id]
    if isinstance(node, ast.Attribute):
        before = _dotted(node.value)
        return [*before, node.attr] if before else []
    return []


def _without_members(name: str) -> str:
    """The longest beginning of a dotted name that is a room or a name in a room."""
    words = name.split(".")
    rooms = [k for k in range(1, len(words) + 1) if ".".join(words[:k]) in ROOMS]
    return ".".join(words[: rooms[-1] + 1]) if rooms else name


def _found(name: str) -> Any:
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def _lines(name: str, value: Any, mark: str) -> Iterator[str]:
    if inspect.isclass(value) and issubclass(value, enum.Enum):
        yield f"{mark}{name}: {' '.join(member.name for member in value)}"
        return
    yield f"{mark}{name}{_signature(value)}"
    if inspect.isclass(value) and not mark:
        marked = provisional_members()
        for member in sorted(vars_of(value)):
            full = f"{name}.{member}"
            own = "° " if full in marked else ""
            yield f"{own}{full}{_signature(inspect.getattr_static(value, member, None))}"


def vars_of(value: type) -> set[str]:
    """Names of a class's own public members and of those that it inherits from softdyn."""
    own = [kind for kind in value.__mro__ if kind.__module__.startswith("softdyn")]
    members = {name for kind in own for name in (*vars(kind), *inspect.get_annotations(kind))}
    return {name for name in members if not name.startswith("_")}


def _signature(value: Any) -> str:
    """Names of the parameters, and the defaults that are plain values."""
    if isinstance(value, staticmethod | classmethod):
        value = value.__func__
    if not callable(value):
        return ""
    try:
        parameters = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):  # a class of the interpreter's own
        return ""
    shown = [
        one.replace(annotation=inspect.Parameter.empty, default=_default(one.default))
        for one in parameters
    ]
    return str(inspect.Signature(shown))


class _Shown(str):
    def __repr__(self) -> str:
        return str(self)


def _default(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return _Shown(f"{type(value).__name__}.{value.name}")
    plain = isinstance(value, int | float | str | bool | tuple | type(None))
    return value if plain or value is inspect.Parameter.empty else _Shown("…")


if __name__ == "__main__":
    SNAPSHOT.write_text(snapshot(), encoding="utf-8")
