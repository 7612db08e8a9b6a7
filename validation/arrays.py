"""Arrays from an NPZ file that anyone may have written: judged by their headers before any is read.

A header can claim any size and a zip file can grow a thousandfold, so that neither is believed: an
array has the size its header says or is refused, and all together stay below `MAX_BYTES`.
"""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from softdyn import InputError

MAX_BYTES = 2**30  # of all arrays of one file: a million control steps of a large robot


def read_npz(path: str | Path, expected: str, kind: str = "file") -> dict[str, np.ndarray]:
    """The arrays of an NPZ file by their names.

    Parameters
    ----------
    path : str or Path
    expected, kind : str
        What the file should be, for the error, and in one word for one that cannot be opened.

    Raises
    ------
    InputError
        A file that cannot be read, is damaged, has pickled objects or more than `MAX_BYTES` of
        content.
    """
    try:
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            return _arrays(archive)
    except OSError as error:
        raise InputError(str(path), f"a readable {kind}", error.strerror or error) from None
    except Exception as error:  # zipfile, zlib and NumPy raise a dozen kinds for damaged content
        raise InputError(str(path), expected, error) from None


def _arrays(archive: zipfile.ZipFile) -> dict[str, np.ndarray]:
    entries = archive.infolist()
    if len({entry.filename for entry in entries}) < len(entries):
        raise ValueError("an entry that is there twice")
    if sum(entry.file_size for entry in entries) > MAX_BYTES:
        raise ValueError(f"more than {MAX_BYTES} bytes")
    for entry in entries:
        _check_header(archive, entry)
    return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}


def _check_header(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    """Refuse an array of another size than its header says."""
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
            raise ValueError(f"{entry.filename} of another size than its header says")


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    content = io.BytesIO(archive.read(entry))  # to its end, where zipfile checks the sum
    return npy.read_array(content, allow_pickle=False)
