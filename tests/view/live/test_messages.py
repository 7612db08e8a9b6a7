"""Messages of a page: an invalid one is an InputError and no other exception."""

from __future__ import annotations

import json
import math
import random

import numpy as np
import pytest

import softdyn
from softdyn import InputError
from softdyn.description.stated_task import TaskKind
from softdyn.description.task_mark import TaskMark
from softdyn.view.live import messages
from softdyn.view.live.messages import MESSAGES, OPEN_LOOP, Limits, read


@pytest.fixture(scope="module")
def limits():
    marks = (
        TaskMark("hand", "tip", TaskKind.POSE), TaskMark("way", "tip", TaskKind.AXIS, (1, 0, 0))
    )  # fmt: skip
    return Limits.of(softdyn.load("finger"), ("best", OPEN_LOOP), 0.25, marks)


GOOD = {
    "target": {"y": [0.1, 0.0, -0.1]},
    "targets": {"values": [0.1, 0.0, -0.1, 0.0, 3.1, 0.0, 0.0, 0.6, 0.8]},
    "inputs": {"u": [0.5, -1]},
    "joints": {"x": [0.1, 0, 0, 0]},
    "law": {"name": "best"},
    "mismatch": {"mass": 1.2, "contacts": True, "delay": 0.005},
    "push": {"link": "link1", "at": [0, 0, 0], "to": [0.1, 0, 0]},
    "release": {},
    "pause": {"on": True},
    "step": {},
    "reset": {},
    "speed": {"factor": 0.5},
    "ghost": {"on": False},
    "record": {"on": True},
    "reach": {},
    "lead": {},
}


def said(name: str, /, **members: object) -> str:
    return json.dumps({"do": name, **members})


@pytest.mark.parametrize("name", MESSAGES)
def test_every_message_is_read_as_it_was_said(name, limits):
    message = read(said(name, **GOOD[name]).encode(), limits)
    assert type(message) is MESSAGES[name]
    for key, value in GOOD[name].items():
        np.testing.assert_array_equal(getattr(message, key), value)


BAD = [
    ("", "JSON"),
    ("[]", "an object"),
    ("7", "an object"),
    ("{", "JSON"),
    ('{"do": "quit"}', "do: expected one of target"),
    ('{"do": ["target"]}', "do: expected"),
    ('{"y": [0, 0, 0]}', "do: expected"),
    (said("target"), "a member y"),
    (said("target", y=[0, 0]), "target.y: expected finite numbers of shape (3,)"),
    (said("target", y="000"), "target.y"),
    (said("target", y=[0, 0, True]), "target.y"),
    (said("target", y=[[0, 0], 0, 0]), "target.y"),
    ('{"do": "target", "y": [NaN, 0, 0]}', "target.y"),
    ('{"do": "target", "y": [1e999, 0, 0]}', "target.y"),
    (said("target", y=[10**400, 0, 0]), "target.y"),
    (said("target", y=[0, 0, 9]), "target.y: expected numbers from [-0.75"),
    (said("target", y=[0, 0, 0], z=1), "target: expected only y, got z"),
    (said("inputs", u=[0, 1.5]), "inputs.u"),
    (said("law", name="rm -rf"), "law.name: expected one of best, open loop"),
    (said("law", name=7), "law.name"),
    (said("mismatch", mass=0), "mismatch.mass: expected a number from 0.2 to 5"),
    (said("targets", values=[0] * 8), "targets.values: expected finite numbers of shape (9,)"),
    (said("targets", values=[0] * 9), "target of 'way': expected a unit vector"),
    (said("targets", values=[9, *[0] * 7, 1]), "target of 'hand': expected a point within 0.75 m"),
    (said("targets", values=[0, 0, 0, 3, 1, 1, 0, 0, 1]), "'hand': expected a turn of at most pi"),
    (said("targets", values=[0, 0, 0, 1e308, 1e308, 0, 0, 0, 1]), "a turn of at most pi"),
    (said("targets", values=[0, 0, 0, 0, 0, 0, 1e-200, 0, 0]), "a unit vector"),
    (said("targets", values=[math.nan] * 9), "targets.values"),
    (said("targets", values="000000001"), "targets.values"),
    (said("mismatch", contacts=1), "mismatch.contacts: expected true or false"),
    (said("mismatch", delay="0"), "mismatch.delay"),
    (said("push", link="no", at=[0, 0, 0], to=[0, 0, 0]), "push.link"),
    (said("pause", on=None), "pause.on"),
    (said("speed", factor=-1), "speed.factor"),
    (said("release", now=1), "release: expected only no members"),
    ("[" * 19_000, "message"),
    (" " * 30_000, "at most 20000 bytes"),
    (b"\xff\xfe{}", "JSON"),
]


@pytest.mark.parametrize(("text", "why"), BAD)
def test_what_is_no_message_says_which_member_and_why(text, why, limits):
    with pytest.raises(InputError) as caught:
        read(text, limits)
    assert why in str(caught.value).replace("a JSON object", "an object")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1500


def test_messages_are_frozen():
    with pytest.raises(AttributeError):
        messages.SetSpeed(1.0).factor = 2.0  # type: ignore[misc]


def test_damaged_messages_are_messages_or_errors(limits):
    """With flipped, cut and doubled bytes nothing else is raised, and values are in bounds."""
    rng = random.Random(0)
    bases = [said(name, **members).encode() for name, members in GOOD.items()]
    read_well = 0
    for _ in range(3000):
        data = bytearray(rng.choice(bases))
        for _ in range(rng.choice((1, 1, 2, 3))):
            at = rng.randrange(len(data))
            data[at : at + rng.randrange(3)] = rng.choice(
                (b"", b"9", b"-", b"e9", b'"', b"[", b"null", bytes([rng.randrange(256)]))
            )
            if not data:
                break
        try:
            message = read(bytes(data), limits)
        except InputError:
            continue
        read_well += 1
        if isinstance(message, messages.SetTarget):
            assert np.isfinite(message.y).all()
            assert np.abs(message.y).max() <= limits.reach
        if isinstance(message, messages.SetTargets):
            assert np.abs(message.values[:3]).max() <= limits.reach
            assert math.hypot(*message.values[3:6]) < math.pi + 1e-5
            assert math.hypot(*message.values[6:]) == pytest.approx(1, abs=1e-5)
        if isinstance(message, messages.SetInputs):
            assert (message.u <= limits.upper).all()
            assert (message.u >= limits.lower).all()
    assert read_well > 50
