"""The tutorials work as they stand: their files are saved, their commands run, in their order."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import ROOT

# The text around a block tells where its content belongs.
SAVE, APPEND = re.compile(r"Save as\s+`([^`]+)`"), re.compile(r"Append it to\s+`([^`]+)`")


def clone(folder: Path) -> dict[str, str]:
    """A folder that looks like a clone, without what a clone does not have; its environment."""
    for name in ("scripts", "softdyn", "controllers", "validation", "urdf"):
        (folder / name).symlink_to(ROOT / name)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}


def follow(tutorial: str, folder: Path) -> dict[str, str]:
    """Do what the tutorial says; output of each command by its text."""
    environment, output, last = clone(folder), {}, ""
    text = (ROOT / "docs" / tutorial).read_text(encoding="utf-8")
    pieces = re.split(r"```(\w+)\n(.*?)```", text, flags=re.DOTALL)
    for before, kind, code, after in zip(
        pieces[:-1:3], pieces[1::3], pieces[2::3], pieces[3::3], strict=True
    ):
        if kind == "sh":
            for line in code.splitlines():
                done = subprocess.run(
                    ["bash", "-c", line], cwd=folder, env=environment, text=True,
                    stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
                )  # fmt: skip
                assert done.returncode == 0, f"{line}\n{done.stdout}"
                output[line] = done.stdout
        elif SAVE.search(before):
            last = SAVE.findall(before)[-1]
            (folder / last).write_text(code, encoding="utf-8")
        elif APPEND.search(after):
            with (folder / APPEND.findall(after)[0]).open("a", encoding="utf-8") as file:
                file.write(code)
        else:
            run = [sys.executable, "-c", code]
            output[code] = subprocess.check_output(run, cwd=folder, env=environment, text=True)
    return output


def said(output: dict[str, str], command: str) -> str:
    """What the only command that contains these words printed."""
    (found,) = [text for line, text in output.items() if command in line]
    return found


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    folder = tmp_path_factory.mktemp("your_robot")
    return folder, follow("your_robot.md", folder)


def test_your_own_robot(robot: tuple[Path, dict[str, str]]) -> None:
    folder, output = robot
    checked = said(output, "check_urdf.py tentacle.urdf")
    text = (ROOT / "docs" / "your_robot.md").read_text(encoding="utf-8")
    for quoted in re.findall(r"\*`([^`]+)`\*", text):
        assert quoted in checked
    assert checked.endswith("nothing looks wrong\n")
    assert "fewer at 1 of 103 poses: q = 0 (rank 1)" in checked
    wrong = said(output, "check_urdf.py wrong.urdf")
    assert "expected <springStiffness>, got <springStifness> (misspelt?)" in wrong
    assert wrong.endswith("exit code 2\n")
    assert said(output, "crosscheck.py").endswith("the two engines agree\n")
    assert re.search(r"done: \|e\| fell from 12\.649 to 0\.\d+ cm", said(output, "run.py"))
    for page in ("tentacle.html", "tentacle_inputs.html"):
        assert "<html" in (folder / page).read_text(encoding="utf-8")[:2000].lower()
    u = [float(x) for x in said(output, "SoftIdClfQp").strip(" []\n").split()]
    assert all(0 <= x <= 30 for x in u)


def test_your_own_controller(tmp_path: Path) -> None:
    output = follow("your_controller.md", tmp_path)
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["controller"], result["failed"]) == ("my_controller.py:SpringPull", False)
    table = (tmp_path / "comparison" / "table.md").read_text()
    assert "SpringPull" in table
    broken = said(output, "Brake")
    assert "the controller failed at t = 0 s: u: expected finite numbers" in broken
    assert broken.endswith("exit code 1\n")
