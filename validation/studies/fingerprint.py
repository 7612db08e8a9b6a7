"""What a benchmark case depends on, as one hash: when it changes, the case is run again."""

from __future__ import annotations

import ast
import hashlib
import json
import os
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import softdyn
from softdyn import SoftModel
from softdyn.compiled import COMPILES
from softdyn.controllers import find_controller
from softdyn.controllers.registry import blamed, is_own
from softdyn.description.library import find
from softdyn.validation.plain import plain
from softdyn.validation.studies import paper

if TYPE_CHECKING:
    from softdyn.validation.studies.benchmark import Case

# the folders of softdyn that decide a run's numbers; statics, view, tables and plots do not
RUN_BY = ("description", "dynamics", "controllers", "validation/twin", "validation/loop")
ENGINES = ("pin", "mujoco", "proxsuite", "numpy", "scipy", "numba")


def fingerprint(case: Case) -> str:
    """A hash of the experiment, the robot's file, the controller, softdyn and the engines.

    A controller counts with its gains; a user's own with its file and the modules beside that
    file which it imports. softdyn counts as it is on disk when this process first asks.

    Raises
    ------
    InputError
        For a robot, a controller or an experiment that cannot be run.
    """
    model = load_model(case.robot)
    case.experiment(model)
    parts = (
        case.robot,
        case.controller,
        case.kind,
        case.value,
        repr(paper.setup_of(model)),
        digest(model.robot.path),
        _controller(case.robot, case.controller, digest(model.robot.path), _own(case.controller)),
        _code(),
    )
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def load_model(robot: str) -> SoftModel:
    """The model of a robot as its file is now; read once as long as that does not change."""
    path = find(robot)
    return _load(robot, digest(path) if os.access(path, os.R_OK) else "")


def make_controller(name: str, model: SoftModel) -> Any:
    """A controller by name for one run; what a user's own raises becomes an InputError."""
    cls = find_controller(name)
    with blamed(name, "a controller"):
        return cls(model)


def sources(file: Path) -> list[Path]:
    """A Python file and the modules beside it that it imports, and those that these import."""
    root = file.resolve().parent
    found: list[Path] = []
    todo = [file.resolve()]
    while todo:
        path = todo.pop()
        if path in found:
            continue
        found.append(path)
        for node in ast.walk(ast.parse(path.read_bytes())):
            for module in _imported(node):
                base = root.joinpath(*module.split("."))
                todo += [p for p in (base.with_suffix(".py"), base / "__init__.py") if p.is_file()]
    return sorted(found)


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        module = [node.module] if node.module else []
        return [*module, *(".".join((*module, alias.name)) for alias in node.names)]
    return []


@cache
def _load(robot: str, _digest: str) -> SoftModel:
    return softdyn.load(robot)


def _own(controller: str) -> tuple[str, ...]:
    """Hashes of a user's own files; none for a controller of the package."""
    if not is_own(controller):
        return ()
    try:
        return tuple(digest(path) for path in sources(Path(controller.rpartition(":")[0])))
    except (OSError, SyntaxError, ValueError):
        find_controller(controller)  # says in one line what is wrong with the file
        raise


@cache
def _controller(robot: str, controller: str, _robot: str, own: tuple[str, ...]) -> str:
    """Gains and own files of a controller, as text."""
    gains = getattr(make_controller(controller, load_model(robot)), "gains", None)
    return json.dumps([plain(gains), own])


@cache
def _code() -> str:
    """A hash of the packages that make a run, and of the engines' versions."""
    found = hashlib.sha256(repr([(name, _version(name)) for name in ENGINES]).encode())
    found.update(repr(COMPILES).encode())
    package = Path(str(files("softdyn")))
    folders = [path for name in RUN_BY for path in (package / name).rglob("*.py")]
    for path in sorted([*package.glob("*.py"), *folders]):
        found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
