"""A robot's looks: the shapes that its URDF attaches to its links.

A link shows its ``<visual>`` shapes or, if it has none, its ``<collision>`` shapes. A robot without
either has no shapes here; `softdyn.view.scene` then draws its joints and links as sticks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

from softdyn.description.meshes import Mesh, MeshError, locate
from softdyn.description.meshes import read as read_mesh
from softdyn.description.origins import read_origin
from softdyn.description.robot import Robot
from softdyn.description.strict_xml import Element, read, read_bytes

Rgba = tuple[float, ...]
GREY: Rgba = (0.62, 0.64, 0.68, 1.0)
KINDS = "visual", "collision"
MAX_SIZE = 1e4  # m; larger shapes cannot be shown beside a robot in a page's float32


@dataclass(frozen=True)
class BoxShape:
    """A box with edges `size` (m), centred."""

    size: tuple[float, float, float]


@dataclass(frozen=True)
class CylinderShape:
    """A cylinder along z, centred (m)."""

    radius: float
    length: float


@dataclass(frozen=True)
class SphereShape:
    """A sphere (m), centred."""

    radius: float


Shape = BoxShape | CylinderShape | SphereShape | Mesh


@dataclass(frozen=True, eq=False)
class Visual:
    """A shape on a link: `pose` (4, 4) in the link's frame, a mesh's scale included.

    The viewer draws one surface over all cylinders that are `skin`.
    """

    link: str
    pose: np.ndarray
    shape: Shape
    rgba: Rgba
    skin: bool = False


def visuals(
    robot: Robot, kinds: Sequence[str] = KINDS
) -> tuple[tuple[Visual, ...], tuple[str, ...]]:
    """The shapes of all links, and a line for each that cannot be shown.

    A link has the shapes of the first of `kinds` of which it has any.

    Raises
    ------
    UrdfError
        For a shape with an invalid number.
    """
    # the text as it was loaded, because the file may have changed since
    root = read_bytes(robot.path, robot.text.encode()) if robot.text else read(robot.path)
    named = {m.text("name"): colour for m in root.children("material") if (colour := _colour(m))}
    found: list[Visual] = []
    problems: list[str] = []
    for link in root.children("link"):
        for shape in next(filter(None, (list(link.children(kind)) for kind in kinds)), ()):
            try:
                shown = _shapes(link.text("name"), shape, named, partial(_meshes, robot))
                if not all(_reach(visual) <= MAX_SIZE for visual in shown):
                    raise MeshError(f"expected shapes within {MAX_SIZE:g} m, got a larger one")
                found += shown
            except MeshError as error:
                problems.append(f"{robot.path}: {link.label}: {error}")
    return tuple(found), tuple(dict.fromkeys(problems))


def triangles(visual: Visual) -> np.ndarray:
    """Triangles (n, 3, 3) of a shape in its link's frame; round ones are faceted."""
    import trimesh.creation

    shape = visual.shape
    if isinstance(shape, Mesh):
        found = np.asarray(shape.vertices, float)[shape.faces]
    elif isinstance(shape, BoxShape):
        found = trimesh.creation.box(shape.size).triangles
    elif isinstance(shape, CylinderShape):
        found = trimesh.creation.cylinder(shape.radius, shape.length, sections=24).triangles
    else:
        found = trimesh.creation.icosphere(2, shape.radius).triangles
    return np.asarray(found) @ visual.pose[:3, :3].T + visual.pose[:3, 3]


def _reach(visual: Visual) -> float:
    """An upper bound of the distance of a shape's points from its link's origin (m).

    It is NaN if one of the shape's numbers is.
    """
    shape = visual.shape
    if isinstance(shape, Mesh):
        radius = float(np.linalg.norm(np.abs(shape.vertices).max(axis=0)))
    elif isinstance(shape, BoxShape):
        radius = float(np.linalg.norm(shape.size))
    elif isinstance(shape, CylinderShape):
        radius = shape.radius + shape.length
    else:
        radius = shape.radius
    with np.errstate(over="ignore"):
        return float(
            np.linalg.norm(visual.pose[:3, :3], 2) * radius + np.linalg.norm(visual.pose[:3, 3])
        )


def check_shapes(root: Element) -> None:
    """Refuse a visual or collision shape with an invalid number; meshes are not opened.

    A file is refused where it is loaded, and not where its page is drawn after a run.

    Raises
    ------
    UrdfError
        It names the shape's element.
    """
    for material in root.children("material"):
        _colour(material)
    for link in root.children("link"):
        for kind in KINDS:
            for shape in link.children(kind):
                with suppress(MeshError):  # another shape, which is left out of a page
                    _shapes("", shape, {}, lambda _: ())


def _meshes(robot: Robot, reference: str) -> tuple[Mesh, ...]:
    return read_mesh(locate(robot.path, reference, robot.root_folder))


def _shapes(
    link: str,
    element: Element,
    named: dict[str, Rgba],
    meshes: Callable[[str], tuple[Mesh, ...]],
) -> list[Visual]:
    """The shapes of one ``<visual>`` or ``<collision>``; `meshes` reads a file's parts."""
    pose = np.eye(4)
    origin = read_origin(element)
    pose[:3, :3], pose[:3, 3] = origin.rotation, origin.translation
    material = element.child("material")
    rgba = None
    if material is not None:
        rgba = _colour(material) or named.get(material.node.get("name", ""))
    geometry = element.child("geometry")
    if geometry is None:
        return []
    mesh = geometry.child("mesh")
    if mesh is not None:
        pose = pose @ np.diag([*mesh.vector("scale", (1.0, 1.0, 1.0)), 1.0])
        parts = meshes(mesh.text("filename"))
        # a colour in the URDF overrides the mesh's own
        return [Visual(link, pose, part, rgba or part.rgba or GREY) for part in parts]
    shape: Shape
    if (box := geometry.child("box")) is not None:
        x, y, z = box.vector("size")
        shape = BoxShape((x, y, z))
    elif (cylinder := geometry.child("cylinder")) is not None:
        shape = CylinderShape(
            cylinder.non_negative("radius", None), cylinder.non_negative("length", None)
        )
    elif (sphere := geometry.child("sphere")) is not None:
        shape = SphereShape(sphere.non_negative("radius", None))
    elif (capsule := geometry.child("capsule")) is not None:
        radius, length = (capsule.non_negative(name, None) for name in ("radius", "length"))
        return [Visual(link, pose @ at, part, rgba or GREY) for part, at in _parts(radius, length)]
    else:
        raise MeshError(
            "expected a <box>, <cylinder>, <sphere>, <capsule> or <mesh>, got another shape"
        )
    return [Visual(link, pose, shape, rgba or GREY, element.node.get("name") == "skin")]


def _parts(radius: float, length: float) -> Iterator[tuple[Shape, np.ndarray]]:
    """A capsule as a cylinder with a sphere at either end."""
    if length > 0:
        yield CylinderShape(radius, length), np.eye(4)
    for z in (-length / 2, length / 2) if length > 0 else (0.0,):
        at = np.eye(4)
        at[2, 3] = z
        yield SphereShape(radius), at


def _colour(material: Element) -> Rgba | None:
    colour = material.child("color")
    if colour is None:
        return None
    words = colour.text("rgba").split()
    if len(words) != 4:
        raise colour.error("four numbers as rgba", repr(colour.node.get("rgba")))
    return tuple(min(max(colour.to_number(word, "rgba"), 0.0), 1.0) for word in words)
