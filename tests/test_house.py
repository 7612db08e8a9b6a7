"""The plan of the house: short files, small folders, one name for everything that is imported.

That imports point one way is checked by `make lint`, from the contracts in pyproject.toml.
"""

import ast
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.support import ROOT

TRACKED = [
    ROOT / name
    for name in subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    if not name.startswith(("tests/", "docs/", "urdf/"))
]
LIBRARY = [path for path in TRACKED if path.parent.name not in ("scripts", ".ci")]


def test_no_file_is_long():
    long = {str(path): n for path in TRACKED if (n := len(path.read_text().splitlines())) > 400}
    assert long == {}


def test_no_folder_is_large():
    modules = Counter(path.parent for path in LIBRARY if path.name != "__init__.py")
    assert {str(folder): n for folder, n in modules.items() if n > 14} == {}


@pytest.mark.parametrize("path", LIBRARY, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_says_what_it_is_and_shadows_no_other(path: Path):
    assert ast.get_docstring(ast.parse(path.read_text()))
    assert path.stem == "__init__" or path.stem not in sys.stdlib_module_names


def test_a_package_s_docstring_names_its_files():
    for folder in {path.parent for path in LIBRARY} - {ROOT / "softdyn"}:
        text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
        own = {path.stem for path in LIBRARY if path.parent == folder} - {"__init__"}
        assert {name for name in own if not re.search(rf"\b{name}\b", text)} == set(), folder
