"""An engine of another installation, put before the installed one by PYTHONPATH."""

import os
import subprocess
import sys

import pytest

# as the Python packages of ROS, whose binary part belongs to another Python
OTHER = "from .pinocchio_pywrap_default import *\n"


def of(folder, version=None):
    """A folder for PYTHONPATH with a Pinocchio; with a version also its metadata."""
    package = folder / "pinocchio"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(OTHER)
    if version is not None:
        metadata = folder / f"pin-{version}.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: pin\nVersion: {version}\n"
        )
    return folder


def run(folder, *words):
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.run(
        [sys.executable, *words], env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("version", "named"), [(None, "pinocchio/__init__.py"), ("3.2.0", "3.2.0")]
)
def test_a_command_names_the_foreign_file_in_one_line(tmp_path, version, named):
    done = run(of(tmp_path / "opt", version), "-m", "softdyn.commands", "check", "finger")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert str(tmp_path / "opt") in done.stderr
    assert named in done.stderr
    assert "PYTHONPATH" in done.stderr


@pytest.mark.parametrize("code", ["import softdyn; softdyn.load('finger')",
                                  "from softdyn.tasks import PointTask",
                                  "from softdyn.validation import Twin"])  # fmt: skip
def test_python_gets_an_input_error(tmp_path, code):
    done = run(of(tmp_path / "opt"), "-c", code)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith(
        "softdyn.exceptions.InputError: import pinocchio"
    )
