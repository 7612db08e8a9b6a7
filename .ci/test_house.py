""".ci/house.py detects violations; the plan of mutants and the recipes name what exists."""

import re
import tomllib

import grimp
import house
import pytest
from house import ROOT, Module

DOC = '"""It is said."""\n'


def graph(*imports: tuple[str, str]) -> grimp.ImportGraph:
    made = grimp.ImportGraph()
    for name in {name for pair in imports for name in pair}:
        made.add_module(name)
    for importer, imported in imports:
        made.add_import(importer=importer, imported=imported)
    return made


@pytest.mark.parametrize(
    ("check", "modules", "said"),
    [
        (house.silent_modules, [Module("softdyn/a.py", "x = 1\n")], "a docstring"),
        (house.silent_modules, [Module("softdyn/queue.py", DOC)], "Python's own"),
        (
            house.unnamed_modules,
            [Module("softdyn/b/__init__.py", DOC), Module("softdyn/b/tree.py", DOC)],
            "`tree`",
        ),
        (house.unnamed_modules, [Module("softdyn/b/tree.py", DOC)], "__init__.py"),
        (
            house.repeated_classes,
            [Module("softdyn/a.py", "class Task: ..."), Module("scripts/b.py", "class Task: ...")],
            "class Task",
        ),
        (
            house.imports_by_string,
            [Module("softdyn/a.py", "import importlib\nimportlib.import_module(f'softdyn.{x}')")],
            "softdyn/a.py:2",
        ),
        (house.too_many_commands, [Module(f"scripts/c{i}.py", DOC) for i in range(21)], "got 21"),
    ],
)
def test_what_breaks_the_plan_is_said(check, modules, said):
    (problem,) = check(modules)
    assert said in problem


@pytest.mark.parametrize(
    ("check", "modules"),
    [
        (house.unnamed_modules, [Module("scripts/tree.py", DOC)]),
        (house.repeated_classes, [Module("softdyn/a.py", "class _T: ...")] * 2),
        (
            house.repeated_classes,
            [Module("softdyn/a.py", "class T: ..."), Module("tests/proof/a.py", "class T: ...")],
        ),
        (house.imports_by_string, [Module("scripts/__main__.py", "import_module(f'softdyn.{x}')")]),
        (house.imports_by_string, [Module("softdyn/a.py", "import_module('mujoco.sysid')")]),
    ],
)
def test_what_keeps_the_plan_is_not(check, modules):
    assert list(check(modules)) == []


def test_circles():
    there_and_back = graph(("s.a", "s.b"), ("s.b", "s.c"), ("s.c", "s.a"), ("s.a", "s.d"))
    (problem,) = house.circles(there_and_back)
    assert problem.endswith("got s.a, s.b, s.c")


def test_proof_in_the_wheel():
    modules = [
        Module("softdyn/__init__.py", DOC),
        Module("softdyn/used.py", DOC),
        Module("softdyn/public.py", DOC),
        Module("softdyn/unused.py", DOC),
        Module("softdyn/program.py", 'if __name__ == "__main__": ...'),
        Module("scripts/run.py", "from softdyn import used\nfrom tests.proof import fuzz"),
    ]
    arrows = graph(("softdyn.commands.run", "softdyn.used"), ("softdyn.unused", "softdyn.used"))
    for module in modules:
        arrows.add_module(module.name) if module.name not in arrows.modules else None
    found = list(house.proof_in_the_wheel(modules, arrows, {"softdyn": "from .public import X"}))
    assert [line.split(":")[0] for line in found] == ["scripts/run.py", "softdyn/unused.py"]


def test_the_plan_of_mutants_names_tests_for_each_source_and_nothing_that_has_gone():
    plan = tomllib.loads((ROOT / ".ci/mutants.toml").read_text())
    sources = [
        str(file.relative_to(ROOT))
        for folder in plan["sources"]
        for file in (ROOT / folder).glob("**/*.py")
        if file.name not in plan["skipped"]
    ]
    assert [s for s in sources if not any(s.startswith(name) for name in plan["tests"])] == []
    assert [n for n in plan["tests"] if not any(s.startswith(n) for s in sources)] == []
    named = {t for line in plan["tests"].values() for t in line.partition(" -k ")[0].split()}
    assert [test for test in sorted(named) if not (ROOT / test).exists()] == []


def test_the_recipes_name_files_that_exist():
    text = (ROOT / "docs/CONTRIBUTING.md").read_text("utf-8")
    named = set(re.findall(r"`((?:softdyn|controllers|validation|scripts)/[\w/]+(?:\.py)?)`", text))
    assert len(named) > 15
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_the_recipes_name_contracts_that_are_where_they_say():
    text = (ROOT / "docs/CONTRIBUTING.md").read_text("utf-8")
    placed = re.findall(r"`([A-Z]\w+)` in `([\w/]+\.py)`", text)
    assert len(placed) > 8
    lost = [place for name, place in placed if f"class {name}" not in (ROOT / place).read_text()]
    assert lost == []


def test_examples_of_tests_are_parts_of_tests():
    text = (ROOT / "docs/CONTRIBUTING.md").read_text("utf-8")
    shown = re.findall(r"`(tests/\S+\.py)`:\n\n<!--[^\n]*-->\n```python\n(.*?)```", text, re.S)
    assert len(shown) == 3
    assert [name for name, code in shown if code not in (ROOT / name).read_text("utf-8")] == []
