"""Count what the wheel and the proof hold. `make count` prints the figures and fails at nothing.

python .ci/code_lines.py [--files]   --files lists the files, the longest first

Wheel: softdyn/, controllers/, validation/ and scripts/. Proof: tests/proof/, urdf/ and .ci/. Files
that pytest collects (test_*.py, conftest.py) count in neither. Only tracked files count.

- lines, Python: lines with a token that is no comment and no part of a docstring.
- lines, JavaScript: lines with something else than spaces outside of comments.
- kernels: functions that `compiled` or `compiled_or` of `softdyn.compiled` decorates or makes.
- module constants: names in capitals that a module binds at its top level. Numeric are those whose
  value has a number in it and no call.
- commands: modules of scripts/ that bind `main` to `cli.program`.
- public names: functions and classes at a module's top level without a leading underscore.
- names promised, provisional: those that docs/api.md lists. Other names: the public ones that it
  does not list.

All but the lines are counted in the wheel only.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
          tokenize.ENDMARKER, tokenize.ENCODING}  # fmt: skip
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
WHEEL = ("softdyn/", "controllers/", "validation/", "scripts/")
PROOF = ("tests/proof/", "urdf/", ".ci/")
LISTED, NAME = re.compile(r"^\*Names of `([\w.]+)`:\* (.+)$", re.M), re.compile(r"`(\w+)`(°?)")
CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*")
# a comment, or a string in which // or /* begins none
SCRIPT_TOKEN = re.compile(
    r"""//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'|`(?:\\.|[^`\\])*`""", re.S
)


def python_lines(path: str) -> int:
    """Lines of a Python file with a token that is neither a comment nor part of a docstring."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(Path(path).read_bytes())):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            docstrings |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    found: set[int] = set()
    with open(path, "rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type not in LAYOUT:
                found |= set(range(token.start[0], token.end[0] + 1))
    return len(found - docstrings)


def script_lines(text: str) -> int:
    """Lines of JavaScript with something else than spaces outside of comments."""
    bare = SCRIPT_TOKEN.sub(lambda m: m[0] if m[0][:1] in "\"'`" else "\n" * m[0].count("\n"), text)
    return sum(bool(line.strip()) for line in bare.splitlines())


def kernels(tree: ast.Module) -> int:
    """Kernels that a module makes: decorators, and calls of `compiled` at any place."""
    found = 0
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            found += sum(_makes_kernel(one) for one in node.decorator_list)
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            found += _makes_kernel(node.value)
    return found


def _makes_kernel(node: ast.expr) -> bool:
    called = node.func if isinstance(node, ast.Call) else node
    return ast.unparse(called).split(".")[-1] in ("compiled", "compiled_or")


def constants(tree: ast.Module) -> Iterator[tuple[str, bool]]:
    """Module-level names in capitals, and whether each is numeric."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        else:
            continue
        assert node.value is not None
        inside = list(ast.walk(node.value))
        numeric = any(
            isinstance(one, ast.Constant) and type(one.value) in (int, float) for one in inside
        ) and not any(isinstance(one, ast.Call) for one in inside)
        for target in targets:
            for name in ast.walk(target):
                if isinstance(name, ast.Name) and CONSTANT.fullmatch(name.id):
                    yield name.id, numeric


def public_names(tree: ast.Module) -> list[str]:
    """Functions and classes at the top level without a leading underscore."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    return [one.name for one in tree.body if isinstance(one, kinds) and one.name[0] != "_"]


def listed_names(text: str) -> tuple[set[str], set[str]]:
    """The promised and the provisional names of docs/api.md, with their packages."""
    promised, provisional = set(), set()
    for package, names in LISTED.findall(text):
        for name, mark in NAME.findall(names):
            (provisional if mark else promised).add(f"{package}.{name}")
    return promised, provisional


def is_command(path: str, tree: ast.Module) -> bool:
    """Whether the module is a command."""
    return path.startswith("scripts/") and any(
        isinstance(one, ast.Assign) and ast.unparse(one.value).startswith("cli.program(")
        for one in tree.body
    )


def is_test(name: str) -> bool:
    """Whether pytest collects the file."""
    return Path(name).name.startswith(("test_", "conftest"))


def main() -> None:
    """Print lines, folder by folder, their sums, and the other counts."""
    asked = ["git", "ls-files", "*.py", "*.js"]
    tracked = subprocess.check_output(asked, text=True).splitlines()
    files = [
        name
        for name in tracked
        if name.startswith((*WHEEL, *PROOF)) and not is_test(name) and Path(name).is_file()
    ]
    lines = {
        name: python_lines(name) if name.endswith(".py") else script_lines(Path(name).read_text())
        for name in files
    }
    if "--files" in sys.argv:
        for name, number in Counter(lines).most_common():
            print(f"{number:6}  {name}")
    folders: Counter[str] = Counter()
    for name, number in lines.items():
        folders[name.rpartition("/")[0]] += number
    for folder, number in sorted(folders.items()):
        print(f"{number:6}  {folder}/")
    for label, tops in (("wheel", WHEEL), ("proof", PROOF)):
        for language, suffix in (("Python", ".py"), ("JavaScript", ".js")):
            of = [n for name, n in lines.items() if name.startswith(tops) and name.endswith(suffix)]
            print(f"{sum(of):6}  lines, {language}, {label}")
    trees = {
        name: ast.parse(Path(name).read_bytes())
        for name in files
        if name.startswith(WHEEL) and name.endswith(".py")
    }
    bound = [one for tree in trees.values() for one in constants(tree)]
    public = [name for tree in trees.values() for name in public_names(tree)]
    promised, provisional = listed_names(Path("docs/api.md").read_text(encoding="utf-8"))
    known = {name.rpartition(".")[2] for name in promised | provisional}
    for number, label in (
        (sum(map(kernels, trees.values())), "kernels"),
        (len(bound), "module constants"),
        (sum(numeric for _, numeric in bound), "of them numeric"),
        (sum(is_command(*one) for one in trees.items()), "commands"),
        (len(public), "public names"),
        (len(promised), "names promised"),
        (len(provisional), "names provisional"),
        (sum(name not in known for name in public), "other names"),
    ):
        print(f"{number:6}  {label}")


if __name__ == "__main__":
    main()
