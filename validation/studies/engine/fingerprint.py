"""One hash of everything on which a run depends; when it changes, the case runs again."""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

from softdyn.compiled import COMPILES
from softdyn.validation.plain_data import to_plain_data
from softdyn.validation.studies.engine.case import Case

# parts of softdyn that influence a run's numbers, without statics, view, tables and plots
RUN_BY = (
    "description", "dynamics", "controllers", "validation/twin", "validation/loop",
    "validation/studies/engine", "validation/studies/experiments.py",
)  # fmt: skip
PICTURES = "validation/loop/pictures"  # the part of these that changes no number
ENGINES = ("pin", "mujoco", "proxsuite", "daqp", "numpy", "scipy", "numba")


def fingerprint(case: Case, *parts: Any) -> str:
    """A hash of a case, of the `parts` on which it depends, of softdyn and of the engines.

    If the case calls functions of its own, every Python file of their folders counts, too. Files
    are hashed at the first call in this process.
    """
    everything = (
        replace(case, words=""),
        *parts,
        code(),
        [_hash_of_folder(one) for one in _called(case)],
    )
    return hashlib.sha256(json.dumps(to_plain_data(everything)).encode()).hexdigest()


def _called(case: Case) -> list[Path]:
    """The folders of the modules of a case's own functions and objects."""
    folders = set()
    for one in (case.law, case.target, case.around, case.options.get("plant")):
        while isinstance(one, partial):
            one = one.func
        builtin = one is None or isinstance(one, dict | str)
        file = None if builtin else getattr(sys.modules[one.__module__], "__file__", None)
        if file is not None:
            folders.add(Path(file).resolve().parent)
    return sorted(folders)


@cache
def code() -> str:
    """A hash of the code of every run: softdyn's packages and the engines' versions."""
    engines = [(name, _version(name)) for name in ENGINES]
    return hashlib.sha256(repr([engines, COMPILES, _hash_of(RUN_BY)]).encode()).hexdigest()


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def has_digest(path: Path, sha256: str | None) -> bool:
    """Whether a file exists, is readable and has this SHA-256."""
    try:
        return digest(path) == sha256
    except OSError:
        return False


@cache
def _hash_of_folder(folder: Path) -> str:
    found = sorted(folder.rglob("*.py"))
    return hashlib.sha256(repr([(p.name, digest(p)) for p in found]).encode()).hexdigest()


@cache
def _hash_of(names: tuple[str, ...]) -> str:
    """A hash of softdyn's files: of complete folders, and of the files at its top."""
    package = Path(str(files("softdyn")))
    found = [*package.glob("*.py")]
    for name in names:
        path = package / name
        found += [path] if path.is_file() else [*path.rglob("*.py"), *path.rglob("*.toml")]
    found = [path for path in found if package / PICTURES not in path.parents]
    return hashlib.sha256(repr([(p.name, digest(p)) for p in sorted(found)]).encode()).hexdigest()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
