"""The site that `make docs` builds: formulas. mkdocs itself checks its links (--strict)."""

from __future__ import annotations

import re
import runpy

import pytest

from tests.support import ROOT

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


def test_a_displayed_formula_has_its_number_and_its_limits(hooks: dict) -> None:
    html = page("$$\\min_x x^2 \\le \\begin{aligned}a&=1\\\\b&=2\\end{aligned} \\tag{4}$$", hooks)
    assert "<span>(4)</span>" in html
    assert "<munder>" in html
    assert html.count("<mtr>") == 2


def test_unknown_latex_stops_the_build(hooks: dict) -> None:
    with pytest.raises(ValueError, match="expected known LaTeX"):
        page("$\\nosuchcommand x$", hooks)
