"""The line on a terminal that says what a command does, until the command writes something."""

import os
import pty
import sys
import termios
import time
from contextlib import contextmanager

import pytest
from tqdm.auto import tqdm

from softdyn.commands import working
from tests.support import PATIENCE


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    monkeypatch.setattr(working, "QUIET", 0.01)
    monkeypatch.setattr(working, "EVERY", 0.01)


@contextmanager
def terminal():
    """Both streams go to a terminal; it gives a function that reads what the terminal got."""
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (24, 80))  # without a size, no bar is drawn
    os.set_blocking(master, False)
    before, seen = (sys.stdout, sys.stderr), list[str]()

    def read(until, times=1):
        end = time.monotonic() + PATIENCE
        while "".join(seen).count(until) < times:
            assert time.monotonic() < end
            try:
                seen.append(os.read(master, 10_000).decode())
            except BlockingIOError:
                time.sleep(0.005)
        return "".join(seen)

    with open(slave, "w", buffering=1) as stream:
        sys.stdout = sys.stderr = stream
        try:
            yield read
        finally:
            sys.stdout, sys.stderr = before
    os.close(master)


def test_the_line_says_what_is_done_and_goes_with_the_first_output():
    with terminal() as read:
        with working.working("softdyn toy"):
            assert "softdyn toy: starts, " in read("starts, ")
            working.doing("reads a.urdf")
            assert "softdyn toy: reads a.urdf, " in read("reads a.urdf, ")
            print("result")
            read("result")
            working.doing("draws")
            time.sleep(0.05)
            print("more")
            text = read("more")
        before, _, after = text.partition("result")
        assert before.endswith(working.ERASE)
        assert after.split() == ["more"]


def test_the_line_goes_at_the_end_and_with_an_error():
    with terminal() as read:

        def fail():
            with working.working("softdyn toy"):
                read("softdyn toy")
                raise ValueError("bad")

        with pytest.raises(ValueError, match="bad"):
            fail()
        print("error: bad")
        assert read("error: bad").rpartition(working.ERASE)[2].split() == ["error:", "bad"]


def test_a_bar_that_does_not_move_keeps_its_clock_going():
    with (
        terminal() as read,
        working.working("softdyn toy"),
        tqdm(total=2, desc="runs", disable=None, leave=False),
    ):
        read("runs:", times=3)


def test_without_a_terminal_there_is_no_line(capsys):
    with working.working("softdyn toy"):
        time.sleep(0.05)
    assert capsys.readouterr() == ("", "")
