"""Files that appear complete or not at all, and strict JSON."""

import json
import math
import os
import threading
from pathlib import Path

import numpy as np
import pytest

from softdyn.files import remove_left_over
from softdyn.validation.files import (
    atomic,
    check_outputs,
    check_writable,
    to_json,
    write_json,
    write_text,
)
from tests.support import PATIENCE
from tests.support.refused import refused


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


def test_what_a_killed_writer_left_goes_in_time(tmp_path):
    (tmp_path / "cases").mkdir()
    old, new, mine = (
        tmp_path / "cases" / n for n in (".a.json.0f.part", ".b.json.1f.part", "c.part")
    )
    for path in (old, new, mine):
        path.write_text("half")
    for path in (old, mine):
        os.utime(path, (1e9, 1e9))
    remove_left_over(tmp_path)
    assert sorted((tmp_path / "cases").iterdir()) == [new, mine]


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    path = tmp_path / "out"
    with atomic(path) as first:
        first.write(b"first")
        with atomic(path) as second:  # the same process, so the same process number
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
    with refused(where or "."):
        check_writable(where)
    with refused(where or "."):
        write_text(where, "")
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with refused("out", "Not a directory"):
        write_text(tmp_path / "file" / "out", "")


def test_json_is_strict(tmp_path):
    value = {"a": math.nan, "b": [math.inf, 1.5, None], "c": (True, 2, "x"), "d": np.float64(0.5)}
    expected = {"a": None, "b": [None, 1.5, None], "c": [True, 2, "x"], "d": 0.5}
    assert json.loads(to_json(value)) == expected
    assert "NaN" not in to_json(value)
    write_json(tmp_path / "out", value)
    assert json.loads((tmp_path / "out").read_text()) == expected


def test_a_link_is_followed_and_stays(tmp_path):
    (tmp_path / "far").mkdir()
    link = tmp_path / "link"
    link.symlink_to("far/file")
    check_writable(link)
    for text in ("new", "again"):  # a link to nothing, then to a file
        write_text(link, text)
        assert link.is_symlink()
        assert (tmp_path / "far" / "file").read_text() == text
    assert sorted(p.name for p in (tmp_path / "far").iterdir()) == ["file"]


def test_links_in_a_circle(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    for write in (check_writable, lambda path: write_text(path, "")):
        with refused("a", "Too many levels of symbolic links"):
            write(tmp_path / "a")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]


def test_a_pipe_is_written_through(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    check_writable(pipe)
    with atomic(pipe) as file:  # as np.savez does, back and forth
        file.write(b"..." + b"x" * 200_000)
        file.seek(0)
        file.write(b"abc")
    reader.join(PATIENCE)
    assert got == [b"abc" + b"x" * 200_000]
    assert pipe.is_fifo()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="devices of Linux")
def test_devices_stay_devices_and_a_full_one_is_no_success():
    write_text("/dev/null", "x")
    assert not os.path.isfile("/dev/null")
    assert check_writable("/dev/null") == Path("/dev/null")
    for write in (check_writable, lambda path: write_text(path, "x")):
        with refused("/dev/full", "No space left on device"):
            write("/dev/full")


def test_a_file_keeps_its_mode(tmp_path):
    path = tmp_path / "out"
    path.touch(0o600)
    write_text(path, "x")
    assert path.stat().st_mode & 0o777 == 0o600


def test_two_outputs_are_two_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to("out")
    check_outputs("out", None, "other", "-", "-", "/dev/null", "/dev/null")
    for same in ("out", str(tmp_path / "out"), "link"):
        with refused(same, "another output's file"):
            check_outputs("out", same)
    (tmp_path / "out").touch()
    for same in ("out", str(tmp_path / "out"), "link"):
        with refused(same, "its input"):
            check_outputs("other", same, read={(tmp_path / "out").resolve()})
