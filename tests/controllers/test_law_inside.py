"""A new control law inside the package: its own file, and a line in the registry."""

import ast
import filecmp
import json
import os
import shutil
import subprocess
import sys

import pytest

from softdyn.controllers import CONTROLLERS
from tests.support import ROOT

LAW = '''
"""A toy: the input that balances gravity and springs, as far as inputs can."""

from types import MappingProxyType

import numpy as np

from softdyn.controllers.gains import Gains
from softdyn.controllers.law import TaskLaw


class Balance:
    solvers = ()

    def command(self, state, tip, guard):
        u = np.linalg.lstsq(state.B, state.g + state.K, rcond=None)[0]
        return guard.accept(u, tip.V, np.nan, clamped=True)

    def reset(self):
        pass


class Toy(TaskLaw):
    name = "toy"
    label = "Toy law"
    order = 8
    published = MappingProxyType({"finger": Gains(77.0)})

    def _make_rule(self, model, gains, error):
        return Balance()
'''
LISTS = """
import json, sys
import softdyn
from softdyn.commands import __main__ as commands
from softdyn.controllers import registry
from softdyn.validation.live.menu import menu_of
from softdyn.validation.loop import labels
from softdyn.validation.loop.pictures import plot_style
from softdyn.validation.studies import benchmark
from softdyn.validation.studies.benchmark_table import benchmark_cells
from softdyn.validation.studies.sweep_file import read_sweep

finger = softdyn.load("finger")
found = {
    "benchmark": registry.in_table(),
    "label": labels.controller_title("toy"),
    "looks": [*plot_style.CONTROLLERS],
    "menu": [*menu_of(finger)],
    "gains": registry.make_controller("toy", finger).gains.Kp,
    "options": registry.make_controller("toy", finger, {"Kp": 3.0}).gains.Kp,
    "sweep": [case.controller for case in read_sweep("sweep.toml").cases],
}
try:
    registry.find_controller("toi")
except softdyn.InputError as error:
    found["message"] = str(error)
json.dump(found, open("found.json", "w"))
sys.exit(commands.main(["run", "finger", "toy", "--theta", "0.5", "--duration", "0.02",
                        "--json", "run.json"]))
"""
SWEEP = """
robots = ["finger"]
controllers = ["toy"]
[targets]
theta = [0.5]
[gains.toy]
Kp = [10.0, 20.0]
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The package in another folder, as files; caches stay behind."""
    folder = tmp_path_factory.mktemp("package")
    for name in ("softdyn", "controllers", "validation", "scripts"):
        ignore = shutil.ignore_patterns("__pycache__", "*.png", "*.json")
        shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=ignore)
    (folder / "urdf").symlink_to(ROOT / "urdf")
    (folder / "docs").symlink_to(ROOT / "docs")
    (folder / "controllers/toy.py").write_text(LAW.lstrip())
    registry = folder / "controllers/registry.py"
    text = registry.read_text("utf-8")
    text = text.replace("    ImpedanceQp,\n", "    ImpedanceQp,\n    Toy,\n")
    text = text.replace(
        "from softdyn.exceptions import own_frames\n",
        "from softdyn.controllers.toy import Toy\nfrom softdyn.exceptions import own_frames\n",
    )
    registry.write_text(text)
    return folder


def changed(here, there):
    """Python files that are new or not the same, but for the copied suffixes."""
    files = sorted(path.relative_to(there) for path in there.glob("[!.]*/**/*.py"))
    return [
        str(name) for name in files
        if not (here / name).exists() or not filecmp.cmp(here / name, there / name, shallow=False)
    ]  # fmt: skip


def test_a_law_inside_touches_its_own_file_and_the_registry(copy, tmp_path):
    assert changed(ROOT, copy) == ["controllers/registry.py", "controllers/toy.py"]
    (tmp_path / "sweep.toml").write_text(SWEEP)
    environment = os.environ | {"PYTHONPATH": str(copy), "SOFTDYN_COMPILE": "0"}
    ran = subprocess.run(
        [sys.executable, "-c", LISTS], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert ran.returncode == 1, ran.stderr  # it does not aim at the target
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["benchmark"][-1] == "toy"
    assert found["label"] == "Toy law"
    assert "toy" in found["looks"]
    assert "toy" in found["menu"]
    assert (found["gains"], found["options"]) == (77.0, 3.0)
    assert found["sweep"] == ["toy", "toy"]
    assert "toy" in found["message"]
    run = json.loads((tmp_path / "run.json").read_text())
    assert (run["controller"], run["steps"], run["fallbacks"]) == ("toy", 4, 0)


def collections(tree):
    """The texts of each tuple, list, set and mapping of a module, and the words of each text."""
    for node in ast.walk(tree):
        parts = node.keys if isinstance(node, ast.Dict) else getattr(node, "elts", ())
        yield {part.value for part in parts if isinstance(part, ast.Constant)}
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield set(node.value.replace(",", " ").split())


def test_no_module_of_the_package_lists_the_laws():
    """The words of a text are a list where all laws of the paper are among them."""
    found = [
        str(path.relative_to(ROOT))
        for top in ("softdyn", "controllers", "validation", "scripts")
        for path in (ROOT / top).rglob("*.py")
        if any(set(CONTROLLERS) <= names for names in collections(ast.parse(path.read_bytes())))
    ]
    assert found == []


def test_the_list_of_laws_would_be_noticed():
    for text in (f"LAWS = {tuple(CONTROLLERS)}", f"'give {', '.join(CONTROLLERS)} or a file'"):
        assert any(set(CONTROLLERS) <= names for names in collections(ast.parse(text)))
