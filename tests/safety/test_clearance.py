"""Distances of links: derivatives by central differences, distances by MuJoCo on the twin."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement
from pathlib import Path
from shutil import copy

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import InputError, SoftModel, State
from softdyn.description.inertia import rotation_rpy
from softdyn.safety import HalfSpace, KeepOutSphere
from softdyn.safety.nearest import nearest
from softdyn.safety.obstacles import Barrier, BarrierSet, KeepOutBox, LinkPairs
from softdyn.safety.solids import Cores, Solid, ball, box, half_space
from softdyn.validation import StateMap, Twin
from tests.support.control_cases import robot
from tests.support.refused import refused
from tests.support.robots import hinge

PHALANX = Path(softdyn.__file__).parent / "robots/meshes/phalanx.stl"
SKIN = """<visual><origin xyz="0.01 0 0.02" rpy="0.3 0.2 0.1"/><geometry><mesh
filename="phalanx.stl" scale="0.06 0.01 0.02"/></geometry></visual>"""
MESHED = hinge(
    0.1, "0.03 0 0", 1e-4, child="bone", called="meshed", axis="0 1 1", limit=(-2, 2), body=SKIN
)
FAR = 9.0  # m: every pair has a row


@pytest.fixture(scope="module")
def meshed(tmp_path_factory: pytest.TempPathFactory) -> SoftModel:
    file = tmp_path_factory.mktemp("meshed") / "meshed.urdf"
    file.write_text(MESHED)
    copy(PHALANX, file.parent)
    return softdyn.load(file)


def around(model: SoftModel, rng: np.random.Generator, y: np.ndarray) -> list[Barrier]:
    """Obstacles near the middle of an arm whose tip is at y."""
    L = model.robot.length or 0.06
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    middle, about = 0.6 * y, {"links": "all", "reach": FAR}
    return [
        HalfSpace(way, float(way @ middle) - 0.3 * L, **about),
        KeepOutSphere(middle + 0.3 * L * way, 0.05 * L, **about),
        KeepOutBox(middle + 0.35 * L * way, [0.1 * L, 0.2 * L, 0.15 * L],
                   rpy=rng.normal(size=3), **about),
    ]  # fmt: skip


def slope(f: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """The derivative at 0, by central differences of the fourth order."""
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


@pytest.mark.parametrize("name", ["finger", "helix", "spirob", "meshed"])
def test_gradients_are_those_of_central_differences(name: str, meshed: SoftModel) -> None:
    model, rng, seen = (meshed if name == "meshed" else robot(name)), np.random.default_rng(0), 0
    low, high = np.maximum(model.lower, -1), np.minimum(model.upper, 1)
    for _ in range(4):
        q = model.configuration(rng.uniform(low, high) * 0.5)
        v = 0.3 * rng.normal(size=model.nv)

        def moved(t: float, q: np.ndarray = q, v: np.ndarray = v) -> State:
            return model.state(model.integrate(q, t * v), v)

        state = model.state(q, v)
        barriers = around(model, rng, 0.7 * state.y if name != "meshed" else np.array([0.1, 0, 0]))
        if name not in ("helix", "meshed"):
            barriers.append(LinkPairs(reach=FAR))
        for barrier in barriers:
            values = barrier(state)
            deepest = values.b.argmin()
            assert barrier.reserve(state) == pytest.approx(values.b[deepest], abs=1e-12)
            if values.b[deepest] < 1e-4:
                continue
            # on a face or line the gradient is a mean of those of its corners
            seen += 1
            rate = float(slope(lambda t, one=barrier: np.array(one.reserve(moved(t))), 1e-6))
            corners = (values.gradient @ v)[values.b - values.b[deepest] < 1e-7]
            assert corners.min() - 1e-7 < rate < corners.max() + 1e-7
    assert seen > 3


SHAPES = {
    "ball": ball(np.zeros(3), 0.03),
    "box": box(np.eye(3), np.zeros(3), np.array([0.03, 0.02, 0.04])),
    "cylinder": Solid(coal.Cylinder(0.02, 0.09), np.eye(3), np.zeros(3),
                      np.array([0.02, 0.02, 0.045]), True, 0.0, 0.05),
    "half-space": half_space(np.array([0.0, 0.6, 0.8]), 0.0),
}  # fmt: skip


@pytest.mark.parametrize(("one", "two"), list(combinations_with_replacement(list(SHAPES), 2))[:-1])
def test_the_normal_is_the_gradient_of_the_distance(one: str, two: str) -> None:
    rng = np.random.default_rng(5)
    A, B = SHAPES[one], SHAPES[two]
    turns = [pin.exp3(rng.normal(size=3)) @ solid.rotation for solid in (A, B) for _ in range(30)]
    for RA, RB in zip(turns[:30], turns[30:], strict=True):
        at = rng.normal(size=3)
        at *= rng.uniform(0.07, 0.15) / np.linalg.norm(at)
        if two == "half-space":
            at = RB[:, 2] * 0.1 + rng.normal(size=3) * 0.01

        def distance(move: np.ndarray, RA: np.ndarray = RA, at: np.ndarray = at,
                     RB: np.ndarray = RB) -> float:  # fmt: skip
            return nearest((A, RA, at + move), (B, RB, np.zeros(3))).distance

        found = nearest((A, RA, at), (B, RB, np.zeros(3)))
        if found.distance > 1e-3:
            numeric = [slope(lambda t, x=x: np.array(distance(t * x)), 1e-5) for x in np.eye(3)]
            np.testing.assert_allclose(found.normal, numeric, rtol=0, atol=1e-7)


def test_heights_bound_the_distance_after_a_step() -> None:
    # the row's prediction h + t ḣ + t²/2 ḧ of the least height is below the distance, to O(t³)
    model, rng = robot("finger"), np.random.default_rng(3)
    for _ in range(20):
        q = model.configuration(rng.uniform(-0.6, 0.6, 4))
        v, t = 2.0 * rng.normal(size=4), 2e-3
        state = model.state(q, v)
        later = model.state(model.integrate(q, t * v), v)
        for barrier in (*around(model, rng, state.y), LinkPairs(reach=FAR)):
            b, G, drift, _ = barrier(state)
            if b.min() > 1e-3:
                least = (b + t * (G @ v) + t * t / 2 * drift).min()
                assert barrier.reserve(later) > least - 1e-6


class Surrounded(Twin):
    """A twin among the obstacles of `around`, with the meshed link's mesh."""

    there: list[Barrier]

    def amend(self, spec: mujoco.MjSpec) -> None:
        """Add them as geoms, from their plain numbers."""
        spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-13, 300
        kinds = mujoco.mjtGeom
        wall, one, crate = self.there
        turned = np.empty(4)
        plane = spec.worldbody.add_geom(type=kinds.mjGEOM_PLANE, size=(1, 1, 1))
        mujoco.mju_quatZ2Vec(turned, wall.normal)
        plane.name, plane.pos, plane.quat = "0", wall.offset * wall.normal, turned
        spec.worldbody.add_geom(
            type=kinds.mjGEOM_SPHERE, size=(one.radius, 0, 0), pos=one.centre, name="1"
        )
        mujoco.mju_mat2Quat(turned, rotation_rpy(tuple(crate.rpy)).ravel())
        spec.worldbody.add_geom(
            type=kinds.mjGEOM_BOX, size=crate.size / 2, pos=crate.centre, quat=turned, name="2"
        )
        if self.robot.name == "meshed":
            spec.add_mesh(name="m", file=str(PHALANX), scale=(0.06, 0.01, 0.02))
            mujoco.mju_mat2Quat(turned, rotation_rpy((0.3, 0.2, 0.1)).ravel())
            spec.body("bone").add_geom(
                type=kinds.mjGEOM_MESH, meshname="m", pos=(0.01, 0, 0.02), quat=turned
            )


@pytest.mark.parametrize("name", ["finger", "helix", "meshed"])
def test_distances_are_those_of_mujoco(name: str, meshed: SoftModel) -> None:
    model, rng = (meshed if name == "meshed" else robot(name)), np.random.default_rng(2)
    low, high = np.maximum(model.lower, -1), np.minimum(model.upper, 1)
    for _ in range(4):
        q = model.configuration(rng.uniform(low, high) * 0.5)
        state = model.state(q, np.zeros(model.nv))
        Surrounded.there = around(model, rng, state.y)
        twin = Surrounded(model)
        twin.set_state(*StateMap(model, twin).to_twin(q, state.v))
        theirs, data = twin.model, twin.data
        links = [k for k in range(theirs.ngeom) if theirs.geom_bodyid[k]]
        for k, barrier in enumerate(Surrounded.there):
            number = theirs.geom(str(k)).id
            found = [mujoco.mj_geomDistance(theirs, data, number, i, FAR, None) for i in links]
            least = min(found)
            if least > 0:
                tolerance = 1e-6 if name == "meshed" else 1e-9
                assert barrier.reserve(state) == pytest.approx(least, abs=tolerance)


def test_only_near_bodies_have_rows_and_a_margin_is_taken_off() -> None:
    model = robot("helix")
    state = model.state(model.q0, np.zeros(model.nv))
    wall = HalfSpace([0, 0, 1.0], float(state.y[2]) - 0.02, links="all")
    near = wall(state)
    assert 0 < len(near.b) < 12 * 8
    assert near.b.min() == pytest.approx(wall.reserve(state))
    kept = HalfSpace([0, 0, 1.0], wall.offset, links="all", margin=0.004)
    assert kept(state).b.min() == pytest.approx(near.b.min() - 0.004)
    fast = model.state(model.q0, np.where(np.char.startswith(model.joint_names, "slide"), 3.0, 0.0))
    assert len(wall(fast).b) >= len(near.b)


@pytest.mark.parametrize("name", ["helix", "meshed"])
def test_barriers_together_have_the_values_of_each(name: str, meshed: SoftModel) -> None:
    model, rng = (meshed if name == "meshed" else robot(name)), np.random.default_rng(6)
    for _ in range(3):
        q = 0.3 * rng.uniform(np.maximum(model.lower, -1), np.minimum(model.upper, 1))
        state = model.state(model.configuration(q), 0.3 * rng.normal(size=model.nv))
        wall, one, crate = around(model, rng, state.y)
        near = KeepOutBox(crate.centre, crate.size, links="all", margin=0.003, rate=4.0)
        barriers = [wall, KeepOutSphere(one.centre, one.radius), one, near]
        values, whose = BarrierSet(model, barriers)(state)
        for k, alone in enumerate(barriers):
            for together, own in zip(values, alone(state), strict=True):
                size = 1.0 + np.abs(own).max(initial=0.0)
                np.testing.assert_allclose(together[whose == k], own, rtol=0, atol=1e-12 * size)


def test_a_mesh_has_as_many_points_as_corners_and_at_most_eight() -> None:
    rng = np.random.default_rng(7)
    for count in (4, 20):
        corners = rng.normal(size=(count, 3))
        solid = Solid(None, np.eye(3), np.zeros(3), np.full(3, np.nan), corners=corners)
        cores, normal = Cores.of([SHAPES["box"], solid]), rng.normal(size=(1, 3))
        found = cores.extremes(np.array([1]), normal)[0][: cores.counts[1]]
        deepest = np.sort(corners @ normal[0])[:8]
        np.testing.assert_array_equal(np.sort(found @ normal[0]), deepest)


def test_pairs_of_links_leave_neighbours_out() -> None:
    model = robot("finger")
    state = model.state(model.q0, np.zeros(4))
    every = LinkPairs(reach=FAR)(state)
    assert len(every.b) == 3 * 8  # of six pairs, three are neighbours
    named = LinkPairs([("link1", "link3"), ("link1", "link4"), ("link2", "link4")], reach=FAR)
    np.testing.assert_array_equal(np.sort(named(state).b), np.sort(every.b))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: HalfSpace([0, 0, 1], 0, links="every"), 'links: expected "all" or a list'),
        (lambda: HalfSpace([0, 0, 1], 0, links=[]), 'links: expected "all" or a list'),
        (lambda: HalfSpace([0, 0, 1], 0, links="all", link="link1"), "links: expected none beside"),
        (lambda: HalfSpace([0, 0, 1], 0, margin=-1), "margin: expected a finite number >= 0"),
        (lambda: KeepOutBox([0, 0, 0], [1, 1, 0]), "size: expected three lengths > 0"),
        (lambda: KeepOutBox([0, 0], [1, 1, 1]), "centre: expected finite numbers of shape (3,)"),
        (lambda: LinkPairs([("link1",)]), 'pairs: expected "all" or pairs of names'),
        (lambda: LinkPairs("some"), 'pairs: expected "all" or pairs of names'),
        (lambda: KeepOutBox([0, 0, 0], [1, 1, 1], name=3), "name: expected text"),
    ],
)  # fmt: skip
def test_a_misuse_is_one_line(make: Callable[[], Barrier], said: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("barrier", "place", "got"),
    [
        (HalfSpace([0, 0, 1], 0, links=["link_1"]), "links", "'link_1'; did you mean 'link1'?"),
        (HalfSpace([0, 0, 1], 0, links=["tip"]), "links", "'tip'"),
        (LinkPairs([("link1", "link9")]), "links", "'link9'; did you mean 'link4'?"),
        (LinkPairs([("link1", "link1")]), "pairs", "two that overlap by 15 mm"),
    ],
)
def test_a_misuse_that_the_robot_shows_is_one_line(barrier: Barrier, place: str, got: str) -> None:
    model = robot("finger")
    with refused(place, got):
        barrier(model.state(model.q0, np.zeros(4)))
