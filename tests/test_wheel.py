"""The wheel in a project whose folders have the same names as softdyn's."""

import json
import os
import subprocess
import sys
import zipfile

import pytest

from tests.support import ROOT

CODE = """
import json, sys
import controllers, controllers.pid, validation
import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.validation import paper, simulate
model = softdyn.load("finger")
log = simulate(model, SoftIdClfQp(model), paper.set_point("finger", 0.5), duration=0.05)
print(json.dumps({
    "files": [controllers.__file__, validation.__file__, softdyn.__file__, str(model.robot.path)],
    "own": controllers.pid.Pid().gain, "failed": log.failed, "steps": log.steps,
    "name": sys.modules[SoftIdClfQp.__module__].__name__,
}))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from the source archive as for a release."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--outdir", folder, ROOT]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (file,) = folder.glob("*.whl")
    return file


def test_the_wheel_holds_real_files_below_softdyn_and_nothing_beside(wheel):
    with zipfile.ZipFile(wheel) as archive:
        infos = archive.infolist()
    names = {info.filename for info in infos}
    assert {name.split("/")[0] for name in names} == {
        "softdyn",
        wheel.name.removesuffix("-py3-none-any.whl") + ".dist-info",
    }
    links = {i.filename for i in infos if (i.external_attr >> 16) & 0o170000 == 0o120000}
    assert not links
    ours = {"controllers": "controllers", "validation": "validation", "scripts": "commands",
            "softdyn": ".", "urdf": "robots", "docs/examples": "examples"}  # fmt: skip
    tracked = subprocess.run(
        ["git", "ls-files", *ours], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    for name in tracked:
        if name.startswith("urdf/") and name.endswith(".py"):
            continue  # the generator of the bundled robots is proof
        if not (ROOT / name).is_symlink() and (ROOT / name).is_file():
            top = next(top for top in ours if name.startswith(f"{top}/"))
            inside = os.path.normpath(f"softdyn/{ours[top]}{name.removeprefix(top)}")
            assert inside in names, name
    assert not [name for name in names if "tests/" in name or "make_robots" in name]


def test_it_works_beside_a_project_with_folders_of_our_names(wheel, tmp_path):
    target, project = tmp_path / "installed", tmp_path / "project"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    for name, text in {
        "controllers/__init__.py": "", "controllers/pid.py": "class Pid:\n    gain = 3\n",
        "validation/__init__.py": "", "urdf/__init__.py": "", "main.py": CODE,
    }.items():  # fmt: skip
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text(text)
    # kernels are not compiled, because that is slow in a new folder; .ci/wheel.py does it
    environment = {**os.environ, "PYTHONPATH": str(target), "SOFTDYN_COMPILE": "0"}
    done = subprocess.run(
        [sys.executable, "main.py"], cwd=project, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["files"][:2] == [str(project / f"{n}/__init__.py") for n in
                                  ("controllers", "validation")]  # fmt: skip
    assert all(file.startswith(str(target)) for file in found["files"][2:])
    assert (found["own"], found["failed"], found["steps"]) == (3, False, 10)
    assert found["name"].startswith("softdyn.controllers.")
