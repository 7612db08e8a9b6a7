"""docs/bench.md from its file to a driven arm, and docs/zeros.md, on a clock of its own."""

from __future__ import annotations

import math
import re
import shlex
from functools import partial
from pathlib import Path

import pytest

import softdyn
from softdyn.commands import drive as serving
from softdyn.validation import Log
from softdyn.validation.bench import drive as driving
from softdyn.validation.bench import zeroing
from tests.support.bench import NearDriver, tower
from tests.support.command import command

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs/bench.md").read_text(encoding="utf-8")
ZEROS = (ROOT / "docs/zeros.md").read_text(encoding="utf-8")
NEAR = "from tests.support.bench import NearDriver as ServedRig\n"


def shown(words: str, page: str = PAGE) -> list[str]:
    """The only command of the page that begins with these words."""
    (line,) = re.findall(rf"(?m)^softdyn ({re.escape(words)}.*)$", page)
    return shlex.split(line)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (text,) = re.findall(r"Save as `bench.toml`\n\n```toml\n(.*?)```", PAGE, re.S)
    Path("bench.toml").write_text(text)
    assert command(*shown("new bench.toml"))[0] == 0
    Path("examples").mkdir()
    Path("examples/served_rig.py").write_text(NEAR)
    rig = tower(softdyn.load("bench.urdf"))
    made = partial(driving.Drive, watchdog=False, source=rig.hands.source)
    monkeypatch.setattr(driving, "Drive", made)
    return rig


def test_a_cable_that_is_pulled_becomes_shorter(bench):
    code, out, err = command(*shown("drive bench.urdf --driver"))
    assert code == 0, err
    assert "stopped by     planned end" in out
    rows = {line.split()[0]: line.split()[1:3] for line in out.splitlines() if "encoder" in line}
    pulled, *others = (float(rows[f"encoder_lower_{k}"][0]) for k in (1, 2, 3))
    assert pulled < min(others)
    assert all(abs(float(read) - float(there)) < 3e-3 for read, there in rows.values())


PATH = (
    "new bench.toml", "run bench.urdf best", "drive bench.urdf --serve",
    "drive bench.urdf --driver",
    "drive bench.urdf best", "replay driven.npz",
)  # fmt: skip


def test_from_the_file_to_a_driven_rig_in_six_commands(bench, monkeypatch):
    """The fixture did the first one and is the rig; the fourth has a test of its own."""
    _, simulated, served, _, driven, replayed = map(shown, PATH)
    assert serving.parser.parse_args(served[1:]).serve
    assert command(*simulated)[0] == 0
    tips = []
    monkeypatch.setattr(NearDriver, "send", noting(tips, NearDriver.send))
    code, out, err = command(*driven)
    assert code == 0, out + err
    log = Log.load("driven.npz")
    assert log.complete
    assert "reached: |e| fell from" in out
    assert "0 deadlines missed" in out
    assert 0.8e6 < Path("driven.html").stat().st_size < 1.5e6
    assert NearDriver.tower.stops == 1
    assert bench.rig.state()["relaxed_at"] is not None
    assert math.dist(tips[log.steps], Log.load("bench.npz").y[-1]) < 2e-3
    assert command(*replayed)[0] == 0
    page = Path("both.html").read_text(encoding="utf-8")
    assert '"simulated"' in page
    assert '"NearDriver"' in page


def noting(tips, send):
    """A driver's `send` that notes the true tip first."""

    def sends(driver, commands):
        tips.append(driver.tower.rig.state()["tip"])
        send(driver, commands)

    return sends


def test_the_sensors_of_the_page_are_enough_to_find_the_zeros(bench):
    """Also that the tension of a pull is above the noise; the search itself takes minutes."""
    (text,) = re.findall(r"one sensor more:\n\n```toml\n(.*?)```", ZEROS, re.S)
    with Path("bench.toml").open("a") as file:
        file.write(text)
    assert command(*shown("new bench.toml"))[0] == 0
    model = softdyn.load("bench.urdf")
    assert len(zeroing.Zeroing(model)._cables) == 6
    words = shown("drive bench.urdf --zero", ZEROS)
    assert words[-2:] == ["--out", "zeroed.urdf"]
