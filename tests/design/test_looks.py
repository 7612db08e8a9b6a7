"""The shapes of an arm and a finger in their files: pieces of rod, balls, discs, contacts."""

from __future__ import annotations

import math
import tomllib
import xml.etree.ElementTree as ET
from itertools import pairwise

import numpy as np
import pytest

from softdyn import design
from tests.design.test_presets import FINGER
from tests.support.arms import EVERYTHING, RUBBER

X_AXIS = [0, math.pi / 2, 0]
ENDS = 0.1, 0.104, 0.184  # of the lower section, its plate, the upper section (m)


def radius(x: float) -> float:
    """Radius of EVERYTHING's rod at x (m)."""
    if x <= 0.1:
        return float(np.interp(x, [0, 0.05, 0.1], [0.015, 0.012, 0.012]))
    return 0.01 - 0.002 * ((x - 0.104) / 0.08) ** 2


def shapes(root: ET.Element, link: str, kind: str) -> list[tuple[str, list[float], list[float]]]:
    """Material, place and sizes of a link's shapes; a cylinder lies along x, a ball is one size."""
    found = []
    for shape in root.findall(f"link[@name='{link}']/{kind}"):
        origin, form = shape.find("origin"), shape.find("geometry")[0]
        place = [0.0] * 3
        if origin is not None:
            place = [float(x) for x in origin.get("xyz").split()]
            turn = [float(x) for x in origin.get("rpy", "0 0 0").split()]
            assert turn == pytest.approx(X_AXIS if form.tag == "cylinder" else [0, 0, 0])
        material = shape.find("material")
        sizes = [float(form.get(name)) for name in ("radius", "length") if form.get(name)]
        found.append((material.get("name") if material is not None else "", place, sizes))
    return found


def test_an_arm_looks_like_its_parts():
    stations = design.lay_out(EVERYTHING).stations
    root = ET.fromstring(design.urdf(EVERYTHING))
    rod, plates, balls = [], [], []
    for k, station in enumerate(stations):
        for color, (x, y, z), sizes in shapes(root, f"segment_{k}", "visual"):
            assert (y, z) == (0, 0)
            where = station + x
            if len(sizes) == 1:
                balls.append((k, where, sizes[0]))
            elif color == "dark":
                plates.append((where, *sizes))
            else:
                assert color == f"section_{int(where > 0.1)}_{('even', 'odd')[k % 2]}"
                rod.append((where - sizes[1] / 2, where + sizes[1] / 2))
                assert sizes[0] == pytest.approx(radius(where))
        first, last = station, np.append(stations[1:], ENDS[-1])[k]
        for _, (x, y, z), (r, length) in shapes(root, f"segment_{k}", "collision"):
            assert (y, z) == (0, 0)
            low, high = station + x - length / 2, station + x + length / 2
            ends = (
                max(first, 0 if x + station < 0.1 else 0.104),
                min(last, 0.1 if high < 0.1 else 1),
            )
            assert (low + high) / 2 == pytest.approx(sum(ends) / 2)  # in the middle of its piece
            assert high - low == pytest.approx(0.6 * (ends[1] - ends[0]))
            assert r == pytest.approx(0.96 * min(map(radius, ends)))
    rod.sort()  # it covers both sections, without gap or overlap
    steps = [(a[1], b[0]) for a, b in pairwise(rod)]
    gaps = [pair for pair in steps if abs(pair[0] - pair[1]) > 1e-12]
    assert [rod[0][0], *gaps[0], rod[-1][1]] == pytest.approx([0, *ENDS])
    assert len(gaps) == 1
    discs = [(0.104 + 0.02 * j, 0.014, 0.002) for j in (1, 2, 3, 4)]
    expected = [(-0.25 * 0.015, 1.4 * 0.015, 0.5 * 0.015), (0.102, 0.02, 0.004), *discs]
    assert np.array(plates) == pytest.approx(np.array(expected))
    assert balls.pop() == pytest.approx((len(stations) - 1, 0.184 + 0.01, 0.005))  # the payload
    assert np.array(balls) == pytest.approx(
        np.array([(k, x, 0.99 * radius(x)) for k, x in enumerate(stations) if k])
    )


def test_sections_are_told_apart_by_their_colours(tmp_path):
    sections = tuple(design.Section(0.1, 0.01, RUBBER, 1, name=f"s{k}") for k in range(5))
    root = ET.fromstring(design.urdf(design.Arm(sections)))
    colors = {
        material.get("name"): tuple(map(float, material.find("color").get("rgba").split()))
        for material in root.findall("material")
    }
    assert all(0 <= part <= 1 for color in colors.values() for part in color)
    used = {shape.get("name") for shape in root.findall("link/visual/material")}
    assert used <= colors.keys()
    for k in range(4):
        assert colors[f"section_{k}_even"] != colors[f"section_{k + 1}_even"]
        assert colors[f"section_{k}_even"] < colors[f"section_{k}_odd"]  # lighter


def test_a_finger_looks_like_its_bones():
    root = ET.fromstring(design.read(tomllib.loads(FINGER)).text)
    (palm,) = shapes(root, "palm", "visual")
    assert palm[1] == pytest.approx([-1.5 * 0.009, 0, 0])
    assert palm[2] == pytest.approx([1.5 * 0.009, 0.009])
    gone = 0.0
    for k, length in enumerate((0.045, 0.03, 0.025), 1):
        r = 0.009 - 0.002 * (gone + length / 2) / 0.1
        hinge, bone = root.findall(f"link[@name='bone_{k}']/visual")
        turn = [float(x) for x in hinge.find("origin").get("rpy").split()]
        assert turn == pytest.approx([math.pi / 2, 0, 0])  # along y, the hinge's axis
        pin = hinge.find("geometry/cylinder")
        sizes = float(pin.get("radius")), float(pin.get("length"))
        assert sizes == pytest.approx((1.1 * r, 2.2 * r))
        scale = [float(x) for x in bone.find("geometry/mesh").get("scale").split()]
        assert scale == pytest.approx([length, r, r])
        ((_, place, sizes),) = shapes(root, f"bone_{k}", "collision")
        assert place == pytest.approx([length / 2, 0, 0])
        assert sizes == pytest.approx([0.9 * r, 0.7 * length])
        gone += length
