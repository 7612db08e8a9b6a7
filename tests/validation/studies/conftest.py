"""Fixtures of the tests of sweeps."""

import sys
from pathlib import Path

import pytest

from softdyn.validation.studies.sweep_file import read_sweep
from tests.support.sweeps import OWN, PENDULUM


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder; the sweep is called from another one."""
    (tmp_path / "pendulum.urdf").write_text(PENDULUM)
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "neighbour.py").write_text("DAMPING = 0.1\n")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for name in ("own", "neighbour"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


@pytest.fixture
def written(folder):
    """Write a sweep file and read it."""

    def write(text, name="sweep.toml"):
        (folder / name).write_text(text)
        return read_sweep(folder / name)

    return write


@pytest.fixture
def refused(folder, call):
    """A sweep with something replaced is refused in one line, before anything is written."""

    def check(text, old, new, message):
        assert old in text
        (folder / "sweep.toml").write_text(text.replace(old, new, 1))
        code, out, err = call(folder / "sweep.toml", "--out", "out")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert err.startswith(f"error: {folder / 'sweep.toml'}: ")
        assert message in err
        assert not Path("out").exists()

    return check


@pytest.fixture
def call(folder, monkeypatch, capsys):
    """Run the command in this process: exit code, stdout, stderr."""
    from softdyn.commands import sweep as command

    def call(*arguments):
        try:
            code = command.main([str(a) for a in arguments])
        except SystemExit as error:
            code = error.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
