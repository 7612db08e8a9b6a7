"""Find a robot's file: a bundled one, a path, or one of the example-robot-data package."""

from __future__ import annotations

import difflib
import os
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from softdyn.exceptions import InputError

BUNDLED = (Path(__file__).parent.parent / "robots").resolve()


def bundled_names() -> tuple[str, ...]:
    """Names of the robots that ship with softdyn."""
    return tuple(sorted(path.stem for path in BUNDLED.glob("*.urdf")))


def bundled_name(path: Path) -> str | None:
    """The robot's name if `path` is a bundled file; None for any other file, even of that name."""
    own = path.resolve()
    return own.stem if own.parent == BUNDLED and own.suffix == ".urdf" else None


def bundled_file(name: str) -> Path | None:
    """The file of a bundled robot; None for any other name."""
    return BUNDLED / f"{name}.urdf" if name in bundled_names() else None


def example_files() -> tuple[Path, ...]:
    """All URDFs of example-robot-data; the package has no Python module of its own."""
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        return ()
    files = sorted(str(file) for file in package.files or () if str(file).endswith(".urdf"))
    return tuple(Path(str(package.locate_file(file))).resolve() for file in files)


def example_robots() -> dict[str, Path]:
    """URDFs of example-robot-data by file stem; if several share a stem, the last one."""
    return {path.stem: path for path in example_files()}


def find(source: str | Path) -> Path:
    """The URDF file behind a bundled name, a path, or an example-robot-data name.

    Raises
    ------
    InputError
        If there is no such robot or file.
    """
    text = str(source)
    if (own := bundled_file(text)) is not None:
        return own
    path = Path(text)
    if os.path.isfile(path):  # Path.is_file raises on names that no system accepts
        if path.suffix.lower() == ".toml":
            expected = f"a URDF: `softdyn new {text}` writes one from such a file"
            raise InputError("robot", expected, text)
        return path
    examples = example_robots() if len(path.parts) == 1 else {}
    for name in (text, f"{text}_robot"):  # some files of the package: ur5_robot.urdf
        if name in examples:
            return examples[name]
    if path.suffix or len(path.parts) != 1:  # after the names, because a name may hold a dot
        raise InputError("robot", "an existing file", text)
    known = [*bundled_names(), *examples]
    near = difflib.get_close_matches(text, known, 3) or bundled_names()
    more = "" if example_files() else "; `pip install example-robot-data` brings more"
    raise InputError("robot", f"a URDF file or a name such as {', '.join(near)}{more}", text)
