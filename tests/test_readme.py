"""What the README shows runs as it stands."""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from tests.support import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


def test_the_first_example_closes_a_loop():
    done = subprocess.run([sys.executable, "-c", BLOCKS[0]], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Status.OK" in done.stdout
    error = float(re.search(r"after 10 s: ([\d.]+) cm", done.stdout)[1])
    assert error <= 0.05


def test_the_own_controller_runs_from_its_file(tmp_path):
    (tmp_path / "my_controller.py").write_text(BLOCKS[1])
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/run.py", "finger", "my_controller.py:JacobianTranspose",
         "--theta", "0.5", "--duration", "1", "--json", "-"],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr
    report = json.loads(done.stdout)
    assert report["steps"] == 200
    assert report["max_bound_violation"] == 0


def test_the_commands_that_write_pages_run(tmp_path, monkeypatch, capsys):
    block = TEXT.partition("## See it")[2].partition("```sh\n")[2].partition("```")[0]
    commands = [shlex.split(line, comments=True) for line in block.splitlines()]
    monkeypatch.chdir(tmp_path)
    for _, script, *arguments in commands:
        module = importlib.import_module(f"softdyn.commands.{Path(script).stem}")
        if "--html" in arguments or "--log" in arguments:
            assert module.main(arguments) == 0, capsys.readouterr().err
        else:  # serves until it is ended
            module.parser.parse_args(arguments)
    pages = {path.name: path.stat().st_size for path in tmp_path.glob("*.html")}
    assert pages.keys() == {"ours.html", "both.html"}
    assert all(0.8e6 < size < 1.2e6 for size in pages.values())


def test_the_tour_runs():
    done = subprocess.run(
        [sys.executable, ROOT / "docs/tour.py"], capture_output=True, text=True,
        env={**os.environ, "MPLBACKEND": "Agg"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    errors = [float(x) for x in re.findall(r"mean squared error ([\d.]+)", done.stdout)]
    assert len(errors) == 2
    assert all(error < 2 for error in errors)


def test_files_that_the_readme_names_exist():
    names = re.findall(r"\]\(([\w./]+)\)", TEXT) + re.findall(r"`(scripts/\w+\.py)", TEXT)
    assert names
    assert [name for name in names if not (ROOT / name).exists()] == []
