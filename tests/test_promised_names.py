"""The names that docs/api.md promises: what they are, and that documents use no others."""

import importlib
import json

import pytest

from softdyn import InputError
from tests.support import ROOT
from tests.support.promised_names import ROOMS, SNAPSHOT, promised, snapshot, used_names
from tests.test_docs import BLOCK, PAGES

PROGRAMS = sorted((ROOT / "docs/examples").glob("*.py"))


def notebook(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


def test_the_promised_names_and_signatures_are_those_of_the_snapshot():
    """A change on purpose: `python -m tests.support.promised_names`; CONTRIBUTING says when."""
    assert snapshot().splitlines() == SNAPSHOT.read_text("utf-8").splitlines()


def test_members_of_stable_classes_may_be_provisional():
    marked = {line for line in SNAPSHOT.read_text("utf-8").splitlines() if line[:1] == "°"}
    for member in ("Log.experiment", "Log.record", "RunOptions.table"):
        assert f"° softdyn.validation.{member}" in marked
    assert "softdyn.validation.Log" in {name for name, stable in promised().items() if stable}


def test_a_renamed_or_changed_name_would_be_noticed(monkeypatch):
    import softdyn.statics

    monkeypatch.setattr(softdyn.statics, "settle", lambda model: None)
    assert snapshot() != SNAPSHOT.read_text("utf-8")
    monkeypatch.delattr(softdyn.statics, "settle")
    with pytest.raises(AttributeError):
        snapshot()


@pytest.mark.parametrize("page", [*PAGES, *PROGRAMS, ROOT / "docs/examples/tour.ipynb"],
                         ids=lambda page: page.name)  # fmt: skip
def test_documents_and_examples_use_promised_names_only(page):
    if page.suffix == ".md":
        blocks = BLOCK.finditer(page.read_text("utf-8"))
        programs = [found["code"] for found in blocks if found["kind"] == "python"]
    else:
        programs = [notebook(page) if page.suffix == ".ipynb" else page.read_text("utf-8")]
    used = set().union(*(used_names(code) for code in programs))
    assert used - set(promised()) - ROOMS == set()


@pytest.mark.parametrize(("code", "names"), [
    ("import softdyn\nsoftdyn.load('a').state", {"softdyn", "softdyn.load"}),
    ("from softdyn import statics as s\ns.rest(1).u", {"softdyn.statics", "softdyn.statics.rest"}),
    ("from softdyn.statics.branch import x", {"softdyn.statics.branch"}),
    ("import softdyn.view.page\nsoftdyn.view.page.f()", {"softdyn", "softdyn.view"}),
    ("import numpy\nnumpy.load('a')", set()),
])  # fmt: skip
def test_names_that_a_program_uses(code, names):
    assert used_names(code) == names


@pytest.mark.parametrize(("room", "old", "new"), [
    ("softdyn.tasks", "recorded_paths", "read_paths"),
    ("softdyn.validation", "certified", "certify"),
])  # fmt: skip
def test_a_former_name_still_works_and_says_the_new_one(room, old, new):
    with pytest.warns(DeprecationWarning, match=new), pytest.raises((InputError, TypeError)):
        getattr(importlib.import_module(room), old)("none.csv")
