"""Names, paths and the example-robot-data package."""

from __future__ import annotations

import os
import shutil
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

import softdyn
from softdyn import InputError
from softdyn.description import library as catalogue
from softdyn.description.library import BUNDLED, bundled_name, bundled_names, example_robots, find
from softdyn.loading import load_text
from tests.support.refused import refused


def test_bundled_names_are_the_four_robots() -> None:
    assert bundled_names() == ("finger", "helix", "spirob", "spirob48")
    assert softdyn.bundled_names is bundled_names


@pytest.mark.parametrize("name", bundled_names())
def test_a_bundled_name_and_its_path_are_one_robot(name: str) -> None:
    path = find(name)
    assert path == BUNDLED / f"{name}.urdf"
    assert find(path) == path
    assert find(str(path)) == path
    assert bundled_name(path) == name


def test_the_table_of_an_arm_is_no_robot(tmp_path: Path) -> None:
    table = tmp_path / "arm.toml"
    table.write_text("name = 'arm'\n")
    with refused("robot"):
        find(table)


def test_a_bundled_file_is_known_by_any_of_its_paths(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(BUNDLED)
    assert bundled_name(Path("finger.urdf")) == "finger"
    assert bundled_name(Path("../urdf/finger.urdf")) == "finger"
    link = tmp_path / "mine.urdf"
    link.symlink_to(BUNDLED / "finger.urdf")
    assert bundled_name(link) == "finger"


def test_a_copy_is_not_the_bundled_robot(tmp_path: Path) -> None:
    """Gains belong to a file, not to a name."""
    copy = Path(shutil.copy(BUNDLED / "finger.urdf", tmp_path))
    assert bundled_name(copy) is None
    assert softdyn.load(copy).bundled is None
    assert softdyn.load(copy).name == softdyn.load("finger").name == "finger"
    assert softdyn.load("finger").bundled == "finger"


def test_a_text_is_the_bundled_robot_only_where_it_is_its_file() -> None:
    text = (BUNDLED / "finger.urdf").read_text()
    own = text.replace('damping="', 'damping="1', 1)
    assert own != text
    for written, name, found in (
        (text, "finger", "finger"), (own, "finger", None), (text, "helix", None),
        (text, "thumb", None), (text, None, None),
    ):  # fmt: skip
        assert load_text(written, path="finger.urdf", bundled=name).bundled == found


def test_what_is_not_a_urdf_is_not_bundled() -> None:
    assert bundled_name(BUNDLED / "notes.txt") is None
    assert bundled_name(BUNDLED / "source" / "reference_models.json") is None


def test_a_bundled_name_wins_over_a_file(monkeypatch, tmp_path: Path) -> None:
    (tmp_path / "finger").write_text("")
    monkeypatch.chdir(tmp_path)
    assert find("finger") == BUNDLED / "finger.urdf"
    assert find("./finger") == Path("finger")
    (tmp_path / "thumb").write_text("")
    assert find("thumb") == Path("thumb")


def test_example_robots_are_files_by_their_stem() -> None:
    examples = example_robots()
    assert examples["ur5_robot"].name == "ur5_robot.urdf"
    assert all(path.is_file() and path.stem == name for name, path in examples.items())
    assert find("ur5_robot") == find("ur5") == examples["ur5_robot"]
    assert all(find(name) == path for name, path in examples.items() if "." in name)


def test_without_the_package_there_are_no_examples(monkeypatch) -> None:
    def absent(name: str) -> None:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(catalogue, "distribution", absent)
    assert example_robots() == {}
    with refused("robot", "ur5_robot"):
        find("ur5_robot")


@pytest.mark.parametrize(
    ("name", "near"), [("fingr", "finger"), ("spirob84", "spirob48"), ("ur5_robo", "ur5_robot")]
)
def test_a_misspelt_name_is_told_its_neighbours(name: str, near: str) -> None:
    with refused("robot", name) as caught:
        find(name)
    assert near in caught.value.expected


@pytest.mark.parametrize(
    "source",
    ["absent.urdf", "a/b", "/", ".", "", " ", "\0", "x" * 5000, "x" * 5000 + ".urdf", "a\nb", "~",
     os.devnull, None, 3, b"finger", ["finger"]],
)  # fmt: skip
def test_what_is_no_robot_is_refused_on_one_line(source: object) -> None:
    with pytest.raises(InputError) as caught:
        softdyn.load(source)  # type: ignore[arg-type]
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith("robot: expected ")
