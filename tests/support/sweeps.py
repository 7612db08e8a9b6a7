"""A user's folder with sweeps: a pendulum, a controller with a module beside it, sweep files."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.support import PATIENCE
from tests.support.robots import finger

PENDULUM = finger(tip="0 0 -0.2")
OWN = """
import os
from types import SimpleNamespace

import numpy as np
from neighbour import DAMPING


class Spring:
    def __init__(self, model, table=None):
        self.gains = dict(table or {"stiffness": 1.0})
        print("built")

    def __call__(self, state, reference):
        stiffness = self.gains["stiffness"]
        if stiffness == 13:
            raise ZeroDivisionError("thirteen")
        if stiffness == 66:
            os.kill(os.getpid(), 9)
        force = stiffness * (reference.y - state.y) - DAMPING * state.ydot
        return SimpleNamespace(u=state.J.T @ force)
"""
OWN_SWEEP = """
robots = ["pendulum.urdf"]
controllers = ["own.py:Spring"]
[targets]
point = [0.1, 0, -0.17]
[gains]
stiffness = {stiffness}
[run]
duration = 0.3
"""
FINGER = """
robots = "finger"
controllers = ["ic"]
[targets]
theta = [0.5, 1]
[run]
duration = 0.2
[gains]
"""


def contents(folder: Path) -> dict[str, bytes]:
    """Everything below a folder: relative path → bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def results(folder: Path) -> list[dict[str, Any]]:
    """The results of all cases below a folder."""
    return [json.loads(path.read_text()) for path in sorted(folder.rglob("cases/**/*.json"))]


def wait_for(condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.005)
