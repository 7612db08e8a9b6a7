"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
import re
import secrets
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from softdyn import InputError

MAX_TOML = 1_000_000  # bytes
MAX_JSON = 64_000_000  # bytes


@contextmanager
def atomic(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file for writing that takes the name `path` when all went well.

    A symbolic link is followed. What is no regular file (a device, a pipe) is written through at
    the end instead of being replaced, and so is what is named below ``/dev`` or ``/proc``.

    Raises
    ------
    InputError
        When the file cannot be written there. A regular file that stood there is then untouched.
    """
    path = Path(path)
    try:
        if _is_stream(path):
            content = io.BytesIO()  # what is written may need to seek
            yield content
            with open(path, "wb", buffering=0) as stream:
                _write_all(stream, content.getbuffer())
            return
        target = _followed(path)
        temporary = _beside(target)
        try:
            with open(temporary, "xb") as file:
                with suppress(FileNotFoundError):
                    os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, target)
        finally:
            with suppress(OSError):  # it is gone when all went well
                temporary.unlink()
    except OSError as error:
        raise _not_writable(path, error) from None


def check_writable(path: str | Path) -> Path:
    """`path` when a file can be written there, tried out beside it so that nothing changes.

    Raises
    ------
    InputError
        For a folder that does not exist or is read-only, a `path` that is a folder, a device that
        may not be written.
    """
    path = Path(path)
    if os.path.isdir(path):
        raise InputError(str(path), "a file", "a folder")
    try:
        if _is_stream(path):
            if not os.access(path, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return path
        probe = _beside(_followed(path))
        with open(probe, "xb"):
            pass
        probe.unlink()
    except OSError as error:
        raise _not_writable(path, error) from None
    return path


def check_outputs(*paths: str | Path | None) -> None:
    """`check_writable` of each file of one command, before any work; None and ``-`` are none.

    Raises
    ------
    InputError
        Also for two outputs that are one file: the second would replace the first.
    """
    seen: set[Path] = set()
    for path in paths:
        if path is None or str(path) == "-":
            continue
        check_writable(path)
        if _is_stream(Path(path)):
            continue
        target = _followed(Path(path))
        if target in seen:
            raise InputError(str(path), "a file for one output alone", "another output's file")
        seen.add(target)


def read_toml(path: str | Path) -> dict[str, Any]:
    """The table in a TOML file of at most `MAX_TOML` bytes.

    Raises
    ------
    InputError
        When it cannot be read, is larger, or is no TOML that Python can hold.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_TOML + 1)
    except (OSError, ValueError) as error:  # a name that no system accepts
        reason = getattr(error, "strerror", None) or error
        raise InputError(str(path), "a readable file", reason) from None
    if len(content) > MAX_TOML:
        raise InputError(str(path), f"a file of at most {MAX_TOML} bytes", "a larger one")
    try:
        table = tomllib.loads(content.decode())
        if _holds_large_integer(table):  # Python cannot even print one of thousands of digits
            raise ValueError("an integer of more than 64 bits")
        return table
    except (ValueError, RecursionError) as error:  # numbers of 5000 digits, deep arrays
        raise InputError(str(path), "a TOML file", error) from None


def read_json(path: str | Path, expected: str) -> dict[str, Any]:
    """The object in a JSON file that `write_json` may have written.

    Parameters
    ----------
    path : str or Path
    expected : str
        What the file should be, for the error.

    Raises
    ------
    InputError
        When it cannot be read, has more than `MAX_JSON` bytes, or is no JSON object that Python can
        hold, with names that are there once and numbers that are finite.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_JSON + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(str(path), "a readable file", reason) from None
    try:
        if len(content) > MAX_JSON:
            raise ValueError(f"more than {MAX_JSON} bytes")
        value = json.loads(content, object_pairs_hook=_unique, parse_constant=_refuse_constant)
        if not isinstance(value, dict):
            raise ValueError(f"a {type(value).__name__}")
        if _holds_infinity(value):
            raise ValueError("a number that is not finite")
    except (ValueError, RecursionError, MemoryError) as error:
        raise InputError(str(path), expected, error) from None
    return value


def to_json(value: Any) -> str:
    """`value` as strict JSON on indented lines; figures that are not finite become null."""
    return json.dumps(_finite(value), indent=2, allow_nan=False)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to a file, whole or not at all."""
    with atomic(path) as file:
        file.write(text.encode())


def write_json(path: str | Path, value: Any) -> None:
    """Write `to_json` of `value` to a file."""
    write_text(path, to_json(value) + "\n")


def _holds_large_integer(value: Any) -> bool:
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return any(_holds_large_integer(part) for part in parts)
    return isinstance(value, int) and not -(2**63) <= value < 2**63


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name that is there twice")
    return found


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name}, which is no JSON")


def _holds_infinity(value: Any) -> bool:
    """Whether there is a number such as 1e999."""
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return any(_holds_infinity(part) for part in parts)
    return isinstance(value, float) and not math.isfinite(value)


def _is_stream(path: Path) -> bool:
    """Whether `path` takes what is written and cannot be replaced by a file."""
    if path.parts[:2] in (("/", "dev"), ("/", "proc")):
        return path.exists()
    try:
        return not stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        return False


def _followed(path: Path) -> Path:
    """Where the link leads, or `path`; links in a circle are an error of the operating system."""
    if not path.name:
        raise InputError(str(path), "a file", "a folder")
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        target.stat()  # raises
    return target


def _write_all(stream: Any, content: memoryview) -> None:
    while content:
        content = content[stream.write(content) :]


def safe(text: str) -> str:
    """`text` as one path component; a path or a class keeps its last words and gains a hash."""
    if re.fullmatch(r"[A-Za-z0-9_-]+", text):
        return text
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(text).name)
    return f"{stem}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _beside(path: Path) -> Path:
    """A name for a file that becomes `path`: of no other process, thread or machine."""
    return path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")


def _not_writable(path: Path, error: OSError) -> InputError:
    return InputError(str(path), "a writable file", error.strerror or error)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
