"""The visuals of a robot: shapes, colours, scales, and meshes that stay inside its folder."""

from __future__ import annotations

import os

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import softdyn
from softdyn.description.library import find
from softdyn.description.meshes import MAX_FACES, MeshError, locate
from softdyn.description.visuals import (
    BoxShape,
    CylinderShape,
    Mesh,
    SphereShape,
    triangles,
    visuals,
)
from softdyn.exceptions import UrdfError
from tests.support import robots
from tests.support.command import command
from tests.support.robots import TURRET, hinge, write


def robot(folder, body: str, head: str = "", name: str = "robot.urdf"):
    text = hinge(1, None, 1, body=body, child="a").replace("<link", f"{head}<link", 1)
    return softdyn.parse(write(folder, text, name))


def test_primitives_poses_and_colours(tmp_path):
    found, problems = visuals(robot(
        tmp_path,
        '<visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/>'
        '<geometry><box size="1 2 3"/></geometry><material name="red"/></visual>'
        '<visual><geometry><cylinder radius="0.1" length="0.4"/></geometry>'
        '<material name="own"><color rgba="-1 1.5 0 0.5"/></material></visual>'
        '<visual><geometry><sphere radius="0.2"/></geometry></visual>'
        '<collision><geometry><sphere radius="9"/></geometry></collision>',
        '<material name="red"><color rgba="1 0 0 1"/></material>',
    ))  # fmt: skip
    assert problems == ()
    box, cylinder, sphere = found
    assert (box.shape, cylinder.shape, sphere.shape) == (
        BoxShape((1.0, 2.0, 3.0)), CylinderShape(0.1, 0.4), SphereShape(0.2),
    )  # fmt: skip
    assert (box.rgba, cylinder.rgba) == ((1, 0, 0, 1), (0, 1, 0, 0.5))
    np.testing.assert_allclose(box.pose[:3, 0], [0, 1, 0], atol=1e-12)
    corners = triangles(box).reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0), [0, 1.5, 1.5], atol=1e-9)
    np.testing.assert_allclose(corners.max(axis=0), [2, 2.5, 4.5], atol=1e-9)


def test_collision_shapes_stand_in_for_missing_visuals(tmp_path):
    found, _ = visuals(
        robot(tmp_path, '<collision><geometry><sphere radius="0.3"/></geometry></collision>')
    )
    assert [shape.shape for shape in found] == [SphereShape(0.3)]


@pytest.mark.parametrize("reference", [
    "/etc/passwd", "../secret.stl", "file:///etc/passwd", "package://../secret.stl",
    "package://robot/../secret.stl", "package://robot/link.stl", "link.stl", "http://x/y.stl",
    "package:///etc/passwd", "a\0b.stl", "package://etc/passwd",
])  # fmt: skip
def test_a_mesh_outside_the_robot_s_folder_is_never_opened(tmp_path, reference):
    folder = tmp_path / "robot"
    folder.mkdir()
    trimesh.creation.box().export(tmp_path / "secret.stl")
    os.symlink(tmp_path / "secret.stl", folder / "link.stl")
    with pytest.raises(MeshError, match="expected "):
        locate(folder / "robot.urdf", reference)


def test_meshes_of_a_package_are_found_beside_its_urdf_folder(tmp_path):
    package = tmp_path / "my_robot"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").touch()
    trimesh.creation.box((1, 2, 3)).export(package / "box.stl")
    urdf = package / "urdf" / "r.urdf"
    for reference in ("../box.stl", "package://my_robot/box.stl"):
        assert locate(urdf, reference) == package / "box.stl"


def test_a_package_has_the_name_in_its_package_xml(tmp_path):
    """A downloaded archive is called my_arm-main, and may hold a folder of the package's name."""
    package = tmp_path / "my_arm-main"
    (package / "my_arm").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name> my_arm\n</name></package>")
    trimesh.creation.box((1, 2, 3)).export(package / "box.stl")
    for folder in (package / "my_arm", package / "urdf", package):
        for name in ("my_arm", "my_arm-main"):
            assert locate(folder / "r.urdf", f"package://{name}/box.stl") == package / "box.stl"
    with pytest.raises(MeshError, match=r"<name>your_arm</name>.*got 'my_arm' of .*my_arm-main"):
        locate(package / "r.urdf", "package://your_arm/box.stl")
    with pytest.raises(MeshError, match="inside"):
        locate(package / "r.urdf", "package://my_arm/../box.stl")
    for broken in ("<package/>", "<package>", '<!DOCTYPE p [<!ENTITY e "my_arm">]><p>&e;</p>'):
        (package / "package.xml").write_text(broken)
        with pytest.raises(MeshError, match="states <name>my_arm</name>"):
            locate(package / "r.urdf", "package://my_arm/box.stl")


def test_a_package_without_a_package_xml_is_the_urdf_s_folder_or_the_next(tmp_path):
    folder = tmp_path / "far" / "robots" / "urdf"
    folder.mkdir(parents=True)
    for base in (tmp_path / "far", tmp_path / "far" / "robots", folder):
        trimesh.creation.box().export(base / "box.stl")
    for name in ("urdf", "robots"):
        assert locate(folder / "r.urdf", f"package://{name}/box.stl").parent.name == name
    with pytest.raises(MeshError, match=r"a package.xml that states <name>far</name>, or"):
        locate(folder / "r.urdf", "package://far/box.stl")
    (tmp_path / "far" / "package.xml").touch()
    assert locate(folder / "r.urdf", "package://far/box.stl") == tmp_path / "far" / "box.stl"


def problem(folder, geometry: str) -> str:
    found, problems = visuals(robot(folder, f"<visual><geometry>{geometry}</geometry></visual>"))
    assert found == ()
    (line,) = problems
    return line


def test_materials_are_small_files(tmp_path):
    trimesh.creation.box().export(tmp_path / "box.obj")
    os.mkfifo(tmp_path / "pipe.mtl")  # nobody writes to it
    body = '<visual><geometry><mesh filename="box.obj"/></geometry></visual>'
    assert visuals(robot(tmp_path, body))[1] == ()
    with open(tmp_path / "large.mtl", "wb") as file:
        file.truncate(2**30)
    os.utime(tmp_path / "box.obj")  # what was read once is kept
    assert "bytes of materials, got" in problem(tmp_path, '<mesh filename="box.obj"/>')


def test_shapes_beyond_all_bounds_are_not_shown(tmp_path):
    large = "v 0 0 0\nv 1e300 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "large.obj").write_text(large)
    (tmp_path / "unit.obj").write_text(large.replace("1e300", "1"))
    for geometry in (
        '<mesh filename="large.obj"/>', '<mesh filename="unit.obj" scale="1 1e30 1"/>',
        '<box size="1 1 1e30"/>', '<cylinder radius="1" length="1e40"/>',
        '<sphere radius="1e5"/>',
    ):  # fmt: skip
        assert "expected" in problem(tmp_path, geometry)
    far = '<visual><origin xyz="0 0 1e30"/><geometry><sphere radius="1"/></geometry></visual>'
    assert "within 10000 m" in visuals(robot(tmp_path, far))[1][0]


def test_a_mesh_that_cannot_be_shown_is_a_line_and_no_error(tmp_path):
    (tmp_path / "broken.stl").write_bytes(b"solid nothing")
    (tmp_path / "bomb.dae").write_text('<!DOCTYPE a [<!ENTITY b "c">]><COLLADA/>')
    for name in ("missing.stl", "../x.stl", "broken.stl", "bomb.dae", "strange.xyz"):
        body = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
        found, problems = visuals(robot(tmp_path, body))
        assert found == ()
        assert len(problems) == 1
        assert '<link name="a">' in problems[0]
        assert "\n" not in problems[0]


def test_a_large_mesh_is_thinned_and_keeps_its_extent(tmp_path):
    ball = trimesh.creation.icosphere(6, 0.1)
    assert len(ball.faces) > 4 * MAX_FACES
    ball.export(tmp_path / "ball.stl")
    body = '<visual><geometry><mesh filename="ball.stl" scale="1 1 -2"/></geometry></visual>'
    ((visual,), _) = visuals(robot(tmp_path, body))
    assert isinstance(visual.shape, Mesh)
    assert len(visual.shape.faces) <= MAX_FACES
    extent = np.ptp(triangles(visual).reshape(-1, 3), axis=0)
    np.testing.assert_allclose(extent, [0.2, 0.2, 0.4], rtol=0.02)


@pytest.mark.parametrize("name", ["helix", "ur5", "double_pendulum"])
def test_meshes_lie_where_pinocchio_s_reader_puts_them(name):
    """STL and COLLADA, units, scales and nested transforms, against Assimp."""
    path = find(name)
    found, problems = visuals(softdyn.parse(path))
    assert problems == ()
    ours: dict[str, list] = {}
    for visual in found:
        if isinstance(visual.shape, Mesh):
            ours.setdefault(visual.link, []).append(triangles(visual).reshape(-1, 3))
    model = pin.buildModelFromUrdf(str(path))
    folders = [str(folder) for folder in path.parents if folder.name == "share"]
    geometry = pin.buildGeomFromUrdf(
        model, str(path), pin.GeometryType.VISUAL, package_dirs=[*folders, str(path.parent)]
    )
    theirs: dict[str, list] = {}
    for shape in geometry.geometryObjects:
        if not shape.meshPath.lower().endswith((".stl", ".dae")):
            continue
        frame = model.frames[shape.parentFrame]
        pose = frame.placement.inverse() * shape.placement
        points = np.asarray(shape.geometry.vertices())
        theirs.setdefault(frame.name, []).append(points @ pose.rotation.T + pose.translation)
    assert ours.keys() == theirs.keys()
    for link, parts in theirs.items():
        a, b = np.concatenate(ours[link]), np.concatenate(parts)
        size = np.ptp(b, axis=0).max()
        # thinning may cut a corner by a part of a cell
        np.testing.assert_allclose(a.min(axis=0), b.min(axis=0), atol=0.01 * size)
        np.testing.assert_allclose(a.max(axis=0), b.max(axis=0), atol=0.01 * size)


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize(
    ("shape", "element"),
    [
        ('<geometry><sphere radius="-1"/></geometry>', "<sphere>"),
        ('<geometry><box size="1 1"/></geometry>', "<box>"),
        ('<geometry><cylinder radius="1" length="wide"/></geometry>', "<cylinder>"),
        ('<geometry><capsule radius="1"/></geometry>', "<capsule>"),
        ('<geometry><mesh filename="none.stl" scale="1 1 nan"/></geometry>', "<mesh>"),
        ("<geometry><mesh/></geometry>", "<mesh>"),
        ('<origin xyz="0 0"/><geometry><sphere radius="1"/></geometry>', "<origin>"),
        ('<geometry><sphere radius="1"/></geometry><material name="red"><color rgba="1 0 0"/>'
         "</material>", "<color>"),
    ],
)  # fmt: skip
def test_a_fault_in_a_shape_is_told_where_the_file_is_loaded(tmp_path, kind, shape, element):
    with pytest.raises(UrdfError) as caught:
        robot(tmp_path, f"<{kind}>{shape}</{kind}>")
    assert f"<{kind}>" in str(caught.value)
    assert element in str(caught.value)


def test_a_run_with_a_page_that_cannot_be_drawn_writes_no_log(tmp_path):
    """The fault shows before the run, and not after it."""
    ball = '<visual><geometry><sphere radius="1"/></geometry><material name="r"><color rgba="1"/>'
    base = f'<link name="base">{ball}</material></visual></link>'
    path = robots.write(tmp_path, TURRET.replace('<link name="base"/>', base))
    log, page = tmp_path / "log.npz", tmp_path / "page.html"
    done = command("rollout", path, "--seconds", "0.01", "--log", log, "--html", page)
    assert done.code == 2
    assert "expected four numbers as rgba" in done.err
    assert not log.exists()
    assert not page.exists()


def test_how_to_write_a_mesh_is_told_and_does_not_contradict_itself(tmp_path):
    """An absolute path to a file in the robot's folder: what to write instead of it."""
    (tmp_path / "meshes").mkdir()
    mesh = tmp_path / "meshes" / "tet.stl"
    trimesh.creation.box().export(mesh)
    urdf = tmp_path / "r.urdf"
    for reference in (str(mesh), f"file://{mesh}"):
        with pytest.raises(MeshError) as caught:
            locate(urdf, reference)
        assert "inside" not in str(caught.value)
        assert "package:// or a path relative to" in str(caught.value)
        assert str(caught.value).endswith(f"got {reference!r}: write 'meshes/tet.stl'")
    assert locate(urdf, "meshes/tet.stl") == mesh
    for reference in ("/etc/passwd", "file:///opt/build/tet.stl", "model://arm/tet.stl"):
        with pytest.raises(MeshError) as caught:
            locate(urdf, reference)
        assert str(caught.value).endswith(f"got {reference!r}")
    with pytest.raises(MeshError, match="inside"):
        locate(urdf, f"../{tmp_path.name}/../tet.stl")
