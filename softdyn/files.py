"""Write files whole or not at all, and read files of limited size."""

from __future__ import annotations

import io
import os
import stat
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from softdyn.exceptions import FormatError, InputError
from softdyn.formats import without_format

MAX_TOML = 1_000_000  # bytes
LEFT_OVER = 600.0  # s; the writer of an older `.part` file is surely gone


@contextmanager
def atomic(path: str | Path) -> Iterator[BinaryIO]:
    """Open a temporary file for writing; rename it to `path` if the block ends without error.

    A symbolic link is followed. A device or a pipe, and any path below ``/dev`` or ``/proc``, is
    not replaced: the content is written to it at the end.

    Raises
    ------
    InputError
        If the file cannot be written. An existing regular file is then unchanged.
    """
    path = Path(path)
    try:
        if is_stream(path):
            content = io.BytesIO()  # the writer may need to seek
            yield content
            with open(path, "wb", buffering=0) as stream:
                _write_all(stream, content.getbuffer())
            return
        target = followed(path)
        temporary = beside(target)
        try:
            with open(temporary, "xb") as file:
                with suppress(FileNotFoundError):
                    os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, target)
        finally:
            with suppress(OSError):  # after a success it no longer exists
                temporary.unlink()
    except OSError as error:
        raise not_writable(path, error) from None


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to a file, whole or not at all."""
    with atomic(path) as file:
        file.write(text.encode())


def read_toml(path: str | Path) -> dict[str, Any]:
    """The table in a TOML file of at most `MAX_TOML` bytes, without the key that states its format.

    Raises
    ------
    InputError
        If the file cannot be read or is larger.
    FormatError
        If it is no valid TOML, or of another version.
    """
    content = read_bytes(path, MAX_TOML)
    try:
        table = tomllib.loads(content.decode())
        if _holds_large_integer(table):  # Python refuses to print thousands of digits
            raise ValueError("an integer of more than 64 bits")
    except (ValueError, RecursionError) as error:  # numbers of 5000 digits, deep arrays
        raise FormatError(str(path), "a TOML file", error) from None
    return dict(without_format(table, str(path)))


def read_bytes(path: str | Path, most: int) -> bytes:
    """Read a file of at most `most` bytes; stop reading a larger one.

    Raises
    ------
    InputError
        If the file cannot be read or is larger.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as error:  # a name that no system accepts
        reason = getattr(error, "strerror", None) or error
        raise InputError(str(path), "a readable file", reason) from None
    if len(content) > most:
        raise InputError(str(path), f"a file of at most {most} bytes", "a larger one")
    return content


def as_path(name: str, value: str | Path) -> Path:
    """`value` as a path.

    Raises
    ------
    InputError
        If it is neither a path nor a text.
    """
    if not isinstance(value, str | Path):
        raise InputError(name, "a path", repr(value))
    return Path(value)


def existing_folder(name: str, value: str | Path) -> Path:
    """`value` as the resolved path of a folder that exists.

    Raises
    ------
    InputError
        If there is no such folder.
    """
    path = as_path(name, value)
    if not os.path.isdir(path):
        raise InputError(name, "an existing folder", str(value))
    return path.resolve()


def is_stream(path: Path) -> bool:
    """Whether `path` can be written to, but not replaced by a file."""
    if path.parts[:2] in (("/", "dev"), ("/", "proc")):
        return path.exists()
    try:
        return not stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        return False


def followed(path: Path) -> Path:
    """The target of a symbolic link, or `path`; links in a circle raise OSError."""
    if not path.name:
        raise InputError(str(path), "a file", "a folder")
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        target.stat()  # raises OSError
    return target


def beside(path: Path) -> Path:
    """A name beside `path` that no other process, thread or machine uses."""
    return path.with_name(f".{path.name}.{os.urandom(8).hex()}.part")


def remove_left_over(folder: Path) -> None:
    """Delete temporary files of killed writers below `folder`; a write takes only seconds."""
    latest = time.time() - LEFT_OVER
    for path in folder.rglob(".*.part"):
        with suppress(OSError):
            if path.stat().st_mtime < latest:
                path.unlink()


def not_writable(path: Path, error: OSError) -> InputError:
    """The error of a file that cannot be written."""
    return InputError(str(path), "a writable file", error.strerror or error)


def _write_all(stream: Any, content: memoryview) -> None:
    while content:
        content = content[stream.write(content) :]


def _holds_large_integer(value: Any) -> bool:
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return any(_holds_large_integer(part) for part in parts)
    return isinstance(value, int) and not -(2**63) <= value < 2**63
