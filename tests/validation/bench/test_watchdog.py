"""The watchdog; each loop is a process of its own that dies or blocks on request."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

from softdyn.validation.bench.watchdog import Watchdog, shared


class Noting:
    """A driver that notes its calls in a pipe."""

    def __init__(self, into):
        self.into = into

    def start(self):
        os.write(self.into, b"start\n")

    def stop(self):
        os.write(self.into, b"stop\n")


def loop(body, late):
    """Fork a process that makes a watchdog and runs `body`; the driver's notes, its status."""
    out, into = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(out)
        try:
            body(Watchdog(Noting(into), late))
        finally:
            os._exit(0)
    os.close(into)
    noted = b""
    while piece := os.read(out, 100):  # until loop and watchdog have ended
        noted += piece
    os.close(out)
    return noted.decode().split(), os.waitpid(pid, 0)[1]


def dies(dog):
    dog.beat()
    os.kill(os.getpid(), signal.SIGKILL)


def blocks(dog):
    dog.beat()
    signal.pause()


def ends(dog):
    dog.beat()
    dog.end()


@pytest.mark.parametrize(
    ("body", "calls", "killed"),
    [(dies, ["start", "stop"], True), (blocks, ["start", "stop"], True), (ends, [], False)],
)
def test_the_rig_is_relaxed_when_the_loop_is_gone(body, calls, killed):
    noted, status = loop(body, late=0.05)
    assert noted == calls
    assert os.WIFSIGNALED(status) == killed


def test_the_loop_learns_that_the_watchdog_is_gone():
    dog = Watchdog(Noting(os.open(os.devnull, os.O_WRONLY)), late=60.0)
    assert dog.beat()
    os.kill(dog.pid, signal.SIGKILL)
    os.waitpid(dog.pid, 0)
    assert not dog.beat()
    dog.end()


def test_shared_memory_is_seen_by_a_fork():
    numbers = shared(np.arange(6.0).reshape(2, 3))
    pid = os.fork()
    if pid == 0:
        numbers[1, 2] = 42.0
        os._exit(0)
    os.waitpid(pid, 0)
    assert numbers[1, 2] == 42.0
