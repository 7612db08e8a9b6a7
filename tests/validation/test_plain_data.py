"""Gains of any kind as JSON, with the same text in every process."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pytest

from softdyn.validation.plain_data import to_plain_data


class Tuning:
    pass


@dataclass
class Table:
    Kp: float
    parts: tuple[Tuning, ...]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, None),
        (1.5, 1.5),
        (np.float64(2), 2.0),
        (np.arange(4).reshape(2, 2), [[0, 1], [2, 3]]),
        ((1, [np.bool_(True)]), [1, [True]]),
        ({1: {"a": (2,)}}, {"1": {"a": [2]}}),
        ({"b", "a"}, ["a", "b"]),
        (Table(3.0, (Tuning(),)), {"Kp": 3.0, "parts": ["<test_plain_data.Tuning object>"]}),
        (Tuning().__init__, "<method-wrapper '__init__' of Tuning object>"),
        (Enum("Mode", "SOFT")["SOFT"], "<Mode.SOFT: 1>"),
    ],
)
def test_values(value, expected):
    found = json.loads(json.dumps(to_plain_data(value)).replace("tests.", ""))
    assert found == expected


def test_two_processes_agree():
    code = (
        "import json, runpy, sys; to_plain_data = runpy.run_path(sys.argv[1])['to_plain_data'];"
        "value = {'s': {'tip', 'base', 'middle'}, 'f': lambda: 0, 'o': [iter('')]};"
        "print(json.dumps(to_plain_data(value)))"
    )
    file = sys.modules[to_plain_data.__module__].__file__
    first, second = (
        subprocess.run(
            [sys.executable, "-c", code, file], capture_output=True, check=True,
            env=os.environ | {"PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    )  # fmt: skip
    assert first == second
    assert json.loads(first)["s"] == ["base", "middle", "tip"]
