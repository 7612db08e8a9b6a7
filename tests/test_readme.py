"""What the README shows runs as it stands."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
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


def test_files_that_the_readme_names_exist():
    names = re.findall(r"\]\(([\w./]+)\)", TEXT) + re.findall(r"`(scripts/\w+\.py)", TEXT)
    assert names
    assert [name for name in names if not (ROOT / name).exists()] == []
