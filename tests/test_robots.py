"""The bundled robots: generated files, geometry, and mass properties against an independent oracle.

The oracle is a MuJoCo model built directly from ``urdf/source/reference_models.json``. It uses
neither the URDF, nor its generator, nor its parser.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from lxml import etree

from tests.support import ROOT

URDF = ROOT / "urdf"
FACTS = json.loads((URDF / "source" / "reference_models.json").read_text())
TIPS = {  # nv, nu, tip at rest [m]
    "finger": (4, 2, (0.24, 0.0, 0.0)),
    "helix": (36, 9, (0.0, 0.0, -0.4425)),
    "spirob": (27, 3, (0.0, 0.0, -0.5)),
    # the reference pitches the first segment by 1.5708 rad, not pi/2
    "spirob48": (48, 3, (1.7643e-6, 0.0, -0.48038027)),
}
ROBOTS = sorted(TIPS)
TOLERANCE = 1e-11
"""Relative, of two engines on one robot."""


def annotation(name: str) -> Any:
    """Return the ``<softdyn>`` block of a bundled robot."""
    return etree.parse(URDF / f"{name}.urdf").find("softdyn")


def pin_model(name: str) -> pin.Model:
    """Return the Pinocchio model of a bundled robot, with its armature."""
    model = pin.buildModelFromUrdf(str(URDF / f"{name}.urdf"))
    armature = model.armature.copy()
    for joint in annotation(name).findall("joint"):
        armature[model.joints[model.getJointId(joint.get("name"))].idx_v] = joint.get("armature")
    model.armature = armature
    return model


def moment_arms(name: str, model: pin.Model, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lengths (m,) and their gradients (m, n) of the spatial tendons of a robot."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    lengths, gradients = [], []
    for tendon in annotation(name).findall("tendon"):
        points, jacobians = [], []
        for site in tendon.findall("site"):
            frame = model.getFrameId(site.get("link"))
            offset = np.array(site.get("xyz").split(), float)
            world = data.oMf[frame].rotation @ offset
            full = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            points.append(data.oMf[frame].translation + world)
            jacobians.append(full[:3] - pin.skew(world) @ full[3:])
        step = np.diff(points, axis=0)
        norm = np.linalg.norm(step, axis=1)
        lengths.append(norm.sum())
        gradients.append(np.einsum("ki,kin->n", step / norm[:, None], np.diff(jacobians, axis=0)))
    return np.array(lengths), np.array(gradients)


def oracle(name: str) -> mujoco.MjModel:
    """Return a MuJoCo model of a reference robot, from the collected facts alone."""
    facts = FACTS[name]
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -9.81]
    bodies = {"world": spec.worldbody}
    for b in facts["bodies"]:
        body = bodies[b["parent"]].add_body(name=b["name"], pos=b["pos"], quat=b["quat_wxyz"])
        bodies[b["name"]] = body
        body.explicitinertial = True
        body.mass, body.ipos, body.inertia = b["mass"], b["com"], b["inertia_principal"]
        body.iquat = b["inertia_quat_wxyz"]
        for j in b["joints"]:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if j["type"] == "slide" else None
            body.add_joint(
                name=j["name"],
                type=kind or mujoco.mjtJoint.mjJNT_HINGE,
                axis=j["axis"],
                armature=facts["armature"],
            )
        for s in b["sites"]:
            body.add_site(name=s["name"], pos=s["pos"])
    for t in facts["tendons"]:
        tendon = spec.add_tendon(name=t["name"])
        for point in t["path"]:
            if isinstance(point, dict):
                tendon.wrap_joint(point["joint"], point["coef"])
            else:
                tendon.wrap_site(point)
    return spec.compile()


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference relative to the largest entry."""
    return float(np.abs(a - b).max() / np.abs(b).max())


# --- the files ----------------------------------------------------------------------------------


def test_a_quarter_turn_leaves_no_rounding_in_a_tensor() -> None:
    from softdyn.robots.make_robots import tensor

    cos, sin = math.cos(math.pi / 4), math.sin(math.pi / 4)
    assert cos != sin  # rounding
    turned = tensor((1.0, 2.0, 3.0), (cos, sin, 0.0, 0.0))
    np.testing.assert_array_equal(turned, np.diag([1.0, 3.0, 2.0]))
    diagonal = tensor((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, math.tan(math.pi / 8)))  # 45 degrees about z
    np.testing.assert_allclose(diagonal, [[1.5, -0.5, 0], [-0.5, 1.5, 0], [0, 0, 3]], atol=1e-15)


def test_generator_writes_what_is_committed() -> None:
    from softdyn.robots import make_robots as module

    content = module.files()
    for name, expected in content.items():
        assert (URDF / name).read_bytes() == expected, name
    assert module.main(["--check"]) == 0
    meshes = {f"meshes/{p.name}" for p in (URDF / "meshes").iterdir()}
    assert meshes == {name for name in content if name.startswith("meshes/")}


def test_check_names_the_file_that_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from softdyn.robots import make_robots as module

    content = module.files()
    monkeypatch.setattr(module, "URDF", tmp_path)
    monkeypatch.setattr(module, "files", lambda: content)
    assert module.main([]) == 0
    assert module.main(["--check"]) == 0
    (tmp_path / "helix.urdf").write_text("<robot/>")
    capsys.readouterr()
    assert module.main(["--check"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "helix.urdf" in lines[0]


@pytest.mark.parametrize("name", ROBOTS)
def test_loads_unchanged_in_two_parsers(name: str) -> None:
    nv, nu, tip = TIPS[name]
    model = pin.buildModelFromUrdf(str(URDF / f"{name}.urdf"))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    assert model.nv == model.nq == nv
    assert len(annotation(name).findall("actuator")) == nu
    np.testing.assert_allclose(data.oMf[model.getFrameId("tip")].translation, tip, atol=1e-9)
    other = yourdfpy.URDF.load(str(URDF / f"{name}.urdf"))
    assert other.num_dofs == nv
    np.testing.assert_allclose(other.get_transform("tip", "world")[:3, 3], tip, atol=1e-9)
    assert [j.name for j in other.actuated_joints] == list(model.names)[1:]


@pytest.mark.parametrize("name", ROBOTS)
def test_file_follows_the_conventions(name: str) -> None:
    tree = etree.parse(URDF / f"{name}.urdf")
    assert tree.getroot().get("name") == name
    children = {j.find("child").get("link") for j in tree.findall("joint")}
    assert {link.get("name") for link in tree.findall("link")} - children == {"world"}
    moving = [j for j in tree.findall("joint") if j.get("type") != "fixed"]
    for joint in moving:
        limit = joint.find("limit")
        assert float(limit.get("lower")) < 0.0 < float(limit.get("upper"))
        assert float(joint.find("dynamics").get("damping")) > 0
    springs = {g.get("reference"): g.findtext("springStiffness") for g in tree.findall("gazebo")}
    assert list(springs) == [j.get("name") for j in moving]
    assert all(float(k) > 0 for k in springs.values())
    assert tree.find("softdyn").get("version") == "1"
    assert tree.find("softdyn/task").get("frame") == "tip"
    shapes = {g.tag for g in tree.findall("link/collision/geometry/*")}
    assert shapes <= {"box", "cylinder", "sphere"}
    massive = [link for link in tree.findall("link") if link.find("inertial") is not None]
    assert all(link.find("collision") is not None for link in massive)


@pytest.mark.parametrize("name", ROBOTS)
def test_inertias_are_physical(name: str) -> None:
    for inertia in etree.parse(URDF / f"{name}.urdf").findall("link/inertial/inertia"):
        xx, xy, xz, yy, yz, zz = (
            float(inertia.get(k)) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        a, b, c = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert a > 0
        assert c < a + b


@pytest.mark.parametrize("name", ROBOTS)
def test_meshes_resolve_and_are_small(name: str) -> None:
    path = URDF / f"{name}.urdf"
    model = pin.buildModelFromUrdf(str(path))
    looks = pin.buildGeomFromUrdf(
        model, str(path), pin.GeometryType.VISUAL, package_dirs=[str(URDF)]
    )
    meshes = [Path(g.meshPath) for g in looks.geometryObjects if g.meshPath.endswith(".stl")]
    assert meshes
    assert all(m.is_file() and m.resolve().parent == URDF / "meshes" for m in meshes)
    assert all(m.stat().st_size < 1_000_000 for m in meshes)
    assert len(yourdfpy.URDF.load(str(path)).scene.geometry) == looks.ngeoms
    assert sum(m.stat().st_size for m in (URDF / "meshes").iterdir()) < 2_000_000


@pytest.mark.parametrize("name", ROBOTS)
def test_contact_shapes_are_apart_at_rest(name: str) -> None:
    path = str(URDF / f"{name}.urdf")
    model = pin.buildModelFromUrdf(path)
    shapes = pin.buildGeomFromUrdf(
        model, path, pin.GeometryType.COLLISION, package_dirs=[str(URDF)]
    )
    shapes.addAllCollisionPairs()
    data = shapes.createData()
    q = pin.neutral(model)
    assert len(shapes.collisionPairs) > 0
    assert not pin.computeCollisions(model, model.createData(), shapes, data, q, False)


# --- the numbers --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["finger", "helix", "spirob48"])
def test_agrees_with_the_reference(name: str) -> None:
    """Compare mass matrix, gravity and tip of the URDF with a model built from the facts.

    Both sides normalise the nine-digit quaternions, so they agree to rounding. Every entry is
    compared relative to its own scale, so that the light tail of spirob48 counts as much as its
    base. The scale of M_ij is sqrt(M_ii M_jj) without armature; that of gravity is the joint's
    largest.
    """
    ours, theirs = pin_model(name), oracle(name)
    np.testing.assert_array_equal(ours.armature, theirs.dof_armature)
    ours.armature = np.zeros(ours.nv)
    theirs.dof_armature[:] = 0.0
    data, judge = ours.createData(), mujoco.MjData(theirs)
    tip, site = ours.getFrameId("tip"), theirs.site("ee").id
    lift = np.array([0.0, 0.0, FACTS[name]["base_height"]])
    rng = np.random.default_rng(0)
    errors: dict[str, list[float]] = {"M": [], "tip": []}
    gravity = []
    for _ in range(20):
        q = rng.uniform(-1.0, 1.0, ours.nv)
        judge.qpos[:] = q
        mujoco.mj_forward(theirs, judge)
        expected = np.zeros((ours.nv, ours.nv))
        mujoco.mj_fullM(theirs, judge, expected)
        scale = np.sqrt(np.diag(expected))
        pin.framesForwardKinematics(ours, data, q)
        mass = pin.crba(ours, data, q)
        errors["M"].append(np.abs((mass - expected) / np.outer(scale, scale)).max())
        errors["tip"].append(difference(data.oMf[tip].translation, judge.site_xpos[site] - lift))
        gravity.append((pin.computeGeneralizedGravity(ours, data, q), judge.qfrc_bias.copy()))
    g, expected_g = np.swapaxes(gravity, 0, 1)
    worst = {k: max(v) for k, v in errors.items()}
    worst["g"] = (np.abs(g - expected_g).max(axis=0) / np.abs(expected_g).max(axis=0)).max()
    print(name, worst)
    assert max(worst.values()) < TOLERANCE, worst


def test_cables_of_spirob48_agree_with_the_reference() -> None:
    ours, theirs = pin_model("spirob48"), oracle("spirob48")
    judge = mujoco.MjData(theirs)
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(10):
        q = rng.uniform(-0.5, 0.5, ours.nv)
        judge.qpos[:] = q
        mujoco.mj_forward(theirs, judge)
        expected = np.zeros((theirs.ntendon, theirs.nv))
        for i in range(theirs.ntendon):
            start, count = theirs.ten_J_rowadr[i], theirs.ten_J_rownnz[i]
            entries = slice(start, start + count)
            expected[i, theirs.ten_J_colind[entries]] = judge.ten_J.ravel()[entries]
        lengths, arms = moment_arms("spirob48", ours, q)
        worst = max(worst, difference(lengths, judge.ten_length), difference(arms, expected))
    print("cables", worst)
    assert worst < TOLERANCE


def test_finger_and_helix_inputs_act_as_in_the_reference() -> None:
    finger = {
        a.get("tendon"): (float(a.get("gear")), float(a.get("lower")), float(a.get("upper")))
        for a in annotation("finger").findall("actuator")
    }
    assert list(finger.values()) == [(0.1, *bounds) for bounds in FACTS["finger"]["input_bounds"]]
    model = pin_model("helix")
    columns = []
    for tendon in annotation("helix").findall("tendon"):
        column = np.zeros(36)
        for joint in tendon.findall("joint"):
            column[model.joints[model.getJointId(joint.get("name"))].idx_v] = joint.get("coef")
        columns.append(column)
    expected = np.kron(np.eye(3), np.kron(np.ones((4, 1)), np.eye(3)))
    np.testing.assert_array_equal(np.transpose(columns), expected)
    bounds = [(a.get("lower"), a.get("upper")) for a in annotation("helix").findall("actuator")]
    assert bounds == 3 * [("-25", "25"), ("-25", "25"), ("0", "25")]


def test_spirob_is_a_logarithmic_spiral() -> None:
    facts = FACTS["spirob"]
    ratio = facts["segment_length_ratio"]
    tree = etree.parse(URDF / "spirob.urdf")
    origins = {
        j.find("parent").get("link"): float(j.find("origin").get("xyz").split()[0])
        for j in tree.findall("joint")
        if j.find("origin") is not None and j.find("parent").get("link").startswith("segment")
    }
    lengths = np.array([origins[f"segment_{i}"] for i in range(10)])
    assert lengths.sum() == pytest.approx(facts["length_m"], rel=1e-14)
    np.testing.assert_allclose(lengths[1:] / lengths[:-1], ratio, rtol=1e-14)
    inertials = [tree.find(f"link[@name='segment_{i}']/inertial") for i in range(10)]
    masses = np.array([float(i.find("mass").get("value")) for i in inertials])
    assert masses.sum() == pytest.approx(facts["total_mass_kg"], rel=1e-14)
    np.testing.assert_allclose(masses[1:] / masses[:-1], ratio**3, rtol=1e-13)
    radii = 0.0251 * ratio ** np.arange(10)
    for inertial, m, r, length in zip(inertials, masses, radii, lengths, strict=True):
        moments = [float(inertial.find("inertia").get(k)) for k in ("ixx", "iyy", "izz")]
        across = m * (3 * r**2 + length**2) / 12
        np.testing.assert_allclose(moments, (m * r**2 / 2, across, across), rtol=1e-12)
        com = np.array(inertial.find("origin").get("xyz").split(), float)
        np.testing.assert_allclose(com, (length / 2, 0, 0), rtol=1e-14)
    for cable, degrees in zip(tree.findall("softdyn/tendon"), (0, 120, 240), strict=True):
        sites = cable.findall("site")
        assert [s.get("link") for s in sites] == [f"segment_{i // 2}" for i in range(20)]
        points = np.array([s.get("xyz").split() for s in sites], float)
        at = np.tile(facts["site_fractions_along_segment"], 10)
        r = np.repeat(radii, 2) * (1 + at * (ratio - 1))
        a = np.radians(degrees)
        expected = np.stack([at * np.repeat(lengths, 2), -r * np.sin(a), r * np.cos(a)], axis=1)
        np.testing.assert_allclose(points, expected, atol=1e-15)
    # segment_0 is welded on, pointing down
    model = pin_model("spirob")
    assert model.armature.tolist() == [facts["armature_kgm2"]] * 27
    placement = model.frames[model.getFrameId("segment_0")].placement
    np.testing.assert_allclose(placement.rotation[:, 0], (0, 0, -1), atol=1e-15)
