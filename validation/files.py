"""Files that appear whole or not at all."""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from softdyn import InputError


@contextmanager
def atomic(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new file beside `path` for writing; it takes that name when all went well.

    Raises
    ------
    InputError
        When the file cannot be written there. What stood at `path` before is untouched.
    """
    path = Path(path)
    temporary = _beside(path)
    try:
        with open(temporary, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise _not_writable(path, error) from None
    finally:
        with suppress(OSError):  # it is gone when all went well
            temporary.unlink()


def check_writable(path: str | Path) -> Path:
    """`path` when a file can be written there, tried out beside it so that nothing changes.

    Raises
    ------
    InputError
        For a folder that does not exist or is read-only, or a `path` that is a folder.
    """
    path = Path(path)
    if os.path.isdir(path):
        raise InputError(str(path), "a file", "a folder")
    probe = _beside(path)
    try:
        with open(probe, "xb"):
            pass
        probe.unlink()
    except OSError as error:
        raise _not_writable(path, error) from None
    return path


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


def _beside(path: Path) -> Path:
    """A name for a file that becomes `path`: of no other process, thread or machine."""
    if not path.name:
        raise InputError(str(path), "a file", "a folder")
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
