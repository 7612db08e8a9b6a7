"""README and documents: save their files and run their commands and Python code, in order.

A block after `<!-- not run: REASON -->` is not run, but its commands must exist.
"""

from __future__ import annotations

import importlib
import io
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from softdyn.commands.__main__ import COMMANDS
from softdyn.validation import Log
from tests.proof import __main__ as proof
from tests.support import ROOT
from tests.support.command import command

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
Follow = Callable[[Path], dict[str, str]]
PROOF = "python -m tests.proof "
PROGRAMS = {name.replace("_", "-"): place for name, place in proof.PLACES.items()}
NAMES = {name.replace("_", "-") for names in COMMANDS.values() for name in names}
BLOCK = re.compile(
    r"^(?P<mark><!-- not run: [^\n]+ -->\n)?```(?P<kind>\w*)\n(?P<code>.*?)^```$", re.M | re.S
)
# the text around a block names the file for its content
SAVE, APPEND = re.compile(r"Save as\s+`([^`]+)`"), re.compile(r"Append it to\s+`([^`]+)`")


def commands(code: str) -> list[list[str]]:
    """The lines that call softdyn: the command's name and its arguments."""
    found = []
    for line in code.splitlines():
        called = line.removeprefix("$ ").partition("||")[0].partition(" > ")[0]
        words = shlex.split(called, comments=True)
        if words[:1] == ["softdyn"] and len(words) > 1:
            found.append(words[1:])
        elif words[:1] == ["python"] and words[1].startswith("scripts/"):
            found.append([Path(words[1]).stem.replace("_", "-"), *words[2:]])
        elif words[:3] == ["python", "-m", "tests.proof"]:
            found.append([PROOF + words[3], *words[4:]])
    return found


@pytest.fixture
def follow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Follow:
    """Follow a page in an empty folder; return the output of each command by its text.

    It runs in this process, which has all imports. tests/test_wheel.py and CI start a new one.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")

    def shell(line: str) -> str:
        called, _, file = line.partition(" > ")
        words, otherwise = (shlex.split(part) for part in called.partition("||")[::2])
        if words[0] != "softdyn":
            run = [sys.executable, *words[1:]] if words[0] == "python" else ["bash", "-c", line]
            done = subprocess.run(run, text=True, capture_output=True, check=True)
            return done.stdout + done.stderr
        code, out, err = command(*words[1:])
        assert code == 0 or otherwise, f"{line}\n{out}{err}"
        told = otherwise[1].replace("$?", str(code)) + "\n" if code else ""
        if file:
            (tmp_path / file).write_text(out, encoding="utf-8")
        return out + err + told

    def python(code: str, page: Path, session: dict[str, object]) -> str:
        with redirect_stdout(io.StringIO()) as out:
            # a page may use the files of the page before
            exec(compile(code, page.name, "exec"), session)
        return out.getvalue()

    def follow(page: Path) -> dict[str, str]:
        output, last, end, session = {}, "", 0, {"__name__": "__main__"}
        text = page.read_text(encoding="utf-8")
        for block in BLOCK.finditer(text):
            before, after, code = text[end : block.start()], text[block.end() :], block["code"]
            end = block.end()
            if block["mark"]:
                continue
            if SAVE.search(before):
                last = SAVE.findall(before)[-1]
                (tmp_path / last).write_text(code, encoding="utf-8")
                monkeypatch.delitem(sys.modules, Path(last).stem, raising=False)
            elif target := APPEND.match(after.lstrip()):
                with (tmp_path / target[1]).open("a", encoding="utf-8") as file:
                    file.write(code)
            elif block["kind"] == "sh":
                for line in code.splitlines():
                    output[line] = shell(line)
            elif block["kind"] == "python":
                output[code] = python(code, page, session)
        return output

    return follow


def said(output: dict[str, str], command: str) -> str:
    """The output of the only command that contains these words."""
    (found,) = [text for line, text in output.items() if command in line]
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_shown_is_one(page: Path) -> None:
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        if block["kind"] in ("sh", "console"):
            for name, *arguments in commands(block["code"]):
                program = name.removeprefix(PROOF) if name.startswith(PROOF) else None
                assert name in NAMES or program in PROGRAMS, f"{page.name}: {name}"
                own = f"softdyn.commands.{name.replace('-', '_')}"
                module = importlib.import_module(PROGRAMS[program] if program else own)
                module.parser.parse_args(arguments)


WITH_TESTS = {
    "README.md",
    "your_robot.md",
    "silicone_arm.md",
    "chambers.md",
    "bench.md",
    "bench_reference.md",
    "zeros.md",
    "gains.md",
    "your_controller.md",
    "controller_reference.md",
    "files.md",
    "first_minutes.md",
    "learn.md",
}


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.name not in WITH_TESTS], ids=lambda page: page.name
)
def test_what_a_page_shows_runs(page: Path, follow: Follow) -> None:
    follow(page)


def test_the_readme_closes_a_loop(follow: Follow) -> None:
    said_ = said(follow(PAGES[0]), "SoftIdClfQp")
    assert "Status.OK" in said_
    assert float(re.findall(r"after 10 s: ([\d.]+) cm", said_)[0]) <= 0.05


def test_the_first_minutes(follow: Follow, tmp_path: Path) -> None:
    output = follow(ROOT / "docs/first_minutes.md")
    assert "the two engines agree" in said(output, "crosscheck")
    for page in ("ours.html", "both.html", "spirob.html"):
        assert 0.8e6 < (tmp_path / page).stat().st_size < 1.3e6


def test_your_own_robot(follow: Follow, tmp_path: Path) -> None:
    page = ROOT / "docs/your_robot.md"
    output = follow(page) | follow(ROOT / "docs/gains.md")
    checked = output["softdyn check tentacle.urdf"]
    assert re.search(r"reached: .* from 12.649 to 0.1", said(output, "soft-id-clf-qp"))
    for quoted in re.findall(r"\*`([^`]+)`\*", page.read_text(encoding="utf-8")):
        assert quoted in checked
    assert checked.endswith("nothing looks wrong\n")
    assert "fewer at 1 of 103 poses: q = 0 (rank 1)" in checked
    wrong = said(output, "softdyn check wrong.urdf")
    assert "expected <springStiffness>, got <springStifness> (misspelt?)" in wrong
    assert wrong.endswith("exit code 2\n")
    assert said(output, "crosscheck").endswith("the two engines agree\n")
    for file in ("tentacle.html", "tentacle_inputs.html"):
        assert "<html" in (tmp_path / file).read_text(encoding="utf-8")[:2000].lower()
    assert re.search(r"reached: .* to 0\.[01]", said(output, "simulate"))


def test_from_simulation_to_the_bench(follow: Follow, tmp_path: Path) -> None:
    """The observed loop holds the tip within 1 % of the length, as rms over the last second."""
    output = follow(ROOT / "docs/bench.md")
    detail = follow(ROOT / "docs/bench_reference.md")
    assert "bench: rests 2.09 mm apart at the tip" in said(detail, "statics")
    assert "reached: |e| fell from" in said(output, "softdyn run")
    log = Log.load(tmp_path / "bench.npz")
    last = log.error[log.t > log.t[-1] - 1.0]
    assert np.sqrt(np.mean(np.sum(last**2, axis=1))) <= 0.01 * 0.22
    assert 0.8e6 < (tmp_path / "bench.html").stat().st_size < 1.3e6
    rows = (tmp_path / "results/bench_sweep/sweep.md").read_text(encoding="utf-8")
    errors = {row.split("|")[1].strip(): float(row.split("|")[2]) for row in rows.splitlines()
              if re.search(r"\| \d+\.\d+ \|", row)}  # fmt: skip
    assert len(errors) == 6
    assert max(cm for name, cm in errors.items() if name != "50 g more") <= 0.3
    assert "bench.urdf" in said(follow(ROOT / "docs/zeros.md"), "softdyn new bench.toml")


def test_a_silicone_arm(follow: Follow, tmp_path: Path) -> None:
    """Three sections and twelve cables: file, two checks, statics, control, pictures."""
    output = follow(ROOT / "docs/silicone_arm.md")
    assert len((tmp_path / "silicone.toml").read_text().splitlines()) <= 30
    assert "degrees_of_freedom 18, inputs 12" in said(output, "softdyn new")
    assert said(output, "softdyn check").endswith("nothing looks wrong\n")
    assert said(output, "crosscheck").endswith("the two engines agree\n")
    tip = re.search(r"its tip at (.*) m, 0 snaps\nstable", said(output, "statics"))
    assert tip is not None
    assert [round(float(x), 3) for x in tip[1].split()] == [0.078, -0.076, -0.269]
    assert re.search(r"reached: \|e\| fell from 11.323 to 0\.0[01]\d cm", said(output, "run"))
    for page in ("run.html", "cables.html"):
        assert "<html" in (tmp_path / page).read_text(encoding="utf-8")[:2000].lower()


def test_an_arm_under_pressure(follow: Follow, tmp_path: Path) -> None:
    """Two sections with three chambers each, with valves of 50 ms; the file is the example."""
    output = follow(ROOT / "docs/chambers.md")
    example = (ROOT / "docs/examples/chamber_arm.toml").read_text(encoding="utf-8")
    assert tomllib.loads((tmp_path / "arm.toml").read_text()) == tomllib.loads(example)
    assert said(output, "softdyn check").endswith("nothing looks wrong\n")
    assert said(output, "crosscheck").endswith("the two engines agree\n")
    assert "tip at 0.0198 0.0343 -0.1159 m, 0 snaps\nstable" in said(output, "statics arm")
    assert float(re.findall(r"final error +([\d.]+) cm", said(output, "run"))[0]) <= 0.05
    assert '"unit":"kPa"' in (tmp_path / "run.html").read_text(encoding="utf-8")


def test_your_own_controller(follow: Follow, tmp_path: Path) -> None:
    output = follow(ROOT / "docs/your_controller.md")
    assert "reached: |e| fell from 17.002 to 0.1" in output[next(iter(output))]
    assert "not reached" in said(output, "--gains pull.toml")
    assert "FAILED hostile numbers" in said(output, "check")
    assert "SpringPull" in (tmp_path / "comparison" / "table.md").read_text()


def test_channels_and_errors_of_a_controller(follow: Follow, tmp_path: Path) -> None:
    output = follow(ROOT / "docs/controller_reference.md")
    shown = said(output, 'log["away"].shape')
    assert shown == "(400, 3) (('x', 'm'), ('y', 'm'), ('z', 'm')) ['far' 'near']\n"
    assert '"phase"' in (tmp_path / "logged.html").read_text(encoding="utf-8")
    broken = said(output, "brake.py:Brake")
    assert "the controller failed at t = 0 s: u: expected finite numbers" in broken
    assert broken.endswith("exit code 1\n")


def test_a_learned_policy_beside_best(follow: Follow, tmp_path: Path) -> None:
    """It learns, it reaches targets that it has not seen better than rest, and best is better."""
    output = follow(ROOT / "docs/learn.md")
    distances = [float(cm) for cm in re.findall(r"([\d.]+) cm", said(output, "learn_policy.py"))]
    assert len(distances) == 4
    assert distances[-1] < distances[0]
    rows = (tmp_path / "results/learned/sweep.md").read_text(encoding="utf-8")
    best, policy = (
        float(re.search(rf"\| {name} \| ([\d.]+) \|", rows)[1])
        for name in ("best", "policy.py:Policy")
    )
    assert best < 0.1 < policy < 6
    assert "<html" in (tmp_path / "policy.html").read_text(encoding="utf-8")[:2000].lower()


def test_files_and_their_versions(follow: Follow) -> None:
    output = follow(ROOT / "docs/files.md")
    refused = said(output, "later.toml")
    assert "got softdyn-toml-2, of another version of softdyn" in refused
    assert refused.endswith("exit code 2\n")
    shown = said(output, "print(list(again))")
    assert shown in (ROOT / "docs/files.md").read_text(encoding="utf-8")


def test_the_notebook_runs_as_it_stands_and_shows_the_viewer_inside(tmp_path: Path) -> None:
    notebook = nbformat.read(ROOT / "docs/examples/tour.ipynb", as_version=4)
    NotebookClient(notebook, resources={"metadata": {"path": str(tmp_path)}}).execute()
    cells = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    printed = "".join(one.text for outputs in cells for one in outputs if "text" in one)
    errors = [float(x) for x in re.findall(r"mean squared error ([\d.]+)", printed)]
    assert len(errors) == 2
    assert all(error < 2 for error in errors)
    shown = [kind for outputs in cells for one in outputs for kind in one.get("data", ())]
    assert shown.count("image/png") == 1
    pages = [one.data["text/html"] for outputs in cells for one in outputs
             if "text/html" in one.get("data", ())]  # fmt: skip
    assert len(pages) == 2
    assert all(page.startswith("<iframe srcdoc=") for page in pages)


def test_files_that_the_readme_names_exist() -> None:
    text = PAGES[0].read_text(encoding="utf-8")
    names = re.findall(r"\]\(([\w./]+)\)", text) + re.findall(r"`(scripts/\w+\.py)", text)
    assert names
    assert [name for name in names if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_with_a_program_of_the_proof_says_that_it_needs_a_checkout(page: Path) -> None:
    text = re.sub(r"<!--.*?-->", "", page.read_text(encoding="utf-8"))
    if PROOF in text:
        assert "checkout" in text


def test_no_page_needs_the_site_to_be_read() -> None:
    """No directives as text, and no link to a page that only the site has."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"^:::", text, re.M), page.name
        links = re.findall(r"\]\((?!\w+:|#)([^)#\s]+)", re.sub(r"```.*?```", "", text, flags=re.S))
        assert [name for name in links if not (page.parent / name).exists()] == [], page.name
