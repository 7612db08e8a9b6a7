"""The site that `make docs` builds: formulas and search. mkdocs itself checks links (--strict)."""

from __future__ import annotations

import re
import runpy
import shutil
from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.browser import Browser, required

markdown = pytest.importorskip("markdown")
pytest.importorskip("latex2mathml")
pytest.importorskip("mkdocs")
pytest.importorskip("pymdownx")
PAGES = sorted((ROOT / "docs").glob("*.md"))
CODE = re.compile(r"<(code|pre)[ >].*?</\1>", re.S)


@pytest.fixture(scope="module")
def hooks() -> dict:
    return runpy.run_path(str(ROOT / "docs/site/hooks.py"))


def page(text: str, hooks: dict) -> str:
    """The part of a page that the hooks see, and what they make of it."""
    extensions = ["tables", "pymdownx.superfences", "pymdownx.arithmatex"]
    told = {"pymdownx.arithmatex": {"generic": True}}
    html = markdown.markdown(text, extensions=extensions, extension_configs=told)
    return hooks["on_page_content"](html)


def test_no_page_shows_a_formula_as_text(hooks: dict) -> None:
    pages = {path.name: page(path.read_text("utf-8"), hooks) for path in PAGES}
    assert [name for name, html in pages.items() if "$" in CODE.sub("", html)] == []
    assert pages["derivations.md"].count("<math") > 200


def test_no_emphasis_begins_or_ends_inside_a_word(hooks: dict) -> None:
    """Markdown takes the stars of q* and u* for emphasis, and shows neither."""
    inside = re.compile(r"\w<(?:em|strong)>|</(?:em|strong)>\w")
    pages = {path.name: page(path.read_text("utf-8"), hooks) for path in PAGES}
    pages = {name: CODE.sub("", html) for name, html in pages.items()}
    assert inside.search(page("at (q*, u*) a joint", hooks))
    assert [name for name, html in pages.items() if inside.search(html)] == []


def test_a_displayed_formula_has_its_number_and_its_limits(hooks: dict) -> None:
    html = page("$$\\min_x x^2 \\le \\begin{aligned}a&=1\\\\b&=2\\end{aligned} \\tag{4}$$", hooks)
    assert "<span>(4)</span>" in html
    assert "<munder>" in html
    assert html.count("<mtr>") == 2


def test_unknown_latex_stops_the_build(hooks: dict) -> None:
    with pytest.raises(ValueError, match="expected known LaTeX"):
        page("$\\nosuchcommand x$", hooks)


@required()
def test_a_wrapped_line_keeps_its_options_whole(hooks: dict) -> None:
    text = "softdyn run a.urdf best --target 0.1 -0.2 0 --no-verdict --step 1e-3"
    for html in (
        page(f"```text\n{text}\n```", hooks),
        page(f"as in `{text}`", hooks),
    ):
        for option in ("--target", "--no-verdict", "--step", "-0.2", "1e-3"):
            assert f'<span class="whole">{option}</span>' in html
        assert text in re.sub("<[^>]*>", "", html)  # what is copied
    assert 'class="whole"' not in page("a - b, a --b and -1e-3", hooks)


def test_the_search_works_from_a_file_without_a_network(tmp_path: Path) -> None:
    """Of a small site with our theme, plugins and assets."""
    pytest.importorskip("material")
    import yaml
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    ours = yaml.safe_load((ROOT / "docs/site/mkdocs.yml").read_text())
    small = {name: ours[name] for name in ("site_name", "theme", "extra", "extra_css", "strict")}
    small["plugins"] = [one for one in ours["plugins"] if "mkdocstrings" not in one]
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(small))
    shutil.copytree(ROOT / "docs/site/assets", tmp_path / "docs/site/assets")
    (tmp_path / "docs/index.md").write_text("# First\n\nA tendon pulls.\n")
    (tmp_path / "docs/other.md").write_text("# Second page\n\nHere a capstan rubs.\n")
    build(load_config(str(tmp_path / "mkdocs.yml")))
    with Browser() as browser:
        browser.open((tmp_path / "site/index.html").as_uri(), 1200, 800)
        query = "document.querySelector('[data-md-component=search-query]')"
        browser.run(f"({query}.focus(), {query}.value = 'capstan', 1)")
        browser.run(f"({query}.dispatchEvent(new Event('keyup')), 1)")
        found = "[...document.querySelectorAll('.md-search-result__item a')].map(a => a.innerText)"
        browser.until(f"{found}.length > 0")
        assert "Second page" in browser.run(found)[0]
        assert browser.console == []
        assert {url.partition(":")[0] for url in browser.requests} <= {"file", "data", "about"}
