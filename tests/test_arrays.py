"""NPZ files of any origin: headers and zip entries are checked."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from softdyn import InputError, arrays
from softdyn.arrays import read_npz
from tests.support.refused import refused


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def claims(shape: tuple[int, ...], data: bytes = b"\0" * 64) -> bytes:
    """An array of float numbers whose header claims `shape`."""
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117)
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head) + 1) + head + b"\n" + data


def write(path, entries, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries:
            archive.writestr(name, content)
    return path


def test_what_was_saved_comes_back(tmp_path):
    saved = {"a": np.arange(6.0).reshape(2, 3), "b": np.array("text"), "c": np.zeros((0, 4))}
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "x.npz", **saved)
        found = read_npz(tmp_path / "x.npz", "arrays")
        assert found.keys() == saved.keys()
        assert all(found[name].tobytes() == saved[name].tobytes() for name in saved)


@pytest.mark.parametrize(
    "content",
    [
        claims((10**12,)), claims((10**6, 10**6)), claims((2**62, 4)), claims((-1, -8)),
        claims((7,)), claims((9,)), b"", b"\x93NUMPY\x07\x00", npy(np.array([{}], object)),
        claims((1,) * 40),
    ],
)  # fmt: skip
def test_a_header_that_lies_takes_no_memory(tmp_path, content):
    path = write(tmp_path / "x.npz", [("a.npy", content)])
    tracemalloc.start()
    with refused("x.npz") as error:
        read_npz(path, "arrays")
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()
    assert len(str(error.value).splitlines()) == 1


def test_a_zip_bomb_takes_no_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(arrays, "MAX_BYTES", 10_000_000)
    each = claims((1_000_000,), bytes(8_000_000))
    path = write(tmp_path / "x.npz", [("a.npy", each), ("b.npy", each)])
    assert path.stat().st_size < 50_000
    tracemalloc.start()
    with refused("x.npz", "more than 10000000 bytes"):
        read_npz(path, "arrays")
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_entry_twice_and_other_compressions_are_refused(tmp_path):
    one = npy(np.zeros(2))
    for entries, method in (
        ([("a.npy", one), ("a.npy", one)], zipfile.ZIP_STORED),
        ([("a.npy", one)], zipfile.ZIP_LZMA),
    ):
        with refused("x.npz"):
            read_npz(write(tmp_path / "x.npz", entries, method), "arrays")


def test_every_flipped_bit_is_refused_or_changes_nothing(tmp_path):
    path = tmp_path / "x.npz"
    np.savez_compressed(path, a=np.linspace(0, 1, 7), b=np.array("text"))
    content, saved = path.read_bytes(), read_npz(path, "arrays")
    refused = 0
    for at in range(len(content)):
        path.write_bytes(content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :])
        try:
            found = read_npz(path, "arrays")
        except InputError:
            refused += 1
            continue
        # an array and its name in the list may be missing: the caller checks the names
        assert all(array.tobytes() == saved[name].tobytes() for name, array in found.items())
    assert refused > len(content) // 2
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(InputError):
            read_npz(path, "arrays")
