"""The gallery: nine replays with their commands, what the mouse does, and stills in the run."""

from __future__ import annotations

import base64
import json
import re

import numpy as np
from PIL import Image

from tests.proof import gallery
from tests.support import ROOT
from tests.support.refused import refused


def scene(page: str) -> dict:
    return json.loads(re.search(r'id="scene">(.*?)</script>', page, re.S)[1])


def rows(packed: str, columns: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed), "<f4").reshape(-1, columns)


def test_each_still_has_a_replay_and_commands_or_a_hand():
    found = list(gallery.entries())
    assert [entry.name for entry in found] == list(gallery.SHOTS)
    for entry in found:
        assert entry.name in gallery.PLAYED or any(
            f"--html {entry.name}.html" in line for line in entry.commands
        )
        picture = ROOT / "docs/gallery" / f"{entry.name}.png"
        assert picture.stat().st_size < 100e3
        assert Image.open(picture).size == gallery.SHOWN


def test_the_readme_has_the_same_stills_and_last_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for entry in gallery.entries(gallery.INDEX):
        assert f"(docs/gallery/{entry.name}.png)" in text
        play = {"dragged": "softdyn play finger", "push": "softdyn play spirob"}
        assert (play.get(entry.name) or entry.commands[-1]).split(" ||")[0] in text


def test_a_command_that_fails_or_writes_no_page_is_an_error():
    for line in ("exit 3", "true"):
        with refused("lost"):
            gallery.replay(gallery.Entry("lost", (), (line,)))


def test_the_tip_follows_the_dragged_target():
    (track,) = scene(gallery.dragged(seconds=1.0))["runs"][0]["tracks"]
    last = rows(track["frames"], 1 + 4 + 2 + 6)[-1]
    assert track["pulls"] is None
    assert np.linalg.norm(last[-6:-3] - last[-3:]) < 0.03


def test_the_recording_shows_the_pull_while_it_lasts():
    (track,) = scene(gallery.pushed("finger", 2.5))["runs"][0]["tracks"]
    pulls, t = rows(track["pulls"], 6), rows(track["frames"], 13)[:, 0]
    held = np.isfinite(pulls).all(axis=1)
    assert not held[t < 0.4].any()
    assert held[(t > 0.7) & (t < 1.9)].all()
    assert not held[t > 2.2].any()
    assert (np.linalg.norm(pulls[held & (t > 0.7), :3], axis=1) > 1e-3).all()
