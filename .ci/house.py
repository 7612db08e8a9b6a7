"""Rules for the structure of the repository. `make lint` checks them.

import-linter checks that imports point one way; its contracts are in pyproject.toml.

python .ci/house.py print the violations; the exit code is 1 if there are any
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import grimp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parents[1]
WHEEL = {"softdyn": "softdyn", "controllers": "softdyn.controllers",
         "validation": "softdyn.validation", "scripts": "softdyn.commands"}  # fmt: skip
PROOF = "tests/proof"
HELPERS = (
    "__init__",
    "__main__",
    "cli",
    "study_options",
    "working",
)  # modules of scripts/ that are no commands
MOST_COMMANDS = 20
# It finds a command by its name, so it alone may import by a string.
COMMAND_TABLE = "scripts/__main__.py"


@dataclass(frozen=True)
class Module:
    """A Python file.

    Attributes
    ----------
    path : str
        Path from the root, with slashes.
    text : str
        Content of the file.
    """

    path: str
    text: str

    @property
    def room(self) -> str:
        """The folder of the module."""
        return self.path.rpartition("/")[0]

    @property
    def stem(self) -> str:
        """The file's name without folder and suffix."""
        return Path(self.path).stem

    @property
    def in_wheel(self) -> bool:
        """Whether the wheel contains the module."""
        return self.path.split("/")[0] in WHEEL

    @property
    def name(self) -> str:
        """The name under which it is imported, for a module in the wheel."""
        top, *rest = Path(self.path).with_suffix("").parts
        return ".".join([WHEEL[top], *(part for part in rest if part != "__init__")])

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree."""
        return ast.parse(self.text)


def modules(root: Path = ROOT) -> list[Module]:
    """All tracked modules except tests, examples and the generator of the bundled robots."""
    listed = subprocess.check_output(["git", "ls-files", "*.py"], cwd=root, text=True).splitlines()
    kept = (name for name in listed if name.startswith((*WHEEL, ".ci/", f"{PROOF}/")))
    return [
        Module(name, (root / name).read_text(encoding="utf-8"))
        for name in kept
        if not Path(name).name.startswith("test_") and (root / name).is_file()
    ]


def silent_modules(house: Iterable[Module]) -> Iterator[str]:
    """Modules without a docstring, and modules whose name hides one of Python's."""
    for module in house:
        if not ast.get_docstring(module.tree):
            yield f"{module.path}: expected a docstring"
        if module.stem in sys.stdlib_module_names and module.room not in ("scripts", PROOF, ".ci"):
            yield f"{module.path}: expected a name that is not one of Python's own modules"


def unnamed_modules(house: Iterable[Module]) -> Iterator[str]:
    """Modules that the docstring of their package does not name."""
    rooms = defaultdict(dict)
    for module in house:
        rooms[module.room][module.stem] = module
    for room, held in rooms.items():
        if room in ("softdyn", "scripts", ".ci"):
            continue
        if "__init__" not in held:
            yield f"{room}/: expected an __init__.py whose docstring names the modules"
            continue
        text = ast.get_docstring(held["__init__"].tree) or ""
        for stem in held.keys() - {"__init__", "__main__"}:
            if not re.search(rf"\b{stem}\b", text):
                yield f"{room}/__init__.py: expected a docstring that names `{stem}`"


def repeated_classes(house: Iterable[Module]) -> Iterator[str]:
    """Public classes of the wheel that share a name."""
    places = defaultdict(list)
    for module in house:
        for node in module.tree.body if module.in_wheel else ():
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(module.path)
    for name, paths in places.items():
        if len(paths) > 1:
            yield f"class {name}: expected one place, got {', '.join(paths)}"


def imports_by_string(house: Iterable[Module]) -> Iterator[str]:
    """Calls that import one of our modules by a string, because linters do not see them."""
    for module in house:
        if not module.in_wheel or module.path == COMMAND_TABLE:
            continue
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
                ("import_module", "__import__")
            ):
                asked = ast.unparse(node.args[0]) if node.args else ""
                if "softdyn" in asked:
                    yield f"{module.path}:{node.lineno}: expected an import statement, got {asked}"


def too_many_commands(house: Iterable[Module]) -> Iterator[str]:
    """Too many commands."""
    names = [m.stem for m in house if m.room == "scripts" and m.stem not in HELPERS]
    if len(names) > MOST_COMMANDS:
        yield f"scripts/: expected at most {MOST_COMMANDS} commands, got {len(names)}"


def circles(graph: grimp.ImportGraph) -> Iterator[str]:
    """Modules that import each other in a circle; imports inside functions count."""
    names = sorted(graph.modules)
    number = {name: i for i, name in enumerate(names)}
    arrows = [
        (number[name], number[other])
        for name in names
        for other in graph.find_modules_directly_imported_by(name)
    ]
    rows, columns = zip(*arrows, strict=True) if arrows else ((), ())
    matrix = csr_array(([1] * len(arrows), (rows, columns)), shape=(len(names),) * 2)
    _, labels = connected_components(matrix, connection="strong")
    groups = defaultdict(list)
    for name, label in zip(names, labels, strict=True):
        groups[label].append(name)
    for group in groups.values():
        if len(group) > 1:
            yield f"circle: expected no modules that import each other, got {', '.join(group)}"


def proof_in_the_wheel(
    house: Iterable[Module], graph: grimp.ImportGraph, public: Mapping[str, str]
) -> Iterator[str]:
    """Modules that neither a command nor a public name reaches, and imports of the proof.

    Parameters
    ----------
    house : iterable of Module
    graph : ImportGraph
        Imports of the wheel's modules.
    public : mapping
        Package → text of the stub that lists its public names.
    """
    own = [m for m in house if m.in_wheel]
    for module in own:
        for node in ast.walk(module.tree):
            found = node.module if isinstance(node, ast.ImportFrom) else ""
            plain = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if any(name.split(".")[0] == "tests" for name in [found or "", *plain]):
                yield f"{module.path}:{node.lineno}: expected no import of the proof"
    known = {m.name for m in own}
    faces = {m.name for m in own if m.stem == "__init__"}
    programs = {m.name for m in own if 'if __name__ == "__main__"' in m.text}
    reached = {m.name for m in own if m.room == "scripts"} | faces | programs
    for package, stub in public.items():
        for node in ast.walk(ast.parse(stub)):
            if isinstance(node, ast.ImportFrom):
                base = package if node.level else ""
                reached.add(".".join(filter(None, [base, node.module])))
    waiting = list(reached & known)
    while waiting:
        for other in graph.find_modules_directly_imported_by(waiting.pop()):
            if other not in reached:
                reached.add(other)
                waiting.append(other)
    for module in own:
        if module.name not in reached:
            yield (
                f"{module.path}: expected a module that a command or a public name reaches; "
                f"the proof stands in {PROOF}"
            )


def problems(root: Path = ROOT) -> list[str]:
    """All violations, a line each."""
    house = modules(root)
    graph = grimp.build_graph("softdyn", exclude_type_checking_imports=True, cache_dir=None)
    stubs = {
        module.name: stub.read_text(encoding="utf-8")
        for module in house
        if module.in_wheel and (stub := (root / module.path).with_suffix(".pyi")).is_file()
    }
    return [
        *silent_modules(house),
        *unnamed_modules(house),
        *repeated_classes(house),
        *imports_by_string(house),
        *too_many_commands(house),
        *circles(graph),
        *proof_in_the_wheel(house, graph, stubs),
    ]


def main() -> int:
    """Print the problems; return 1 if there are any."""
    found = problems()
    print("\n".join(found) or "the house stands as planned")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
