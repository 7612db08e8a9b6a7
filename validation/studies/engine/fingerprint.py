"""One hash of all that a run depends on: when it changes, the case is run again."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

from softdyn.compiled import COMPILES
from softdyn.validation.plain_data import to_plain_data
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.twin.borrowed import content

# what in softdyn decides a run's numbers; statics, view, tables and plots do not
RUN_BY = (
    "description", "dynamics", "controllers", "validation/twin", "validation/loop",
    "validation/studies/engine", "validation/studies/experiments.py",
)  # fmt: skip
# and those of a case that brings functions of its own
CALLED = ("validation/paper",)
ENGINES = ("pin", "mujoco", "proxsuite", "numpy", "scipy", "numba")


def fingerprint(case: Case, *parts: Any) -> str:
    """A hash of a case, of `parts` that it depends on, of softdyn and of the engines.

    softdyn counts as it is on disk when this process first asks; a file of shapes by its content,
    now.

    Raises
    ------
    InputError
        That file cannot be read.
    """
    calls = case.law or case.target or case.signals.views
    if case.plant.shapes is not None:
        parts = (*parts, content(case.plant.shapes))
    everything = (case, *parts, code(), _hash_of(CALLED) if calls else "")
    return hashlib.sha256(json.dumps(to_plain_data(everything)).encode()).hexdigest()


@cache
def code() -> str:
    """A hash of what every run depends on: the packages that make it, the engines' versions."""
    engines = [(name, _version(name)) for name in ENGINES]
    return hashlib.sha256(repr([engines, COMPILES, _hash_of(RUN_BY)]).encode()).hexdigest()


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def has_digest(path: Path, sha256: str | None) -> bool:
    """Whether a file is there, can be read and has this SHA-256."""
    try:
        return digest(path) == sha256
    except OSError:
        return False


@cache
def _hash_of(names: tuple[str, ...]) -> str:
    """A hash of files of softdyn, of whole folders, and of the files at its top."""
    package = Path(str(files("softdyn")))
    found = [*package.glob("*.py")]
    for name in names:
        path = package / name
        found += [path] if path.is_file() else [*path.rglob("*.py"), *path.rglob("*.toml")]
    return hashlib.sha256(repr([(p.name, digest(p)) for p in sorted(found)]).encode()).hexdigest()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
