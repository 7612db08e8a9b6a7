"""`make count`: each count on a few lines, and the whole on this checkout."""

import ast
import subprocess
import sys
from pathlib import Path

import code_lines
from house import ROOT

MODULE = '''"""Two lines
of it."""

import math  # counted

# not counted
LIMIT, _WIDTH = 3.0, 2
NAMES = ("a", "b")
SIZE: float = math.pi
lower = 1


@compiled
def kernel(x):
    """Not counted."""
    return x


_inlined = compiled(kernel, inline=True)


class Thing:
    SIZE = 3

    @compiled_or(kernel)
    def method(self): ...


main = cli.program(parser, kernel, __name__)
'''


def test_python(tmp_path: Path):
    (tmp_path / "module.py").write_text(MODULE)
    tree = ast.parse(MODULE)
    assert code_lines.python_lines(str(tmp_path / "module.py")) == 14
    assert code_lines.kernels(tree) == 3
    assert [*code_lines.constants(tree)] == [
        ("LIMIT", True),
        ("_WIDTH", True),
        ("NAMES", False),
        ("SIZE", False),
    ]
    assert code_lines.public_names(tree) == ["kernel", "Thing"]
    assert code_lines.is_command("scripts/new.py", tree)
    assert not code_lines.is_command("scripts/new.py", ast.parse("main = 1"))


def test_promised_and_provisional_names():
    text = (
        "*Names of `a.b`:* `one` `Two`° `three`\n\nNames of `no`: `four`\n*Names of `a`:* `one`\n"
    )
    assert code_lines.listed_names(text) == ({"a.b.one", "a.b.three", "a.one"}, {"a.b.Two"})


def test_javascript():
    text = 'const url = "http://x";  // counted\n\n/* not\ncounted */\n// nor this\nf("/*");\ng();'
    assert code_lines.script_lines(text) == 3


def test_the_whole_names_every_figure():
    done = subprocess.run(
        [sys.executable, ".ci/code_lines.py"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    figures = {}
    for line in done.stdout.splitlines():
        number, _, label = line.strip().partition("  ")
        figures[label] = int(number)
    commands = [path.stem for path in (ROOT / "scripts").glob("*.py")]
    helpers = {"__init__", "__main__", "cli", "study_options", "working"}
    assert figures["commands"] == len(set(commands) - helpers)
    counted = ("lines, Python, wheel", "lines, Python, proof", "kernels", "public names")
    for label in (*counted, "names promised", "names provisional", "other names"):
        assert figures[label] > 0
    folders = [n for label, n in figures.items() if label.endswith("/")]
    assert sum(folders) == sum(n for label, n in figures.items() if label.startswith("lines, "))
