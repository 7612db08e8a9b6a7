"""The files that a command reads, directly or not; no output may replace one of them."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from softdyn.description import meshes
from softdyn.exceptions import InputError
from softdyn.files import followed, is_stream, read_toml

MAX_BYTES = 16_000_000  # a larger file is not searched for names of other files
XML = (".urdf", ".xml", ".mjcf")
QUOTED = re.compile(rb"""=\s*(?:"([^"<>]{1,1000})"|'([^'<>]{1,1000})')""")
FOLDERS = re.compile(rb"""\b(?:mesh|asset|texture)dir\s*=\s*["']([^"'<>]{1,1000})["']""")


def files_read(given: Iterable[Any], opened: dict[Path, bytes] | None = None) -> set[Path]:
    """All files that a command reads: its arguments, and the files that these name.

    A URDF or MJCF names its meshes, textures and includes, a TOML file robots, controllers and
    gains, a Python file the modules beside it.

    Parameters
    ----------
    given : iterable
        A command's arguments: paths, FILE.py:CLASS, or other values, which are ignored.
    opened : dict, optional
        Filled with the content of every URDF and MJCF, so that the command need not open it again.

    Returns
    -------
    set of Path
        Absolute paths, links resolved.
    """
    found: set[Path] = set()
    waiting = [path for value in given for path in _files(value, Path())]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _named(path, {} if opened is None else opened)
    return found


def _files(text: Any, *folders: Path) -> Iterator[Path]:
    """The files that a text may mean, relative to these folders."""
    if not isinstance(text, str | Path):
        return
    file, _, name = str(text).rpartition(":")
    for spelt in (str(text), file) if name.isidentifier() else (str(text),):
        for folder in folders:
            try:
                path = folder / spelt
                if spelt and path.is_file() and not is_stream(path):
                    yield followed(path)
            except (OSError, ValueError, InputError):  # a text that is no file's name
                continue


def _named(path: Path, opened: dict[Path, bytes]) -> Iterator[Path]:
    """The files that a file names."""
    suffix = path.suffix.lower()
    if suffix not in (".toml", ".py", *XML) or path.stat().st_size > MAX_BYTES:
        return
    if suffix in XML:
        opened[path] = path.read_bytes()
        yield from _in_xml(path, opened[path])
    else:
        yield from _in_toml(path) if suffix == ".toml" else _in_python(path)


def _in_toml(path: Path) -> Iterator[Path]:
    try:
        waiting: list[Any] = [read_toml(path)]
    except InputError:  # the command that reads it reports the error
        return
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            waiting += [*value, *value.values()]
        elif isinstance(value, list):
            waiting += value
        else:
            yield from _files(value, path.parent, Path())


def _in_python(path: Path) -> Iterator[Path]:
    try:
        yield from imported(path)
    except (SyntaxError, ValueError, RecursionError, MemoryError, OSError):
        return


def imported(file: Path) -> list[Path]:
    """A Python file and the modules beside it that it imports, and those that these import.

    softdyn itself is left out, even if it lies beside the file, because every fingerprint contains
    it.
    """
    root = file.resolve().parent
    found: list[Path] = []
    todo = [file.resolve()]
    while todo:
        path = todo.pop()
        if path in found:
            continue
        found.append(path)
        for node in ast.walk(ast.parse(path.read_bytes())):
            for module in _modules(node):
                if module.partition(".")[0] == "softdyn":
                    continue
                base = root.joinpath(*module.split("."))
                todo += [p for p in (base.with_suffix(".py"), base / "__init__.py") if p.is_file()]
    return sorted(found)


def _modules(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        module = [node.module] if node.module else []
        return [*module, *(".".join((*module, alias.name)) for alias in node.names)]
    return []


def _in_xml(path: Path, content: bytes) -> Iterator[Path]:
    inner = (os.fsdecode(text) for text in FOLDERS.findall(content))
    folders = [path.parent, *(path.parent / name for name in inner)]
    for double, single in set(QUOTED.findall(content)):
        text = os.fsdecode(double or single)
        yield from _files(text, *folders)
        if "://" in text:
            try:
                yield meshes.locate(path, text)
            except meshes.MeshError:  # the reader of the robot reports the error
                continue
