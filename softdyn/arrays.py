"""Arrays from an NPZ file of any origin: their headers are checked before any array is read.

A header can claim any size, and a zip file can grow a thousandfold when it is unpacked. So both are
checked: an array must have the size that its header states, and all arrays together must stay below
`MAX_BYTES`.
"""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from softdyn.exceptions import FormatError, InputError

MAX_BYTES = 2**30  # for all arrays of one file: a million control steps of a large robot


def read_npz(path: str | Path, expected: str, kind: str = "file") -> dict[str, np.ndarray]:
    """The arrays of an NPZ file by their names.

    Parameters
    ----------
    path : str or Path
    expected, kind : str
        Description of the file for the error message; `kind` is its one word, used when the file
        cannot be opened.

    Raises
    ------
    InputError
        The file cannot be read.
    FormatError
        It is damaged, has pickled objects or holds more than `MAX_BYTES`.
    """
    try:
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            return _arrays(archive)
    except OSError as error:
        raise InputError(str(path), f"a readable {kind}", error.strerror or error) from None
    except Exception as error:  # zipfile, zlib and NumPy raise many exceptions
        raise FormatError(str(path), expected, error) from None


def _arrays(archive: zipfile.ZipFile) -> dict[str, np.ndarray]:
    entries = archive.infolist()
    if len({entry.filename for entry in entries}) < len(entries):
        raise ValueError("an entry that occurs twice")
    if sum(entry.file_size for entry in entries) > MAX_BYTES:
        raise ValueError(f"more than {MAX_BYTES} bytes")
    for entry in entries:
        _check_header(archive, entry)
    return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}


def _check_header(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    """Refuse an array whose size differs from the one in its header."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("another compression")
    with archive.open(entry) as stream:
        if npy.read_magic(stream) != (1, 0):
            raise ValueError("another version of NPY")
        shape, _, dtype = npy.read_array_header_1_0(stream)
        if dtype.hasobject:
            raise ValueError("pickled objects")
        if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != (
            entry.file_size - stream.tell()
        ):
            raise ValueError(f"{entry.filename} whose size differs from its header")


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    content = io.BytesIO(archive.read(entry))  # to the end, where zipfile tests the checksum
    return npy.read_array(content, allow_pickle=False)
