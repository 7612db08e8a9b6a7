"""The benchmark's page: complete, self-contained, with failed runs and valid links."""

from __future__ import annotations

import importlib
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from softdyn.validation.report import index as report
from softdyn.validation.studies import benchmark
from softdyn.validation.studies.engine.case import Case
from softdyn.view.page import head
from tests.support.browser import Browser, required

OWN = """
import math
from types import SimpleNamespace

class Nan:
    "Fails at its second step & says <so>."
    def __init__(self, model):
        self.nu, self.calls = model.nu, 0
    def __call__(self, state, reference):
        self.calls += 1
        return SimpleNamespace(u=[math.nan if self.calls > 40 else 0.0] * self.nu)
"""


class Links(HTMLParser):
    """All links of a page, and its unclosed tags."""

    VOID = frozenset({"meta", "link", "img", "br", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found += [value for key, value in attributes if key in ("href", "src")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A small grid run by the command, one run of which fails."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "own & only.py").write_text(OWN)
    script = importlib.import_module("softdyn.commands.benchmark")
    names = ["ic", f"{folder}/own & only.py:Nan"]
    arguments = ["--robots", "finger", "--controllers", *names, "--thetas", "0.5", "--omegas"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["/a/b/scripts/benchmark.py", *arguments])
        out = folder / "results"
        assert script.main([*arguments, "--out", str(out), "--jobs", "1", "--no-plots"]) == 0
        (out / "figures").mkdir()
        for name in ("tracking", "convergence_finger"):
            for kind in ("png", "pdf"):
                (out / "figures" / f"{name}.{kind}").touch()
        report.make(benchmark.grid(["finger"], names, [0.5], []), out, 1)
    return out, names


def test_every_link_leads_to_a_file_and_none_elsewhere(results):
    folder, _ = results
    pages = [folder / "index.html", *folder.glob("replays/*/*.html")]
    assert len(pages) == 3
    for page in pages:
        text = page.read_text()
        links = Links(text)
        assert links.open == []
        files = [link.partition("#")[0] for link in links.found if not link.startswith("data:")]
        assert files
        for file in files:
            assert not re.match(r"[a-z]+:|/", file), file
            assert (page.parent / file).is_file(), file
    assert "The tip from rest to each set point, finger" in (folder / "index.html").read_text()


def test_the_page_has_table_versions_command_and_the_failed_run_with_its_reason(results):
    folder, _ = results
    text = (folder / "index.html").read_text()
    assert "2 closed loops" in text
    assert "1 failed" in text
    row = benchmark.benchmark_rows([Case("finger", "ic", "set_point", 0.5)], folder)[0]
    assert f"{row['sp_mean_cm']:.2f} ± 0.00" in text
    assert "0.08 ± 0.14" in text  # the paper's
    assert re.search(
        r"<li><a href=\"[^\"]+#run=0\">Finger, .*θ = 0.5π</a>: the controller failed", text
    )
    for package in ("softdyn", "mujoco", "pin", "numpy"):
        assert re.search(rf"\b{package} \d+\.\d+", text)
    assert "python scripts/benchmark.py --robots finger" in text
    assert "/a/b" not in text
    assert "<code>python -m tests.proof reproduce" in text
    assert "`" not in text
    assert "own &amp; only.py" in text
    assert "own & only.py" not in text


def test_the_page_is_made_again_from_the_logs_alone(results):
    folder, names = results
    cases = benchmark.grid(["finger"], names, [0.5], [])
    before = (folder / "replays/finger/ic.html").read_bytes()
    picture = (folder / "thumbnails/finger/ic.png").read_bytes()
    for path in (folder / "index.html", *folder.glob("replays/*/*"), *folder.glob("thumb*/*/*")):
        path.unlink()
    assert report.make(cases, folder, 1) == folder / "index.html"
    assert (folder / "replays/finger/ic.html").read_bytes() == before
    assert (folder / "thumbnails/finger/ic.png").read_bytes() == picture
    assert not list(folder.rglob("*.part"))


def test_replays_share_the_library_and_are_small(results):
    folder, _ = results
    assert (folder / "replays/meshcat.js").stat().st_size > 5e5
    assert all(path.stat().st_size < 2e5 for path in folder.glob("replays/*/*.html"))
    assert all(3e3 < path.stat().st_size < 8e4 for path in folder.glob("thumbnails/*/*.png"))


def test_own_names_become_safe_paths():
    case = Case("finger", "../../x y/z.py:A<b>", "set_point", 0.0)
    for path in (report.replay_path(case), report.thumbnail_path(case)):
        assert re.fullmatch(r"[\w-]+/finger/[\w-]+\.(html|png)", path.as_posix())


def paper_rows():
    """The paper's table from the committed ensembles; every run of the helix failed."""
    runs = []
    for case in benchmark.grid(("finger", "helix", "spirob"), ("clf-qp", "soft-id-clf-qp", "uic")):
        cell = benchmark.committed()[benchmark.label(case)]
        figures = ("final_error_cm", "mse_cm2", "second_cycle_mse_cm2")
        result = dict.fromkeys(figures, cell.nominal) | {
            "failed": case.robot == "helix", "reason": "", "input_activity": 1234.5,
            "not_solved": 0, "fallbacks": 0, "max_bound_violation": 0.0,
        }  # fmt: skip
        runs.append((case, result))
    return benchmark.rows_of_runs(runs, benchmark.committed())


@required()
def test_the_table_fits_1400_pixels(tmp_path):
    page = tmp_path / "table.html"
    page.write_text(f"{head('table', report.STYLE)}<body>{report._table(paper_rows())}", "utf-8")
    with Browser() as browser:
        browser.open(page.as_uri(), 1400, 900)
        assert "9 of 9" in browser.run("document.body.innerText")
        wide = "document.querySelector('.wide')"
        assert browser.run(f"{wide}.scrollWidth - {wide}.clientWidth") <= 0


@required()
def test_the_page_is_readable_on_a_phone_dark_and_light(results):
    folder, _ = results
    with Browser() as browser:
        browser.open((Path(folder) / "index.html").as_uri(), 360, 700)
        assert browser.run("document.documentElement.scrollWidth") <= 360
        assert browser.run("[...document.images].every(i => i.loading == 'lazy' || i.complete)")
        for scheme, dark in (("light", False), ("dark", True)):
            feature = {"name": "prefers-color-scheme", "value": scheme}
            browser._call("Emulation.setEmulatedMedia", {"features": [feature]})
            assert (browser.pixels()[:60, :, :].mean() < 128) == dark
        assert browser.console == []
        link = browser.run("document.querySelector('.grid a').href")
        browser.open(link)
        assert browser.run("softdyn.tracks[0].frames.length") > 200
        assert browser.console == []
        assert {url.partition(":")[0] for url in browser.requests} <= {"file", "data"}
