"""Obstacles of a TOML file: in the twin, in a log, in `run`, and one line for each misuse."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from softdyn import InputError, SetPoint
from softdyn.commands import run
from softdyn.controllers import SoftIdClfQp
from softdyn.controllers.safety_filter import with_barriers
from softdyn.safety import HalfSpace, KeepOutBox, KeepOutSphere, LinkPairs, Surroundings
from softdyn.validation import Log, Twin, simulate
from tests.support.control_cases import robot
from tests.support.refused import refused

FILE = """
[[half_space]]
name = "floor"
normal = [0, 0, 2]
offset = -0.1
contact = false
[[sphere]]
centre = [0.22, 0, -0.1]
radius = 0.02
[[box]]
centre = [0.1, 0.1, 0]
size = [0.05, 0.1, 0.05]
rpy = [0, 0, 0.3]
links = ["link3", "link4"]
margin = 0.002
[[pairs]]
"""


def around() -> Surroundings:
    return Surroundings([
        HalfSpace([0, 0, 1], -0.1, links="all", name="floor", contact=False),
        KeepOutSphere([0.22, 0, -0.1], 0.02, links="all"),
        KeepOutBox([0.1, 0.1, 0], [0.05, 0.1, 0.05], rpy=(0, 0, 0.3), links=["link3", "link4"],
                   margin=0.002),
        LinkPairs(),
    ])  # fmt: skip


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1e-9, 1.0, 1e200, 1.7e308])
def test_a_normal_may_have_any_size(size: float) -> None:
    normal = np.array([0.0, size, 0.0])
    np.testing.assert_array_equal(HalfSpace(normal, 0.1).normal, [0, 1, 0])
    np.testing.assert_allclose(HalfSpace([size, size, 0], 0.1).normal, [0.5**0.5, 0.5**0.5, 0])
    with refused("normal"):
        HalfSpace(0 * normal, 0.1)


def test_pairs_of_no_links_are_refused() -> None:
    with refused("pairs"):
        LinkPairs(pairs=())


def test_a_file_is_the_same_as_its_objects_and_its_table() -> None:
    import tomllib

    model = robot("finger")
    state = model.state(np.full(4, 0.2), np.full(4, 0.1))
    made = Surroundings.of(tomllib.loads(FILE))
    assert made.names == around().names == ("floor", "sphere_1", "box_1", "pairs_1")
    np.testing.assert_array_equal(made.reserve(state), around().reserve(state))
    again = Surroundings.of(json.loads(json.dumps(made.table)))
    assert again.table == made.table
    np.testing.assert_array_equal(again.reserve(state), made.reserve(state))
    tip = Surroundings([KeepOutSphere([0, 0, 0], 0.1)])
    assert Surroundings.of(tip.table).barriers[0].links is None  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"ball": []}, "f.toml: ball: expected one of half_space, sphere, box, pairs, got 'ball'"),
        ({"box": {"size": 1}}, "f.toml: box: expected [[box]], got [box]"),
        ({"sphere": [{"centre": [0, 0, 0]}]}, "f.toml: [[sphere]] 1: expected radius, got none"),
        ({"sphere": [{"centre": [0, 0, 0], "radus": 1}]}, "did you mean 'radius'?"),
        ({"sphere": [{"centre": [0, 0, 0], "radius": -1}]}, "[[sphere]] 1: radius: expected a fin"),
        ({"box": [{"centre": [0, 0, 0], "size": "big"}]}, "[[box]] 1: size: expected finite numb"),
        ({"half_space": [{"normal": [0, 0, 0], "offset": 0}]}, "normal: expected a direction"),
        ({"pairs": [{"pairs": [["link1"]]}]}, "[[pairs]] 1: pairs: expected"),
        ({"pairs": [{"name": "a"}, {"name": "a"}]}, "name: expected a name for each obstacle"),
        ({"sphere": [{"centre": [0, 0, 0], "radius": 1, "contact": 1}]}, "contact: expected True"),
    ],
)
def test_a_misuse_is_one_line(table: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        Surroundings.of(table, "f.toml")
    assert said in str(caught.value)
    assert str(caught.value).startswith("f.toml")


def test_only_obstacles_with_contact_touch_the_twin() -> None:
    model = robot("finger")
    twin = Twin(model, obstacles=around().obstacles)
    names = [twin.model.geom(k).name for k in range(twin.model.ngeom)]
    assert [name for name in names if name] == ["obstacle_0", "obstacle_1", "obstacle_2"]
    data = twin.data
    # bent down, the arm passes the floor, and its tip meets the ball
    touched = set()
    for bend in np.linspace(0.1, 0.5, 9):
        twin.set_state(np.full(4, bend), np.zeros(4))
        mujoco.mj_forward(twin.model, data)
        touched |= {names[g] for c in range(data.ncon) for g in data.contact[c].geom if names[g]}
    assert touched == {"obstacle_1"}


def test_a_run_keeps_clear_and_its_log_has_the_reserve(tmp_path: Path) -> None:
    model = robot("finger")
    floor = HalfSpace([0, 0, 1], -0.1, links="all", name="floor", contact=False)
    wall = Surroundings([floor])
    goal = SetPoint([0.127, 0, -0.127])
    least = {}
    for around in (Surroundings(()), wall):
        law = with_barriers(SoftIdClfQp, around)(model, horizon=0.03)
        log = simulate(model, law, goal, duration=0.8, period=0.005, surroundings=wall)
        least[len(around.barriers)] = log.least_reserve["floor"]
    assert least[0] < -0.02
    assert 0 < least[1] < 0.005
    assert "least reserve  floor" in log.summary()
    assert log.report()["reserve_mm"]["floor"] == pytest.approx(1e3 * least[1])
    log.save(tmp_path / "log.npz")
    again = Log.load(tmp_path / "log.npz")
    np.testing.assert_array_equal(again.reserve, log.reserve)
    assert again.surroundings.names == ("floor",)
    log.to_csv(tmp_path / "log.csv")
    assert ",reserve.floor (m)," in (tmp_path / "log.csv").read_text()
    again = Log.from_csv(tmp_path / "log.csv")
    np.testing.assert_array_equal(again.reserve, log.reserve)
    assert again.surroundings.names == ("floor",)
    (*_, axes) = log.plot(tmp_path / "run.png").axes
    drawn = axes.lines[0].get_ydata()
    assert axes.get_ylabel() == "least reserve (mm)"
    assert min(drawn) == pytest.approx(1e3 * least[1])


def test_run_takes_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.toml").write_text(FILE)
    page = tmp_path / "page.html"
    told = ["--obstacles", str(tmp_path / "scene.toml"), "--no-verdict", "--duration", "0.05"]
    assert run.main(["finger", "soft-id-clf-qp", "--theta", "1", *told, "--html", str(page)]) == 0
    assert "least reserve  floor" in capsys.readouterr().out
    assert page.is_file()
    assert run.main(["finger", "ic", "--theta", "1", *told]) == 0
    assert "least reserve  floor" in capsys.readouterr().out
    (tmp_path / "scene.toml").write_text("[[box]]\nsize = 3\n")
    assert run.main(["finger", "ic", "--theta", "1", *told]) == 2
    assert "scene.toml: [[box]] 1" in capsys.readouterr().err
    (tmp_path / "scene.toml").write_text("")
    for controller in ("ic", "soft-id-clf-qp"):
        assert run.main(["finger", controller, "--theta", "1", *told]) == 2
        assert "scene.toml: expected at least one obstacle, got none" in capsys.readouterr().err
