"""Files of a command: input is checked, and an output file appears complete or not at all."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import tempfile
from collections.abc import Callable, Set
from contextlib import suppress
from pathlib import Path
from typing import Any

from softdyn import FormatError, InputError
from softdyn.files import atomic as atomic
from softdyn.files import beside, followed, is_stream, not_writable, read_bytes
from softdyn.files import write_text as write_text

MAX_JSON = 64_000_000  # bytes


def check_writable(path: str | Path) -> Path:
    """Return `path` if a file can be written there; the test writes beside it, so nothing changes.

    Raises
    ------
    InputError
        The folder does not exist or is read-only, `path` is a folder, or the device is full or not
        writable.
    """
    path = Path(path)
    if os.path.isdir(path):
        raise InputError(str(path), "a file", "a folder")
    try:
        if is_stream(path):
            if not os.access(path, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            if path.is_char_device():
                with open(path, "wb", buffering=0) as device:
                    device.write(b"")  # which a full one refuses
            return path
        probe = beside(followed(path))
        with open(probe, "xb"):
            pass
        probe.unlink()
    except OSError as error:
        raise not_writable(path, error) from None
    return path


def check_outputs(*paths: str | Path | None, read: Set[Path] = frozenset()) -> None:
    """Check all outputs of a command with `check_writable`; None and ``-`` are skipped.

    Raises
    ------
    InputError
        Also if two outputs are one file, because the second would replace the first. Also if an
        output is a file that the command reads; `inputs.files_read` finds these.
    """
    seen: set[Path] = set()
    for path in paths:
        if path is None or str(path) == "-":
            continue
        check_writable(path)
        if is_stream(Path(path)):
            continue
        target = followed(Path(path))
        if target in seen:
            raise InputError(str(path), "a different file for each output", "another output's file")
        if target in read:
            raise InputError(str(path), "a file that this command does not read", "its input")
        seen.add(target)


def save_somewhere(write: Callable[[str], Any], path: str) -> tuple[str, InputError | None]:
    """Write what cannot be made again, to another folder if there is no room for `path`.

    Parameters
    ----------
    write : Callable[[str], Any]
        Writes to a path, or raises InputError.
    path : str
        The path that was asked for.

    Returns
    -------
    tuple[str, InputError | None]
        The path that was written, and why it is not the one that was asked for.

    Raises
    ------
    InputError
        No folder has room: neither that of temporary files, nor the present one, the home folder
        or shared memory.
    """
    try:
        write(path)
    except InputError as error:
        name = f"{os.urandom(4).hex()}-{Path(path).name}"
        for folder in (tempfile.gettempdir(), os.curdir, os.path.expanduser("~"), "/dev/shm"):
            other = os.path.join(folder, name)
            with suppress(InputError, OSError):
                write(other)
                return other, error
        raise
    return path, None


def read_json(path: str | Path, expected: str) -> dict[str, Any]:
    """The object in a JSON file that `write_json` may have written.

    Parameters
    ----------
    path : str or Path
    expected : str
        Description of the file for the error message.

    Raises
    ------
    InputError
        The file cannot be read, or has more than `MAX_JSON` bytes.
    FormatError
        It is no JSON object, a name occurs twice, or a number is not finite.
    """
    content = read_bytes(path, MAX_JSON)
    try:
        value = json.loads(content, object_pairs_hook=_unique, parse_constant=_refuse_constant)
        if not isinstance(value, dict):
            raise ValueError(f"a {type(value).__name__}")
        if _holds_infinity(value):
            raise ValueError("a number that is not finite")
    except (ValueError, RecursionError, MemoryError) as error:
        raise FormatError(str(path), expected, error) from None
    return value


def to_json(value: Any, indent: int | None = 2) -> str:
    """`value` as strict JSON; numbers that are not finite become null."""
    return json.dumps(_finite(value), indent=indent, allow_nan=False)


def write_json(path: str | Path, value: Any) -> None:
    """Write `to_json` of `value` to a file."""
    write_text(path, to_json(value) + "\n")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name that occurs twice")
    return found


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name}, which is no JSON")


def _holds_infinity(value: Any) -> bool:
    """Whether `value` contains an infinite number, such as Python reads from 1e999."""
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return any(_holds_infinity(part) for part in parts)
    return isinstance(value, float) and not math.isfinite(value)


def safe_filename(text: str) -> str:
    """`text` as one path component; a path or FILE.py:CLASS becomes its last words and a hash."""
    if re.fullmatch(r"[A-Za-z0-9_-]+", text):
        return text
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(text).name)
    return f"{stem}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
