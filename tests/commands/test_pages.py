"""Every page that a command writes, in a real browser: an empty console, and something drawn."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint
from softdyn.commands.__main__ import NAMES
from softdyn.validation import simulate
from tests.support import ROOT
from tests.support.browser import Browser, required

pytestmark = required()
# each command that writes pages, and its arguments; RUN, DATA, SCENE are files from `inputs`
PAGES = {
    "view": ("finger --html {page}",),
    "run": ("finger ic --theta 0.5 --duration 0.05 --no-verdict --html {page}",),
    "rollout": ("finger --seconds 0.05 --html {page}",),
    "replay": ("RUN --html {page}", "RUN RUN --labels a b --side-by-side --html {page}"),
    "compare": ("finger SCENE --samples 1 --html {page}",),
    "identify": ("finger DATA --free stiffness --html {page}",),
    "benchmark": ("--robots finger --controllers ic --thetas 0.5 --omegas --out {folder}",),
}
LEAST = 300  # pixels


@pytest.fixture(scope="module")
def browser():
    with Browser() as found:
        yield found


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A run of a finger, and the measurements of its joints in that run."""
    folder = tmp_path_factory.mktemp("inputs")
    model = softdyn.load("finger")
    rng = np.random.default_rng(0)
    held = np.repeat(rng.uniform(-0.3, 0.3, (4, model.nu)), 20, axis=0)
    rows = iter(held)
    log = simulate(
        model,
        lambda state, reference: next(rows),
        SetPoint(np.zeros(3)),
        duration=0.4,
        period=0.005,
        name="held",
    )
    log.save(folder / "run.npz")
    names = ["t", *(f"u.{one.name}" for one in model.robot.actuators)]
    names += [f"q.{name}" for name in model.joint_names]
    data = np.column_stack((log.t[:80], log.u, log.q[:80]))
    np.savetxt(folder / "data.csv", data, delimiter=",", header=",".join(names), comments="")
    files = {"RUN": folder / "run.npz", "DATA": folder / "data.csv"}
    return {"SCENE": str(ROOT / "docs/examples/finger_scene.xml")} | {
        word: str(file) for word, file in files.items()
    }


def written(name: str, words: str, inputs: dict[str, str], folder: Path) -> list[Path]:
    """The pages that a command writes into a folder."""
    given = words.format(page=folder / "page.html", folder=folder)
    command = importlib.import_module(f"softdyn.commands.{name}")
    assert command.main([inputs.get(word, word) for word in given.split()]) in (0, 1)
    return sorted(folder.rglob("*.html"))


def ink(browser: Browser) -> int:
    """Pixels of the page that have another colour than its most frequent one."""
    colours = browser.pixels().reshape(-1, 3) @ [1 << 16, 1 << 8, 1]
    return int(len(colours) - np.bincount(colours).max())


def robot(browser: Browser) -> int:
    """Pixels that the viewer's scene changes."""
    shown = browser.pixels("canvas")
    browser.run("softdyn.stage.visible = false")
    return int((np.abs(shown - browser.pixels("canvas")).sum(axis=2) > 40).sum())


def test_every_command_that_writes_a_page_is_here() -> None:
    parsers = {name: importlib.import_module(f"softdyn.commands.{name}").parser for name in NAMES}
    with_page = {name for name, parser in parsers.items() if "html" in parser.outputs}
    # tests/validation/bench has the page of a driven run
    assert with_page - {"drive"} == set(PAGES) - {"benchmark"}


@pytest.mark.parametrize(
    ("name", "words"), [(name, words) for name, several in PAGES.items() for words in several]
)
def test_a_page_is_drawn_and_its_console_is_empty(
    name: str, words: str, inputs: dict[str, str], browser: Browser, tmp_path: Path
) -> None:
    pages = written(name, words, inputs, tmp_path)
    assert pages
    for page in pages:
        browser.open(page.as_uri())
        browser.run("document.images.length && [...document.images].map(i => i.loading = 'eager')")
        browser.until("[...document.images].every(i => i.complete)")
        assert browser.run("[...document.images].every(i => i.naturalWidth > 0)")
        assert ink(browser) > LEAST
        if browser.run("Boolean(document.getElementById('pane'))"):
            assert robot(browser) > LEAST
        else:
            assert browser.run("document.querySelectorAll('svg, img').length") > 0
        assert browser.console == []
