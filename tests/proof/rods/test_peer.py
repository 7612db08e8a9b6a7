"""The same arm in an independent code: agreement within a discretisation error of second order."""

from __future__ import annotations

import sys

import pytest

from tests.proof.rods import peer
from tests.support.refused import refused


def test_the_peer_agrees():
    pytest.importorskip("soromox", reason="the extra peers is not installed")
    found = peer.compare((5, 10, 20))
    for ladder in found["ladders"]:
        if ladder.name == "K":
            assert max(ladder.errors) < 1e-12
        else:
            assert ladder.order == pytest.approx(2, abs=0.3), ladder.name
            assert ladder.errors[-1] < 2e-3


def test_without_the_extra_one_line_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    with refused("--peer", "import of jax halted; None in sys.modules"):
        peer.build(peer.ARM)
