"""The files of a robot, a controller or a trajectory: found here, sent along, and found there."""

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
from softdyn.files import read_toml
from softdyn.safety import Surroundings
from softdyn.validation.inputs import files_read, imported
from softdyn.validation.loop.settings import MODEL, make_forces
from softdyn.validation.loop.trajectories import Trajectory, read_trajectory
from softdyn.validation.studies.engine.fingerprint import digest, has_digest

# Models and classes are built once per thread, because threads cannot share a SoftModel's scratch
# memory.
_kept = threading.local()


class NotHere(SoftdynError):
    """This worker cannot run the case, but another one may."""


@dataclass(frozen=True)
class Source:
    """The files of one thing, with hashes by which a worker checks its own files.

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
        found = [(Path(os.path.relpath(p, main.parent)).as_posix(), p) for p in (main, *paths[1:])]
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


def of_controller(text: str, folder: Path = Path(), depends: Sequence[str] = ()) -> Source | None:
    """Source of a user's FILE.py:CLASS, relative to `folder`; None for a name of the package.

    It contains the modules beside the file that it imports, and the files that it `depends` on.

    Raises
    ------
    InputError
        The name, file or class does not exist, or the file cannot be imported.
    """
    class_at(text, folder)
    return _of_own(text, folder, depends) if is_own(text) else None


def _of_own(text: str, folder: Path, depends: Sequence[str]) -> Source:
    path = folder / text.rpartition(":")[0]
    beside = [p for p in imported(path) if p != path.resolve()]
    beside += [one for name in depends if (one := (folder / name).resolve()) not in beside]
    return Source.of(text, [path, *beside], own=True)


def of_force(text: str, folder: Path = Path(), depends: Sequence[str] = ()) -> Source:
    """Source of a force of one's own, FILE.py:CLASS, relative to `folder`."""
    return _of_own(text, folder, depends)


def of_trajectory(text: str, folder: Path = Path(), depends: Sequence[str] = ()) -> Source:
    """Source of a trajectory: a CSV file or a class, relative to `folder`."""
    if is_own(text):
        return _of_own(text, folder, depends)
    return Source.of(text, [folder / text], own=True)


def forced(
    model: SoftModel,
    names: Sequence[str],
    numbers: Mapping[str, float],
    find: Callable[[str], Callable[[], Any]],
) -> SoftModel:
    """A model with forces of one's own; see `make_forces`."""
    return model.with_forces(*make_forces(names, numbers, find)) if names else model


def is_file(name: str, value: str) -> bool:
    """Whether the text of one of the options `case.FILES` names a file."""
    if name == "plant":
        return value != MODEL
    return name != "observer" or is_own(value)


def of_option(name: str, value: str, folder: Path = Path(), depends: Sequence[str] = ()) -> Source:
    """Source of the file that one of the options `case.FILES` names."""
    if name == "observer":
        return _of_own(value, folder, depends)
    path = (folder / value).resolve()
    return Source.of(value, [path, *sorted(files_read([path]) - {path})], own=True)


def option_of(source: Source, name: str, model: SoftModel, contents: Mapping[str, bytes]) -> Any:
    """The value of an option that `of_option` names: a scene, obstacles, an observer's class.

    Raises
    ------
    UrdfError, InputError
        The file cannot be used.
    """
    path = _own_file(source, contents)
    if name == "plant":
        from softdyn.validation.mjcf.scene import Scene  # few sweeps need the comparison of files

        return Scene(model, path)
    if name == "surroundings":
        return Surroundings.of(read_toml(path), source.text)
    return f"{path}:{source.text.rpartition(':')[2]}"


def trajectory_of(
    source: Source, kind: str, model: SoftModel, contents: Mapping[str, bytes]
) -> Trajectory:
    """The trajectory of a source, of one of the kinds `case.OWN`."""
    if is_own(source.text):
        return read_trajectory(source.text, model, make=class_of(source, contents))
    return read_trajectory(_own_file(source, contents), model, periodic=kind == "periodic")


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
    # equal files of another folder may change later, and the record of a run states its file
    key = source.path, source.files, kind
    if key not in classes:
        path = _own_file(source, contents)
        _forget_modules(source, path.parent)
        classes[key] = find_controller(f"{path}:{kind}")
    found: Callable[..., Any] = classes[key]
    return found


def _forget_modules(source: Source, folder: Path) -> None:
    """Forget a user's modules, because a worker may have imported other versions."""
    for name in (name for name, _ in source.files if name.endswith(".py")):
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
    above = max(Path(name).parts.count("..") for name, _ in source.files)
    root = Path(_kept.folder.name).joinpath(mark, *["_"] * above)
    for name, sha256 in source.files:
        copy = root / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(contents[sha256])
    return root / source.files[0][0]
