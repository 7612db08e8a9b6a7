"""Obstacles are solid in the twin: depth, forces, start, verdict, for each kind and each shape."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.safety import HalfSpace, KeepOutBox, KeepOutSphere, Surroundings
from softdyn.validation import Log, Rig, paper, rollout, simulate
from softdyn.validation.loop.verdict import INSIDE
from tests.support.refused import refused
from tests.support.robots import load, slide

GOAL = paper.set_point("finger", theta=0.5)  # (0.127, 0, -0.127) m, from z = 0
KINDS: dict[str, dict[str, Any]] = {
    "half_space": {"normal": [0, 0, 1], "offset": -0.05},
    "sphere": {"centre": [0.13, 0, -0.2], "radius": 0.15},
    "box": {"centre": [0.13, 0, -0.2], "size": [0.4, 0.2, 0.3], "rpy": [0, 0, 0.3]},
}
SHAPE = "<{kind}><geometry>{form}</geometry></{kind}>"
FORMS = {
    "collision box": ("collision", '<box size="0.02 0.02 0.02"/>', 0.01),
    "visual box": ("visual", '<box size="0.02 0.02 0.02"/>', 0.01),
    "visual sphere": ("visual", '<sphere radius="0.01"/>', 0.01),
    "visual cylinder": ("visual", '<cylinder radius="0.005" length="0.02"/>', 0.01),
    "collision mesh": ("collision", '<mesh filename="block.obj" scale="0.01 0.01 0.01"/>', 0.01),
    "none": ("", "", 0.0),
}
MASS = 0.2  # kg


def piston(folder: Path, form: str, base: str = "") -> softdyn.SoftModel:
    """A body of one shape that slides along z, on a base, with a two-sided force."""
    kind, shape, _ = FORMS[form]
    body = SHAPE.format(kind=kind, form=shape) if kind else ""
    block = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1))
    faces = "1 2 4 3,5 7 8 6,1 5 6 2,3 4 8 7,1 3 7 5,2 6 8 4"
    (folder / "block.obj").write_text(block + "".join(f"f {f}\n" for f in faces.split(",")))
    return load(folder, slide(
        MASS, 1e-4, axis="0 0 1", effort=50, damping=2, pull=(-50, 50), base=base, body=body,
        block='<task frame="block"/>',
    ))  # fmt: skip


def depth(kind: str, tip: np.ndarray) -> float:
    """How deep a tip is in an obstacle of `KINDS` (m), from its numbers."""
    said = KINDS[kind]
    if kind == "half_space":
        return float(said["offset"] - tip[2])
    x, _, z = tip - said["centre"]
    if kind == "sphere":
        return float(said["radius"] - np.linalg.norm(tip - said["centre"]))
    c, s = np.cos(0.3), np.sin(0.3)  # the box is turned about z
    return float(min(0.2 - abs(c * x), 0.1 - abs(s * x), 0.15 - abs(z)))


@pytest.mark.parametrize("options", [{}, {"rig": "file"}, {"contacts": True}], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_a_wall_stops_an_arm_and_pushes_it(kind: str, options: dict[str, Any]) -> None:
    model = softdyn.load("finger")
    law = SoftIdClfQp(model)
    log = simulate(model, law, GOAL, duration=1.5, surroundings={kind: [KINDS[kind]]}, **options)
    assert log.reserve is not None and log.contact_force is not None  # noqa: PT018
    assert log.reserve[-1, 0] > -INSIDE
    assert log.reserve.min() > -1e-3
    assert depth(kind, log.y[-1]) < INSIDE  # the tip lies 10 mm beyond the last link's shape
    assert log.columns("contact_force")[2] == (f"{kind}_1.z", "N")
    assert log.contact_force[-1, 2] > 0.1
    assert not log.contact_force[0].any()
    assert not log.verdict().reached
    assert not log.verdict().inside


@pytest.mark.parametrize("kind", KINDS)
def test_a_region_lets_an_arm_in_and_the_verdict_says_how_deep(kind: str) -> None:
    model = softdyn.load("finger")
    around = {kind: [{**KINDS[kind], "contact": False, "name": "lid", "margin": 0.01}]}
    log = simulate(model, SoftIdClfQp(model), GOAL, duration=1.5, surroundings=around)
    found = log.verdict()
    assert np.linalg.norm(log.error[-1]) < found.tolerance
    assert not found.reached
    assert found.inside == {"lid": pytest.approx(depth(kind, log.y[-1]), rel=0.02)}
    assert found.inside["lid"] > 0.05
    assert "inside 'lid'" in log.summary().splitlines()[-1]
    assert log.report()["inside_mm"]["lid"] == pytest.approx(1e3 * found.inside["lid"])
    assert log.contact_force is None


@pytest.mark.parametrize("form", FORMS)
def test_a_body_rests_on_a_floor_with_its_weight_and_the_force_on_it(
    form: str, tmp_path: Path
) -> None:
    model, half = piston(tmp_path, form), FORMS[form][2]
    floor = HalfSpace([0, 0, 1], -0.05, name="floor", links=None if form == "none" else "all")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        log = rollout(model, np.array([-30.0]), 1.0, surroundings=Surroundings([floor]))
    assert any("only the point" in str(one.message) for one in said) == (form == "none")
    assert log.q[-1, 0] == pytest.approx(-0.05 + half, abs=INSIDE)
    np.testing.assert_allclose(log.contact_force[-1], [0, 0, 30 + 9.81 * MASS], atol=1e-3)  # type: ignore[index]
    assert log.reserve is not None
    assert np.isfinite(log.reserve).all()


def test_the_first_link_touches_too(tmp_path: Path) -> None:
    """Contacts of a base with its neighbour are excluded, those of the world's walls are not."""
    base = SHAPE.format(kind="collision", form='<box size="0.01 0.01 0.01"/>')
    model = piston(tmp_path, "collision box", base)
    around = Surroundings([KeepOutBox([0, 0, -0.1], [0.1, 0.1, 0.1], links="all")])
    log = rollout(model, np.array([-5.0]), 1.0, surroundings=around)
    assert log.q[-1, 0] == pytest.approx(-0.04, abs=INSIDE)
    # the base's own box is at the origin, and nothing else is touched
    np.testing.assert_allclose(log.contact_force[-1], [0, 0, 5 + 9.81 * MASS], atol=1e-3)  # type: ignore[index]


def test_a_start_inside_is_refused(tmp_path: Path) -> None:
    model = piston(tmp_path, "collision box")
    ball = KeepOutSphere([0, 0, 0], 0.1, links="all", name="ball")
    for options in ({}, {"rig": Rig()}):
        with refused("q0", "link 'block' 110 mm inside 'ball'") as caught:
            rollout(model, np.zeros(1), 0.1, surroundings=Surroundings([ball]), **options)
        assert caught.value.name == "q0"
    region = KeepOutSphere([0, 0, 0], 0.1, links="all", name="ball", contact=False)
    rollout(model, np.zeros(1), 0.1, surroundings=Surroundings([region]))


def test_the_log_keeps_the_forces(tmp_path: Path) -> None:
    model = piston(tmp_path, "collision box")
    around = {"half_space": [{"normal": [0, 0, 1], "offset": -0.02, "name": "floor"}]}
    log = rollout(model, np.array([-5.0]), 0.3, surroundings=around)
    log.save(tmp_path / "log.npz")
    np.testing.assert_array_equal(Log.load(tmp_path / "log.npz").contact_force, log.contact_force)  # type: ignore[arg-type]
    log.to_csv(tmp_path / "log.csv")
    assert "contact_force.floor.z (N)" in (tmp_path / "log.csv").read_text().splitlines()[0]
