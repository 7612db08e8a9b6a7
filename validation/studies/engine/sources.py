"""The files of a robot or a controller: found here, sent along, and found by a worker."""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import softdyn
from softdyn import InputError, SoftdynError, SoftModel
from softdyn.controllers import find_controller
from softdyn.controllers.registry import is_own
from softdyn.description.library import bundled_names, find
from softdyn.validation.inputs import imported
from softdyn.validation.studies.engine.fingerprint import digest, has_digest

# Models and classes are built once per thread, because threads cannot share a SoftModel's scratch
# memory.
_kept = threading.local()


class NotHere(SoftdynError):
    """This worker cannot run the case, but another one may."""


@dataclass(frozen=True)
class Source:
    """The files of a robot or a controller, with hashes by which a worker checks its own files.

    Attributes
    ----------
    text : str
        The user's name for it.
    path : str
        The main file on the machine where it was found.
    files : tuple of (str, str)
        (path relative to the main file's folder, SHA-256) of each, in order.
    own : bool
        Whether they are the user's own. Others belong to a package that every worker has.
    overlay : Source, optional
        A robot's annotations, if they are in a separate file.
    """

    text: str
    path: str
    files: tuple[tuple[str, str], ...]
    own: bool
    overlay: Source | None = None

    @property
    def parts(self) -> tuple[Source, ...]:
        """The source itself, and its overlay if there is one."""
        return (self,) if self.overlay is None else (self, self.overlay)

    @classmethod
    def of(cls, text: str, paths: Sequence[Path], own: bool) -> Source:
        """The source of the files at `paths`, the main one first."""
        main = paths[0].resolve()
        found = [(p.relative_to(main.parent).as_posix(), p) for p in (main, *paths[1:])]
        return cls(text, str(main), tuple((name, digest(path)) for name, path in found), own)

    def contents(self) -> dict[str, bytes]:
        """SHA-256 → content of the user's own files.

        Raises
        ------
        InputError
            A file cannot be read.
        """
        folder = Path(self.path).parent
        try:
            return {sha256: (folder / name).read_bytes() for name, sha256 in self.files}
        except OSError as error:
            raise InputError(self.text, "a readable file", error.strerror) from None


# -- where they are found --------------------------------------------------------------------------


def of_robot(
    text: str, folder: Path = Path(), annotations: str | None = None
) -> tuple[Source, SoftModel]:
    """A robot's source and its model; a relative path is relative to `folder`.

    The source contains the file of its `annotations`.

    Raises
    ------
    UrdfError, InputError
        The robot does not exist or cannot be used.
    """
    beside = folder / text
    own = text not in bundled_names() and os.path.isfile(beside)
    model = load_model(beside if own else text, annotations and folder / annotations)
    own = own and model.bundled is None
    if annotations is None:
        return Source.of(model.bundled or text, [model.robot.path], own), model
    found = Source.of(text, [model.robot.path], own)
    overlay = Source.of(annotations, [folder / annotations], own=True)
    return replace(found, overlay=overlay), model


def class_at(text: str, folder: Path = Path()) -> Any:
    """The class of a name of the package or of FILE.py:CLASS, relative to `folder`.

    Raises
    ------
    InputError
        The name, file or class does not exist, or the file cannot be imported.
    """
    file, _, kind = text.rpartition(":")
    with redirect_stdout(sys.stderr):  # a user's module may print
        return find_controller(f"{folder / file}:{kind}" if is_own(text) else text)


def of_controller(text: str, folder: Path = Path()) -> Source | None:
    """Source of a user's FILE.py:CLASS, relative to `folder`; None for a name of the package.

    Raises
    ------
    InputError
        The name, file or class does not exist, or the file cannot be imported.
    """
    class_at(text, folder)
    if not is_own(text):
        return None
    path = folder / text.rpartition(":")[0]
    beside = [p for p in imported(path) if p != path.resolve()]
    return Source.of(text, [path, *beside], own=True)


def load_model(robot: str | Path, annotations: str | Path | None = None) -> SoftModel:
    """The model of a robot from its current files; cached while they do not change."""
    files = [find(robot), *([] if annotations is None else [Path(annotations)])]
    key = (str(robot), *((str(f), digest(f) if os.access(f, os.R_OK) else "") for f in files))
    models = _kept.__dict__.setdefault("models", {})
    if key not in models:
        models[key] = softdyn.load(robot, annotations=annotations)
    found: SoftModel = models[key]
    return found


# -- where they are used ---------------------------------------------------------------------------


def model_of(source: Source, contents: Mapping[str, bytes]) -> SoftModel:
    """The model of a robot, from the user's own file or from the package of this machine."""
    overlay = None if source.overlay is None else _own_file(source.overlay, contents)
    if source.own:
        return load_model(_own_file(source, contents), overlay)
    if digest(find(source.text)) != source.files[0][1]:
        raise NotHere(f"this worker has another {source.text}")
    return load_model(source.text, overlay)


def class_of(source: Source, contents: Mapping[str, bytes]) -> Callable[..., Any]:
    """The user's own class."""
    kind = source.text.rpartition(":")[2]
    classes = _kept.__dict__.setdefault("classes", {})
    if (source.files, kind) not in classes:
        path = _own_file(source, contents)
        _forget_modules(source, path.parent)
        classes[source.files, kind] = find_controller(f"{path}:{kind}")
    found: Callable[..., Any] = classes[source.files, kind]
    return found


def _forget_modules(source: Source, folder: Path) -> None:
    """Forget a user's modules, because a worker may have imported other versions."""
    for name, _ in source.files:
        parts = Path(name).with_suffix("").parts
        sys.modules.pop(".".join(parts[:-1] if parts[-1] == "__init__" else parts), None)
    while str(folder) in sys.path:  # the import of the class puts it first
        sys.path.remove(str(folder))
    importlib.invalidate_caches()


def _own_file(source: Source, contents: Mapping[str, bytes]) -> Path:
    """The user's main file at its place, or a copy from the files sent along."""
    path = Path(source.path)
    if all(has_digest(path.parent / name, sha256) for name, sha256 in source.files):
        return path
    if not all(sha256 in contents for _, sha256 in source.files):
        raise NotHere(f"{source.text} changed after the study began")
    if not hasattr(_kept, "folder"):
        _kept.folder = tempfile.TemporaryDirectory(prefix="softdyn-")
    mark = hashlib.sha256(repr(source.files).encode()).hexdigest()[:16]
    for name, sha256 in source.files:
        copy = Path(_kept.folder.name) / mark / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(contents[sha256])
    return Path(_kept.folder.name) / mark / source.files[0][0]
