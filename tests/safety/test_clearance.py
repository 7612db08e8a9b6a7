"""Distances of links: derivatives by central differences, distances by MuJoCo on the twin."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from shutil import copy

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import InputError, SoftModel
from softdyn.controllers.barriers import HalfSpace, KeepOutSphere
from softdyn.description.inertia import rotation_rpy
from softdyn.safety.obstacles import Barrier, KeepOutBox, LinkPairs
from softdyn.validation import StateMap, Twin
from tests.support.control_cases import robot

PHALANX = Path(softdyn.__file__).parent / "robots/meshes/phalanx.stl"
MESHED = """<robot name="meshed"><link name="world"/><link name="bone"><inertial>
<origin xyz="0.03 0 0"/><mass value="0.1"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial>
<visual><origin xyz="0.01 0 0.02" rpy="0.3 0.2 0.1"/><geometry><mesh filename="phalanx.stl"
scale="0.06 0.01 0.02"/></geometry></visual></link>
<joint name="turn" type="revolute"><parent link="world"/><child link="bone"/><axis xyz="0 1 1"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>"""
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


@pytest.mark.parametrize("name", ["finger", "helix", "spirob"])
def test_gradients_and_drifts_are_those_of_central_differences(name: str) -> None:
    model, rng, seen = robot(name), np.random.default_rng(0), 0
    low, high = np.maximum(model.lower, -1), np.minimum(model.upper, 1)
    for _ in range(3):
        q = model.configuration(rng.uniform(low, high) * 0.5)
        v, a = 0.3 * rng.normal(size=model.nv), rng.normal(size=model.nv)

        def moved(t: float, q: np.ndarray = q, v: np.ndarray = v, a: np.ndarray = a) -> object:
            return model.state(model.integrate(q, t * v + t * t / 2 * a), v + t * a)

        state = model.state(q, v)
        barriers = around(model, rng, state.y)
        for barrier in (*barriers, *([LinkPairs(reach=FAR)] if name != "helix" else [])):
            b, G, drift, _ = barrier(state)
            assert barrier.reserve(state) == pytest.approx(b.min(), abs=1e-12)
            apart = b > 1e-4
            seen += int(apart.sum())
            first = slope(lambda t, one=barrier: one(moved(t)).b, 1e-5)
            np.testing.assert_allclose((G @ v)[apart], first[apart], rtol=0, atol=1e-9)
            second = slope(
                lambda t, one=barrier: one(moved(t)).gradient @ moved(t).v, 1e-5
            )  # fmt: skip
            np.testing.assert_allclose((G @ a + drift)[apart], second[apart], rtol=1e-6, atol=1e-6)
    assert seen > 20


def test_a_mesh_is_its_convex_hull(meshed: SoftModel) -> None:
    rng = np.random.default_rng(1)
    for _ in range(4):
        state = meshed.state(rng.uniform(-1, 1, 1), np.array([0.4]))
        for barrier in around(meshed, rng, np.array([0.05, 0.0, 0.02])):
            (b,), ((g,),), *_ = barrier(state)
            rate = slope(lambda t, one=barrier, q=state.q: one(meshed.state(q + t, [0.0])).b, 1e-6)
            assert b < 0 or g == pytest.approx(rate[0], abs=1e-7)


class Surrounded(Twin):
    """A twin among the obstacles of `around`, with the meshed link's mesh."""

    obstacles: list[Barrier]

    def amend(self, spec: mujoco.MjSpec) -> None:
        """Add them as geoms, from their plain numbers."""
        spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-13, 300
        kinds = mujoco.mjtGeom
        wall, one, crate = self.obstacles
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
        Surrounded.obstacles = around(model, rng, state.y)
        twin = Surrounded(model)
        twin.set_state(*StateMap(model, twin).to_twin(q, state.v))
        theirs, data = twin.model, twin.data
        links = [k for k in range(theirs.ngeom) if theirs.geom_bodyid[k]]
        for k, barrier in enumerate(Surrounded.obstacles):
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
    assert 0 < len(near.b) < 12
    assert near.b.min() == pytest.approx(wall.reserve(state))
    kept = HalfSpace([0, 0, 1.0], wall.offset, links="all", margin=0.004)
    assert kept(state).b.min() == pytest.approx(near.b.min() - 0.004)
    fast = model.state(model.q0, np.full(model.nv, 0.5))
    assert len(wall(fast).b) > len(near.b)


def test_pairs_of_links_leave_neighbours_out() -> None:
    model = robot("finger")
    state = model.state(model.q0, np.zeros(4))
    every = LinkPairs(reach=FAR)(state)
    assert len(every.b) == 3  # of six, three are neighbours
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
    ("barrier", "said"),
    [
        (HalfSpace([0, 0, 1], 0, links=["link_1"]), "did you mean 'link1'?"),
        (HalfSpace([0, 0, 1], 0, links=["tip"]), "<collision> or <visual>"),
        (LinkPairs([("link1", "link9")]), "did you mean"),
        (LinkPairs([("link1", "link1")]), "apart at q = 0"),
    ],
)
def test_a_misuse_that_the_robot_shows_is_one_line(barrier: Barrier, said: str) -> None:
    model = robot("finger")
    with pytest.raises(InputError, match=r"^(links|pairs): expected") as caught:
        barrier(model.state(model.q0, np.zeros(4)))
    assert said in str(caught.value)
