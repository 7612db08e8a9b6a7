"""Files that appear whole or not at all, and JSON that is JSON."""

import json
import math

import numpy as np
import pytest

from softdyn import InputError
from softdyn.validation.files import atomic, check_writable, to_json, write_json, write_text


def test_a_file_appears_when_it_is_done(tmp_path):
    path = tmp_path / "out"
    with atomic(path) as file:
        file.write(b"all")
        assert not path.exists()
    assert path.read_bytes() == b"all"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_file_does_not(tmp_path):
    path = tmp_path / "out"
    path.write_bytes(b"before")

    def write():
        with atomic(path) as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    path = tmp_path / "out"
    with atomic(path) as first:
        first.write(b"first")
        with atomic(path) as second:  # the same process, so the same number of a process
            second.write(b"second")
        assert path.read_bytes() == b"second"
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_checking_leaves_no_trace(tmp_path):
    path = tmp_path / "out"
    assert check_writable(path) == path
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("where", ["none/out", ".", "", "a" * 300])
def test_where_no_file_can_be(tmp_path, monkeypatch, where):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="expected a"):
        check_writable(where)
    with pytest.raises(InputError, match="expected a"):
        write_text(where, "")
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match=r"file.out: expected a writable file"):
        write_text(tmp_path / "file" / "out", "")


def test_json_is_strict(tmp_path):
    value = {"a": math.nan, "b": [math.inf, 1.5, None], "c": (True, 2, "x"), "d": np.float64(0.5)}
    expected = {"a": None, "b": [None, 1.5, None], "c": [True, 2, "x"], "d": 0.5}
    assert json.loads(to_json(value)) == expected
    assert "NaN" not in to_json(value)
    write_json(tmp_path / "out", value)
    assert json.loads((tmp_path / "out").read_text()) == expected
