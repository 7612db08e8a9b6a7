"""Damaged messages to a live robot, which must refuse each in one line or obey it and go on."""

from __future__ import annotations

import json
import random
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError
from softdyn.controllers import Impedance
from softdyn.validation.live.session import Session
from softdyn.view.live.messages import OPEN_LOOP, read
from tests.proof.fuzzing import campaign
from tests.proof.fuzzing.data import change_json, template
from tests.proof.fuzzing.inputs import changed_bytes
from tests.proof.fuzzing.verdict import (  # fmt: skip
    ACCEPTED,
    EXCEPTION,
    LONGEST_MESSAGE,
    LOST,
    MESSAGE,
    REFUSED,
    Verdict,
)

SAID: tuple[dict[str, Any], ...] = (
    {"do": "target", "y": [0.1, 0.0, -0.15]},
    {"do": "inputs", "u": [0.2, -0.1]},
    {"do": "joints", "x": [0.1, 0.0, -0.2, 0.3]},
    {"do": "law", "name": "ic"},
    {"do": "law", "name": OPEN_LOOP},
    {"do": "mismatch", "mass": 1.2, "stiffness": 0.9, "damping": 1.1, "contacts": True,
     "delay": 0.01, "noise": 0.001},
    {"do": "push", "link": "link4", "at": [0.01, 0.0, 0.0], "to": [0.1, 0.0, -0.2]},
    {"do": "release"}, {"do": "step"}, {"do": "reset"}, {"do": "reach"}, {"do": "lead"},
    {"do": "pause", "on": False}, {"do": "ghost", "on": True}, {"do": "record", "on": True},
    {"do": "speed", "factor": 0.5},
)  # fmt: skip


def said() -> list[bytes]:
    """A message of every kind."""
    return [json.dumps(one).encode() for one in SAID]


def mutant(bases: Sequence[bytes], seed: int, index: int) -> bytes:
    """The message number `index` of a seed."""
    rng = random.Random(f"{seed}:{index}")
    data = rng.choice(bases)
    for _ in range(rng.choice((1, 1, 2, 3))):
        data = rng.choice((change_json, change_json, changed_bytes))(rng, data)
    return data


def judge(session: Session, data: bytes) -> Verdict:
    """Send a message to a session and run the session for a period."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            before = session.frame()
            try:
                session.apply(read(data, session.limits))
            except InputError as error:
                text = str(error)
                if len(text.splitlines()) != 1 or len(text) > LONGEST_MESSAGE:
                    return Verdict(MESSAGE, text[:500])
                if not np.array_equal(session.frame(), before, equal_nan=True):
                    return Verdict(LOST, f"refused, and yet something changed: {text}"[:500])
                return Verdict(REFUSED, template(text.partition(":")[0], text))
            session.step()
            row = session.frame()[: session.columns.replayed]
            if not np.isfinite(row).all() or session.shown.notice:
                return Verdict(LOST, f"the robot stopped: {session.shown.notice}"[:500])
            return Verdict(ACCEPTED)
    except Exception as error:
        return Verdict(EXCEPTION, f"{type(error).__name__}: {error}"[:500])


def kept(bases: Sequence[bytes], seed: int, index: int) -> tuple[str, bytes]:
    """Name and content of a message, for a folder of findings."""
    return "json", mutant(bases, seed, index)


def work(pipe: Any, bases: Sequence[bytes], seed: int) -> None:
    """Judge messages by their numbers: a process of `campaign.in_a_process`."""
    session = Session(softdyn.load("finger"), {"ic": Impedance}, "ic")
    campaign.serve(pipe, lambda index: judge(session, mutant(bases, seed, index)))
