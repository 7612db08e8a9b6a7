"""Count lines of code: Python without blanks, comments, docstrings, tests and docs. `make count`.

The wheel has one sum, and the proof of the toolkit, which is not packaged, another.
"""

import ast
import subprocess
import sys
import tokenize
from collections import Counter
from pathlib import Path

LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
          tokenize.ENDMARKER, tokenize.ENCODING}  # fmt: skip
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


WHEEL = ("softdyn/", "controllers/", "validation/", "scripts/")
PROOF = ("tests/proof/", "urdf/", ".ci/")


def code_lines(path: str) -> int:
    """Lines of a file with a token that is neither a comment nor part of a docstring."""
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


def main() -> None:
    """Print the number for each folder, then that of the wheel and that of the proof."""
    tracked = subprocess.check_output(["git", "ls-files", "*.py"], text=True).splitlines()
    files = [name for name in tracked if name.startswith((*WHEEL, *PROOF)) and not is_test(name)]
    counts = Counter({name: code_lines(name) for name in files if Path(name).is_file()})
    if "--files" in sys.argv:
        for name, lines in counts.most_common():
            print(f"{lines:6}  {name}")
    folders: Counter[str] = Counter()
    for name, lines in counts.items():
        folders[name.rpartition("/")[0]] += lines
    for folder, lines in sorted(folders.items()):
        print(f"{lines:6}  {folder}/")
    for label, tops in (("in the wheel", WHEEL), ("proof, not in the wheel", PROOF)):
        print(f"{sum(n for name, n in counts.items() if name.startswith(tops)):6}  {label}")


def is_test(name: str) -> bool:
    """Whether pytest collects the file."""
    return Path(name).name.startswith(("test_", "conftest"))


if __name__ == "__main__":
    main()
