"""Spatial inertias against clouds of point masses, whose inertia is a simple sum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import softdyn
from softdyn import UrdfError
from softdyn.description.inertia import Inertia, rotation_rpy
from softdyn.description.robot import moving_bodies
from softdyn.description.urdf import parse
from softdyn.validation import Twin, crosscheck
from tests.support import robots
from tests.support.misuses import INERTIAL
from tests.support.refused import refused

SEEDS = st.integers(0, 2**32 - 1)


def cloud(rng: np.random.Generator, count: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """Masses (k,) and places (k, 3) of points."""
    return rng.uniform(0.01, 1.0, count), rng.normal(size=(count, 3))


def of_points(masses: np.ndarray, places: np.ndarray) -> Inertia:
    """The inertia of point masses, by definition."""
    com = masses @ places / masses.sum()
    tensor = np.zeros((3, 3))
    for mass, r in zip(masses, places - com, strict=True):
        tensor += mass * (r @ r * np.eye(3) - np.outer(r, r))
    return Inertia(float(masses.sum()), com, tensor)


def rotation(rng: np.random.Generator) -> np.ndarray:
    return rotation_rpy(rng.uniform(-np.pi, np.pi, 3))


def assert_same(a: Inertia, b: Inertia) -> None:
    assert a.mass == pytest.approx(b.mass, rel=1e-14)
    np.testing.assert_allclose(a.com, b.com, atol=1e-13)
    np.testing.assert_allclose(a.tensor, b.tensor, atol=1e-12)


@given(seed=SEEDS)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_sum_is_the_inertia_of_all_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    (m, p), (n, q) = cloud(rng), cloud(rng, 3)
    both = of_points(np.concatenate((m, n)), np.concatenate((p, q)))
    assert_same(of_points(m, p) + of_points(n, q), both)
    assert_same(of_points(n, q) + of_points(m, p), both)


@given(seed=SEEDS)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_moved_body_is_the_inertia_of_moved_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, p = cloud(rng)
    turn, shift = rotation(rng), rng.normal(size=3)
    assert_same(of_points(m, p).moved(turn, shift), of_points(m, p @ turn.T + shift))


@given(seed=SEEDS)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_what_points_make_up_is_physical_and_stays_so(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for count in (1, 2, 3, 7):  # a point, a rod, a plate, a solid
        body = of_points(*cloud(rng, count))
        assert body.defect() is None
        assert body.moved(rotation(rng), rng.normal(size=3)).defect() is None
        assert (body + of_points(*cloud(rng, 2))).defect() is None


def test_no_body_is_neutral() -> None:
    body = of_points(*cloud(np.random.default_rng(0)))
    assert_same(body + Inertia.zero(), body)
    assert_same(Inertia.zero() + body, body)
    nothing = Inertia.zero() + Inertia.zero()
    assert (nothing.mass, nothing.defect()) == (0.0, None)


def diagonal(*moments: float, mass: float = 1.0) -> Inertia:
    return Inertia(mass, np.zeros(3), np.diag(moments))


@pytest.mark.parametrize(
    ("inertia", "defect"),
    [
        (diagonal(1, 1, 1), None),
        (diagonal(1, 2, 3), None),  # a plate
        (diagonal(0, 1, 1), None),  # a rod
        (diagonal(0, 0, 0), None),  # a point
        (diagonal(1, 2, 3.000002), None),  # rounded decimals
        (diagonal(1, 2, 3.0001), "1 + 2 < 3.0001"),
        (diagonal(1, 1, 2.1), "1 + 1 < 2.1"),
        (diagonal(-1, 1, 1), "not positive"),
        (diagonal(-1, -1, -1), "not positive"),
        (diagonal(1, 1, 1, mass=-1), "mass -1 kg"),
        (diagonal(1, 1, 1, mass=0), "without mass"),
        (diagonal(0, 0, 0, mass=0), None),
        (diagonal(1e-30, 1e-30, 1e-30, mass=0), "without mass"),
        (Inertia(1.0, np.zeros(3), np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]])), "not positive"),
        (diagonal(1e50, 1e50, 1e50, mass=1e50), None),
        (diagonal(1e50, 1e50, 3e50, mass=1e50), "1e+50 + 1e+50 < 3e+50"),
    ],
)
def test_defects(inertia: Inertia, defect: str | None) -> None:
    found = inertia.defect()
    assert found is None if defect is None else found is not None and defect in found


@given(rpy=st.tuples(*[st.floats(-7, 7)] * 3))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_roll_pitch_yaw_are_pinocchio_s(rpy: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(rotation_rpy(np.array(rpy)), pin.rpy.rpyToMatrix(*rpy), atol=1e-14)


def test_fixed_links_are_lumped_and_what_is_fixed_to_the_base_is_not(tmp_path) -> None:
    """Two bodies on a moving joint, each with a welded link; a third link is welded to the base."""
    names = ("base", "foot", "a", "a2", "a3", "b", "b2")
    held = {
        "foot": ("base", "fixed"),
        "a": ("foot", "revolute"),
        "a2": ("a", "fixed"),
        "a3": ("a2", "fixed"),
        "b": ("a3", "revolute"),
        "b2": ("b", "fixed"),
    }
    place = {"at": "0.1 0.2 0.3", "rpy": "0.4 -0.5 0.6"}
    joints = [
        robots.joint(f"to_{child}", parent, child, None, kind, **place)
        for child, (parent, kind) in held.items()
    ]
    bodies = [robots.tag("link", INERTIAL, name=name) for name in names]
    path = robots.write(tmp_path, robots.robot("tree", *bodies, *joints))
    bodies = moving_bodies(parse(path))
    assert list(bodies) == ["a", "b"]
    assert bodies["a"].mass == pytest.approx(0.3)
    assert bodies["b"].mass == pytest.approx(0.2)
    model = pin.buildModelFromUrdf(str(path))
    for joint, link in ((1, "a"), (2, "b")):
        np.testing.assert_allclose(bodies[link].com, model.inertias[joint].lever, atol=1e-14)
        np.testing.assert_allclose(bodies[link].tensor, model.inertias[joint].inertia, atol=1e-16)


@given(seed=SEEDS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_nearest_physical_inertia_is_the_projection(seed: int) -> None:
    """x is the nearest point of a convex set to a iff (a - x)·(y - x) <= 0 for all its points y."""
    rng = np.random.default_rng(seed)
    tensor = rng.normal(size=(3, 3))
    given_ = Inertia(2.0, rng.normal(size=3), tensor + tensor.T)
    nearest = given_.nearest_physical()
    assert nearest.defect() is None
    assert (nearest.mass, nearest.com.tolist()) == (2.0, given_.com.tolist())
    for _ in range(20):
        other = of_points(*cloud(rng, int(rng.integers(1, 5)))).tensor * 10 ** rng.uniform(-3, 1)
        gap = np.sum((given_.tensor - nearest.tensor) * (other - nearest.tensor))
        assert gap <= 1e-10 * max(1.0, np.abs(other).max())
    again = nearest.nearest_physical()
    np.testing.assert_allclose(again.tensor, nearest.tensor, atol=1e-13)


def test_what_is_physical_is_its_own_nearest() -> None:
    body = of_points(*cloud(np.random.default_rng(1)))
    np.testing.assert_allclose(body.nearest_physical().tensor, body.tensor, atol=1e-15)
    assert not diagonal(1, 1, 1, mass=0).nearest_physical().tensor.any()


def broken(folder: Path, where: str) -> Path:
    """A body `a` with `a2` welded on; the inertia of one violates the triangle inequality."""
    bad = robots.inertial(0.1, "0.1 0 0", "0.1 0.01 0 0.1 0 0.5", "0.3 0.2 -1")
    bodies = dict.fromkeys(("base", "a", "a2"), INERTIAL) | {where: bad}
    links = [robots.tag("link", body, name=name) for name, body in bodies.items()]
    return robots.write(folder, robots.robot(
        "broken", *links, robots.joint("j", "base", "a", "0 1 1"), robots.weld("a", "a2", "0 0.1 0")
    ))  # fmt: skip


@pytest.mark.parametrize("where", ["a", "a2"])
def test_a_repair_is_named_and_both_engines_read_it(where: str, tmp_path: Path) -> None:
    path = broken(tmp_path, where)
    with refused('<link name="a">', "principal moments 0.09…", by=UrdfError) as caught:
        parse(path)
    assert ("such as 'a2'" in caught.value.expected) == (where == "a2")
    before = path.read_bytes()
    with pytest.warns(UserWarning, match=f'<link name="{where}">: inertia repaired: .* -> '):
        model = softdyn.load(path, repair_inertia=True)
    assert path.read_bytes() == before
    assert all(body.defect() is None for body in moving_bodies(model.robot).values())
    result = crosscheck(model, samples=2, trajectories=False)
    assert result.passed, [(check.quantity, check.max_error) for check in result.checks]
    assert np.linalg.eigvalsh(Twin(model).model.body_inertia[1] * np.eye(3))[0] > 0


def test_nothing_sound_is_repaired(tmp_path: Path) -> None:
    path = broken(tmp_path, "base")  # which does not move
    with pytest.warns(UserWarning, match='<link name="base">: principal moments'):
        model = softdyn.load(path, repair_inertia=True)
    assert not model.robot.mended


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((2.0, 2.5, 3.0, 0.1, 0.2, 0.0), "xx, yy, zz, xy, xz, yz"),
        ((2.0, 0.1, 2.5, 0.2, 0.0, 3.0), "xx, xy, yy, xz, yz, zz"),
        ((2.0, 0.1, 0.2, 0.1, 2.5, 0.0), "row by row"),
        ((2.0, 0.0, 0.0, 2.5, 0.0, 9.0), ""),
    ],
)
def test_numbers_in_another_order_are_told(tmp_path: Path, numbers, words: str) -> None:
    body = robots.hinge(1, None, " ".join(map(str, numbers)), kind="continuous", axis="0 0 1")
    path = robots.write(tmp_path, body)
    with pytest.raises(UrdfError) as error:
        parse(path)
    assert words in error.value.got
    assert ("?" in error.value.got) is bool(words)
