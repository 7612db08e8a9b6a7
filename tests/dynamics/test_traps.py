"""Files that the engines' own parsers accept silently and softdyn refuses.

Each case tests both, so that it also fails when an engine improves.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

import softdyn
from softdyn import UrdfError, parse
from softdyn.validation import Twin
from softdyn.validation.twin.twin import SimulationError
from tests.support import robots
from tests.support.misuses import ARM, INERTIAL
from tests.support.refused import refused

PLACE = {"at": "0 0 0.1"}


def robot(body: str, axis: str = "0 1 0", more: str = "") -> str:
    """One link on a hinge, its inertia given."""
    bob = robots.link("base") + robots.tag("link", body, name="bob")
    return robots.robot("r", bob, robots.joint("j", "base", "bob", axis, **PLACE), more)


def with_mass(text: str) -> str:
    return INERTIAL.replace('value="0.1"', f'value="{text}"')


def chain(count: int) -> str:
    links = [robots.tag("link", INERTIAL, name=f"l{i}") for i in range(count)]
    joints = [robots.joint(f"j{i}", f"l{i - 1}", f"l{i}", **PLACE) for i in range(1, count)]
    return robots.robot("c", *links, *joints)


SECOND = robots.joint("k", "base", "bob", "1 0 0", **PLACE)
SILENT = {
    "massless leaf": (robot(""), "a positive mass"),
    "negative mass": (robot(with_mass("-0.1")), "value >= 0"),
    "negative moment": (robot(INERTIAL.replace('"1e-5"', '"-1"')), "a physical inertia"),
    "no triangle": (robot(INERTIAL.replace('izz="9e-5"', 'izz="9"')), "a physical inertia"),
    "mass in words": (robot(with_mass("heavy")), "a finite number as value"),
    "mass with a comma": (robot(with_mass("0,1")), "a finite number as value"),
    "mass nan": (robot(with_mass("nan")), "a finite number as value"),
    "zero axis": (robot(INERTIAL, axis="0 0 0"), "a non-zero vector"),
    "two parents": (robot(INERTIAL, more=SECOND), "one parent of link 'bob'"),
}


@pytest.mark.parametrize("case", SILENT)
def test_pinocchio_accepts_and_softdyn_refuses(case: str, tmp_path: Path) -> None:
    text, expected = SILENT[case]
    model = pin.buildModelFromXML(text)
    assert model.nv >= 1
    path = robots.write(tmp_path, text)
    with pytest.raises(UrdfError) as caught:
        parse(path)
    assert expected in caught.value.expected


def test_pinocchio_drops_an_inertia_whose_mass_it_cannot_read() -> None:
    assert pin.buildModelFromXML(robot(with_mass("0.1"))).inertias[1].mass == pytest.approx(0.1)
    for text in ("heavy", "0,1 "):
        assert pin.buildModelFromXML(robot(with_mass(text))).inertias[1].mass == 0.0


@pytest.mark.parametrize("count", [1025, 5000])
def test_a_chain_that_would_overflow_the_stack_never_reaches_pinocchio(
    count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pin, "buildModelFromXML", lambda *_: pytest.fail("it did"))
    path = robots.write(tmp_path, chain(count))
    with refused("<robot>", count, by=UrdfError):
        softdyn.load(path)


def test_degrees_of_freedom_are_counted_before_pinocchio_allocates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pin, "buildModelFromXML", lambda *_: pytest.fail("it did"))
    path = robots.write(tmp_path, chain(301))
    with refused("<robot>", 300, by=UrdfError):
        softdyn.load(path)


def test_yourdfpy_returns_a_part_of_a_truncated_robot(tmp_path: Path) -> None:
    path = robots.write(tmp_path, ARM[: ARM.index('<joint name="slide"')])
    options = {"build_scene_graph": False, "load_meshes": False}
    part = yourdfpy.URDF.load(str(path), **options).robot
    assert len(part.links) == 7
    assert len(part.joints) == 4
    with refused(
        "file", "Premature end of data in tag robot line 1, line 27, column 3", by=UrdfError
    ):
        parse(path)


ESCAPES = ("/etc/passwd", "../../secret.stl", "file:///etc/passwd", "package://../../secret.stl")


@pytest.mark.parametrize("name", ESCAPES)
def test_meshes_elsewhere_reach_no_engine(name: str, tmp_path: Path) -> None:
    shape = f'<geometry><mesh filename="{name}"/></geometry>'
    text = ARM.replace(
        '<link name="base"/>',
        f'<link name="base"><visual>{shape}</visual><collision>{shape}</collision></link>',
    )
    model = robots.load(tmp_path, text)
    assert "mesh" not in model.robot.xml
    twin = Twin(model, contacts=True)
    assert twin.model.nmesh == 0
    assert any("mesh is not supported" in text for text in twin.skipped)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
def test_mujoco_does_not_start_anew_behind_our_back(value: float) -> None:
    twin = Twin("finger")
    twin.advance(np.zeros(2), 10)
    before = twin.time
    twin.data.qvel[0] = value
    with pytest.raises(SimulationError):
        twin.advance(np.zeros(2), 10)
    assert twin.time >= before > 0


@pytest.mark.parametrize(
    ("was", "becomes", "expected"),
    [
        ('value="0.1"', 'value="0.2"', ('<link name="bob">', "0.2 kg in Pinocchio")),
        ('xyz="0 0 0.05"', 'xyz="0 0 0.051"', ('<link name="bob">', "0 0 0.051 m in Pinocchio")),
        (
            'izz="9e-5"',
            'izz="9.1e-5"',
            ('<link name="bob">', "9e-05 0 0 0 9e-05 0 0 0 9.1e-05 kg m^2 in Pinocchio"),
        ),
    ],
)
def test_a_body_that_pinocchio_reads_otherwise_is_refused(
    was: str, becomes: str, expected: str, tmp_path: Path
) -> None:
    solid = '<inertial><origin xyz="0 0 0.05"/><mass value="0.1"/>' + (
        '<inertia ixx="9e-5" ixy="0" ixz="0" iyy="9e-5" iyz="0" izz="9e-5"/></inertial>'
    )
    path = robots.write(tmp_path, robot(solid))
    parsed = parse(path)
    assert parsed.xml.count(was) == 1
    other = replace(parsed, xml=parsed.xml.replace(was, becomes))
    with refused(*expected, by=UrdfError) as caught:
        softdyn.build(other)
    assert caught.value.element == '<link name="bob">'
    assert caught.value.got.endswith("in Pinocchio")


def test_pinocchio_misplaces_the_centre_of_very_light_bodies(tmp_path: Path) -> None:
    """Two equal links below 2e-16 kg get a wrong centre; it does not divide by their mass."""
    light = INERTIAL.replace('value="0.1"', 'value="1e-17"').replace("e-5", "e-17")
    far = light.replace('xyz="0.05 0 0"', 'xyz="3 0 0"')
    weld = '<joint name="w" type="fixed"><parent link="bob"/><child link="pin"/></joint>'
    path = robots.write(tmp_path, robot(light, more=f'<link name="pin">{far}</link>{weld}'))
    with refused('<link name="bob">', "0.0121699 0 0 m in Pinocchio", by=UrdfError):
        softdyn.build(parse(path))
