"""The files that a command reads, directly or not, and outputs that would replace them."""

import pytest

from softdyn.commands.__main__ import main
from softdyn.validation.inputs import files_read
from tests.support.robots import hinge

LAW = """import helper
from types import SimpleNamespace
class Still:
    def __init__(self, model): self.u = helper.zero(model.nu)
    def __call__(self, state, reference): return SimpleNamespace(u=self.u)
"""
HELPER = "import numpy as np\ndef zero(n): return np.zeros(n)\n"
MESH = '<visual><geometry><mesh filename="meshes/a.stl"/></geometry></visual>'
ARM = hinge(1, "0 0 0", body=MESH)
SWEEP = 'robots = ["arm.urdf"]\ncontrollers = ["law.py:Still"]\n[targets]\npoint = [[0, 0, -0.1]]\n'
FILES = {
    "law.py": LAW,
    "helper.py": HELPER,
    "arm.urdf": ARM,
    "meshes/a.stl": "solid a\nendsolid a\n",
    "s.toml": SWEEP,
    "part.xml": "<mujoco/>",
    "scene.xml": '<mujoco><compiler meshdir="meshes"/><include file="part.xml"/><asset>'
    '<mesh file="a.stl"/></asset></mujoco>',
    "other.txt": "mine",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "link.urdf").symlink_to("arm.urdf")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["law.py:Still"], {"law.py", "helper.py"}),
        (["arm.urdf", "best", 3.0, None], {"arm.urdf", "meshes/a.stl"}),
        (["link.urdf"], {"arm.urdf", "meshes/a.stl"}),
        (["scene.xml"], {"scene.xml", "part.xml", "meshes/a.stl"}),
        (["s.toml"], {"s.toml", "arm.urdf", "meshes/a.stl", "law.py", "helper.py"}),
        (["finger", "", "no such file", "\0", "x" * 5000, "meshes"], set()),
        (["/dev/zero"], set()),
    ],
)
def test_what_a_command_reads(folder, given, expected):
    assert {str(path.relative_to(folder)) for path in files_read(given)} == expected


@pytest.mark.parametrize("name", ["s.toml", "law.py", "arm.urdf"])
def test_a_damaged_file_names_nothing(folder, name):
    (folder / name).write_bytes(b'\xff\xfe = [ "arm.urdf" <<< def')
    assert {path.name for path in files_read([name])} == {name}


@pytest.mark.parametrize(
    ("line", "kept"),
    [
        ("run finger law.py:Still --theta 0 --duration 0.01 --log law.py", "law.py"),
        ("run finger law.py:Still --theta 0 --duration 0.01 --html helper.py", "helper.py"),
        ("sweep s.toml --json s.toml", "s.toml"),
        ("sweep s.toml --json meshes/a.stl", "meshes/a.stl"),
        ("export arm.urdf --mjcf meshes/a.stl", "meshes/a.stl"),
        ("export link.urdf --mjcf arm.urdf", "arm.urdf"),
        ("compare arm.urdf scene.xml --html part.xml", "part.xml"),
        ("check arm.urdf --json ./meshes/../arm.urdf", "arm.urdf"),
        ("view arm.urdf --html meshes/a.stl", "meshes/a.stl"),
        ("benchmark --robots arm.urdf --controllers ic law.py:Still --json law.py", "law.py"),
        ("statics arm.urdf --target 0 0 -0.1 --json arm.urdf", "arm.urdf"),
    ],
)
def test_no_output_takes_the_place_of_an_input(folder, line, kept, capsys):
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "expected a file that this command does not read, got its input" in error
    assert (folder / kept).read_text() == FILES[kept]
    assert sorted(p.name for p in folder.iterdir()) == sorted(
        {"link.urdf", *(name.split("/")[0] for name in FILES)}
    )


def test_a_file_that_is_not_read_is_replaced(folder, capsys):
    assert main(["check", "arm.urdf", "--json", "other.txt"]) in (0, 1)
    assert (folder / "other.txt").read_text().startswith("{")
