"""Markers: places, camera, names, and what a wrong unit, frame or name is called."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import identification
from softdyn.dynamics.mimic import build
from softdyn.identification.markers import labels
from softdyn.identification.markers.camera import CAMERA, MarkerView, kabsch, seen_at
from softdyn.identification.markers.mistakes import check_frame, check_size, exchanged
from softdyn.identification.markers.points import Marker, marked, read_points
from softdyn.identification.outputs import compute_outputs
from tests.support.refused import refused

POINTS = """
[[point]]
name = "elbow"
link = "phalanx2"
xyz_mm = [10, 5, 0]
[[pose]]
name = "hand"
link = "phalanx4"
rpy_deg = [0, 30, 0]
"""


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


def links(model):
    return [link.name for link in model.robot.links]


def posed(finger, tmp_path):
    text = POINTS.replace("phalanx2", links(finger)[2]).replace("phalanx4", links(finger)[4])
    (tmp_path / "points.toml").write_text(text)
    return build(marked(finger.robot, read_points(tmp_path / "points.toml")))


def test_outputs_in_the_camera_s_frame_and_their_derivatives(finger, tmp_path):
    """By central differences, with the orientation as a rotation vector from the measured one."""
    model, rng = posed(finger, tmp_path), np.random.default_rng(1)
    names = [f"point.elbow.{a}" for a in "xyz"] + [f"pose.hand.{a}" for a in CAMERA] + ["tip.x"]
    data = rng.uniform(-1, 1, (1, len(names)))
    q, camera = rng.uniform(-0.5, 0.5, 4), rng.uniform(-1, 1, 6)

    def outputs(q, camera):
        out, slope = compute_outputs(model, names, q[None], np.eye(4)[None])
        view = MarkerView.of(names, camera)
        assert view.positions == (0, 3)
        assert view.rotations == (6,)
        by = view.seen(out, slope, data)
        return out[0], np.hstack((slope[0], by[0]))

    out, slope = outputs(q, camera)
    here = np.concatenate((q, camera))
    for k, e in enumerate(np.eye(10) * 1e-6):
        ahead, behind = (outputs(*np.split(here + s * e, [4]))[0] for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / 2e-6, slope[:, k], atol=1e-7)
    tip = model.state(q, np.zeros(4)).y
    assert out[-1] == pytest.approx(tip[0])  # a lone coordinate stays in the world


@pytest.mark.parametrize("seed", range(8))
def test_a_camera_never_mirrors_points_of_a_plane(seed):
    """The third singular direction of such points has no sign of its own."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(5, 3)) * [1, 1, 0] @ pin.exp3(rng.normal(size=3)).T
    camera = np.concatenate((rng.normal(size=3), rng.uniform(-1, 1, 3)))
    noisy = seen_at(camera, points) + 1e-6 * rng.normal(size=(5, 3))
    np.testing.assert_allclose(kabsch(points, noisy), camera, atol=2e-5)


def test_a_camera_from_points():
    rng = np.random.default_rng(2)
    points, camera = rng.normal(size=(9, 3)), rng.normal(size=6)
    seen = seen_at(camera, points)
    seen[3] = np.nan
    found = kabsch(points, seen)
    np.testing.assert_allclose(pin.exp3(found[3:]), pin.exp3(camera[3:]), atol=1e-12)
    np.testing.assert_allclose(found[:3], camera[:3], atol=1e-12)


def arm_points(rng, rows=12, markers=5):
    """Markers along arcs of a bent arm of 0.4 m (rows, markers, 3)."""
    s = np.linspace(0.1, 0.4, markers)
    found = []
    for _ in range(rows):
        bend, side = rng.uniform(0.5, 4), rng.uniform(-np.pi, np.pi)
        x, out = np.sin(bend * s) / bend, (1 - np.cos(bend * s)) / bend
        found.append(np.stack((out * np.cos(side), out * np.sin(side), -x), 1))
    return np.array(found)


@pytest.mark.parametrize("known", [True, False])
def test_markers_without_names(known):
    """Shuffled in each row, with gaps, noise and another model's bends."""
    rng = np.random.default_rng(4)
    points, camera = arm_points(rng), rng.normal(size=6)
    order = np.array([rng.permutation(5) for _ in points])
    seen = seen_at(camera, points + rng.normal(size=points.shape) * 0.01)
    shuffled = np.full_like(seen, np.nan)
    np.put_along_axis(shuffled, order[:, :, None], seen, 1)
    gone = shuffled.copy()
    gone[5, 2] = gone[7, 0] = np.nan
    found, there = labels.match(points, gone, camera if known else None)
    assert (found == order).mean() > 0.96
    right = labels.ordered(gone, found)
    seen_right = np.isfinite(right).all(2) & np.isfinite(labels.ordered(gone, order)).all(2)
    assert np.abs(right - seen)[seen_right].max() < 1e-12
    np.testing.assert_allclose(seen_at(there, points), seen, atol=0.05)


def test_a_moving_marker_keeps_its_name_through_gaps_and_new_names():
    rng = np.random.default_rng(5)
    t = np.arange(200) / 100
    middle = np.linspace(0, 1, 4)[None, :, None] * np.array([0.3, 0, 0])
    moved = middle + 0.1 * np.sin(3 * t)[:, None, None] * np.array([0, 1.0, 0.5])
    order = np.tile([2, 0, 3, 1], (200, 1))
    order[90:] = [1, 3, 2, 0]
    seen = np.full_like(moved, np.nan)
    np.put_along_axis(seen, order[:, :, None], moved + 1e-3 * rng.normal(size=moved.shape), 1)
    seen[50:58, 0] = seen[100:104, 2] = np.nan
    found = labels.followed(seen, t, order[0])
    known = np.isfinite(np.take_along_axis(seen, order[:, :, None], 1)).all(2)
    assert (found == order)[known].all()


def test_no_camera_from_two_markers_or_from_gaps():
    points = arm_points(np.random.default_rng(1), 3, 5)
    with refused("markers without names", "2, 3 such rows"):
        labels.match(points[:, :2], points[:, :2], None)
    gaps = points.copy()
    gaps[:, 0] = np.nan
    with refused("markers without names", "5, 0 such rows"):
        labels.match(points, gaps, None)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "millimetres"), (100, "centimetres")])
def test_other_units(factor, unit):
    points = arm_points(np.random.default_rng(6))
    check_size(points, 1.4 * points)
    with refused("markers") as caught:
        check_size(points, factor * points[:, ::-1])
    assert caught.value.got.endswith(f": {unit}?")


def test_another_frame():
    rng = np.random.default_rng(7)
    points = arm_points(rng)
    near = points + rng.normal(size=points.shape) * 0.02
    check_frame(points, near)
    with refused("markers", "markers 372 mm away: a frame that is turned by 90°?…"):
        check_frame(points, seen_at(np.array([0.1, 0, 0, np.pi / 2, 0, 0]), near))
    with refused("markers", "markers 995 mm away: a frame that is moved? --camera fit finds it"):
        check_frame(points, near + np.array([1.0, 0, 0]))


def test_exchanged_names():
    rng = np.random.default_rng(8)
    points, names = arm_points(rng), list("abcde")
    near = points + rng.normal(size=points.shape) * 0.003
    assert exchanged(names, points, near, False) == ()
    (line,) = exchanged(names, points, near[:, [0, 3, 2, 1, 4]], True)
    assert "markers b and d are probably exchanged: exchange their columns" in line
    near[4] = near[4, [0, 1, 2, 4, 3]]
    (line,) = exchanged(names, points, near, False)
    assert line == "markers d and e are probably exchanged in rows 5: --relabel"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ("p.toml", "none")),
        ("[[point]]\nname='a'", ("p.toml: [[point]] 1", "none")),
        ("[[point]]\nname='a'\nlink='b'\ns_mm=3", ("p.toml: [[point]] 1", "both")),
        (
            "[[point]]\nname='a'\nlink='b'\nxyz=[0,0,0]",
            ("p.toml: [[point]] 1: xyz", "'xyz'; did you mean 'xyz_m'?"),
        ),
        ("[[point]]\nname='a'\nlink='b'\n[[pose]]\nname='a'\nlink='b'", ("p.toml", "'a'")),
    ],
)
def test_bad_files_of_points(tmp_path, text, message):
    (tmp_path / "p.toml").write_text(text)
    with refused(*message):
        read_points(tmp_path / "p.toml")


def test_markers_that_a_robot_cannot_have(finger):
    with refused("marker 'a'", "'hand'"):
        marked(finger.robot, [Marker("a", "hand")])
    with refused("marker 'a'", "s"):
        marked(finger.robot, [Marker("a", along=0.1)])
    one = [Marker("a", links(finger)[1])]
    with refused("marker 'a'", "'a'"):
        marked(marked(finger.robot, one), one)
    assert identification.read_points is read_points
