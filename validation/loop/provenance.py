"""The surroundings of a run: files with their digests, versions, the processor, the git commit.

A file is ``{"path": …, "sha256": …}`` in memory. In a record on disk its path is relative to the
record's folder if it lies below; else only its ``name`` stands there.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import softdyn
from softdyn.controllers.registry import is_own
from softdyn.validation.inputs import imported

PACKAGES = ("pin", "mujoco", "proxsuite", "daqp", "numpy", "scipy", "numba")
GIT_SECONDS = 5.0  # a working folder on a slow network must not stop a run
PYTHON = "{python}"  # the folder of the Python installation, at the beginning of a path


@cache
def package_versions() -> tuple[tuple[str, str], ...]:
    """Versions of the packages that influence a run's numbers, and Python's."""
    found = [("softdyn", softdyn.__version__), ("python", platform.python_version())]
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found.append((package, version(package)))
    return tuple(found)


@cache
def processor() -> str:
    """The processor's name."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            key, _, name = line.partition(":")
            if key.strip() == "model name":
                return name.strip()
    return platform.processor() or platform.machine()


@cache
def commit_of(folder: str) -> dict[str, Any] | None:
    """The git commit of a working folder, and whether a tracked file has changed since.

    None without a commit.
    """
    head = _git(folder, "rev-parse", "HEAD")
    if not head:
        return None
    status = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return {"commit": head, "changed": status is None or status != ""}


def _git(folder: str, *words: str) -> str | None:
    environment = os.environ | {"GIT_OPTIONAL_LOCKS": "0", "LC_ALL": "C"}
    try:
        done = subprocess.run(
            ["git", *words], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, timeout=GIT_SECONDS, check=False,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def surroundings() -> dict[str, Any]:
    """The processor and the git commit of the working folder."""
    try:
        folder = os.getcwd()
    except OSError:  # it was removed
        return {"processor": processor(), "git": None}
    return {"processor": processor(), "git": commit_of(folder)}


# -- files -----------------------------------------------------------------------------------------


def file_of(path: str | Path) -> dict[str, Any]:
    """A file with its digest, None if it cannot be read."""
    return {"path": os.path.abspath(path), "sha256": digest_of(path)}


def digest_of(path: str | Path) -> str | None:
    """The SHA-256 of a file; None if it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except (OSError, ValueError):
        return None


def modules_of(path: str | Path) -> list[dict[str, Any]]:
    """The modules of its folder that a Python file imports, and those that these import."""
    try:
        stamp = os.stat(path).st_mtime_ns
        found = _modules_of(os.path.realpath(path), stamp)
    except (OSError, SyntaxError, ValueError, RecursionError):
        return []
    return [file_of(one) for one in found]


@cache
def _modules_of(path: str, stamp: int) -> tuple[Path, ...]:
    return tuple(one for one in imported(Path(path)) if str(one) != path)


def files_in(value: Any) -> Iterator[dict[str, Any]]:
    """All files in a record."""
    if isinstance(value, Mapping):
        if "sha256" in value:
            yield dict(value)
        else:
            for one in value.values():
                yield from files_in(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from files_in(one)


def exchanged(value: Any, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """A copy of a record in which each file is changed."""
    if isinstance(value, Mapping):
        if "sha256" in value:
            return change(dict(value))
        return {key: exchanged(one, change) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [exchanged(one, change) for one in value]
    return value


def written(record: Any, folder: Path) -> Any:
    """A record for a file in a folder: no path leads out of it."""

    def change(file: dict[str, Any]) -> dict[str, Any]:
        if "path" not in file:
            return file
        path = file.pop("path")
        below = path_below(path, folder)
        return (
            {"name": os.path.basename(path), **file} if below is None else {"path": below, **file}
        )

    return exchanged(record, change)


def found(record: Any, folder: Path) -> Any:
    """A record from a file in a folder, with absolute paths: the inverse of `written`."""

    def change(file: dict[str, Any]) -> dict[str, Any]:
        return file | ({"path": path_from(file["path"], folder)} if "path" in file else {})

    return exchanged(record, change)


def path_below(path: str, folder: Path) -> str | None:
    """A path relative to a folder, with slashes; None if it does not lie below.

    A file of the Python installation, such as a robot of a package, is relative to that.
    """
    for root, begin in ((folder, ""), (Path(sys.prefix), f"{PYTHON}/")):
        with suppress(ValueError):
            real = Path(os.path.realpath(path)).relative_to(os.path.realpath(root))
            return f"{begin}{real.as_posix()}"
    return None


def path_from(text: str, folder: Path) -> str:
    """The absolute path of a path that `path_below` made."""
    if text.startswith(f"{PYTHON}/"):
        return os.path.join(sys.prefix, text.removeprefix(f"{PYTHON}/"))
    return os.path.abspath(folder / text)


def path_shown(path: str, folder: Path) -> str:
    """A path as a file in a folder states it: relative if below, or the file's name."""
    return path_below(path, folder) or os.path.basename(path)


def name_shown(text: str) -> str:
    """A controller's name as a file states it: FILE.py:CLASS without a path out of its folder."""
    path, _, name = text.rpartition(":")
    leads_out = os.path.isabs(path) or ".." in Path(path).parts
    return f"{os.path.basename(path)}:{name}" if is_own(text) and leads_out else text
