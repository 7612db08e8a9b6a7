"""The queue of messages for a page: in order, and short even if the page does not read."""

from __future__ import annotations

import json

from softdyn.view.live.boxes import ERRORS, Outbox


def all_of(box):
    found = []
    while box:
        found.append(box.take())
    return found


def test_of_states_the_last_one_waits_and_no_error_pushes_it_out():
    box = Outbox()
    box.put({"state": {"law": "a"}, "leads": True})
    for i in range(100):
        box.put({"error": str(i)})
    box.put({"state": {"law": "b"}, "leads": False})
    texts = [json.loads(text) for text in all_of(box)]
    assert [text["error"] for text in texts[:-1]] == [str(i) for i in range(100 - ERRORS, 100)]
    assert texts[-1] == {"state": {"law": "b"}, "leads": False}


def test_points_wait_together_and_of_frames_the_last_one():
    box = Outbox()
    assert not box.show(b"one")
    box.put({"reach": [[0, 0, 1]]})
    box.put({"reach": [[0, 1, 0]]})
    assert box.show(b"two")
    assert all_of(box) == ['{"reach": [[0, 0, 1], [0, 1, 0]]}', b"two"]
    assert not box
