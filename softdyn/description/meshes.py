"""Find a robot's mesh files in its own folder, read them, and thin them for display.

A path that leads out of the robot's package (absolute, ``../``, ``file://``, a link) is refused,
unless the user names a folder as root, and the mesh lies below that.
Textures are not read.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.description import strict_xml
from softdyn.exceptions import UrdfError

FORMATS = ("stl", "dae", "obj")
MAX_BYTES = 64 * 2**20
MAX_MATERIALS = 2**20  # bytes of one material library
LARGEST = 1e30  # m; vertices become float32
MAX_FACES = 12_000  # of one mesh; larger ones are thinned
CREASE = np.radians(35)  # faces that meet at a larger angle keep a sharp edge


class MeshError(Exception):
    """A mesh cannot be shown; the text says why."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one colour.

    Attributes
    ----------
    vertices : ndarray of float32, (n, 3)
        In m. A vertex on a sharp edge appears once for each side, so that averaged normals keep
        the edge.
    faces : ndarray of uint32, (m, 3)
        Indices of each triangle's vertices.
    rgba : tuple of float, (4,), or None
        The file's own colour, if it has one.
    """

    vertices: np.ndarray
    faces: np.ndarray
    rgba: tuple[float, float, float, float] | None


def locate(urdf: Path, reference: str, above: Path | None = None) -> Path:
    """Find the file of a mesh reference in a URDF.

    Parameters
    ----------
    urdf : Path
        The robot's file.
    reference : str
        A path relative to it, or ``package://NAME/path``. NAME is what the ``package.xml`` of a
        folder above the URDF states as ``<name>``, or else the name of such a folder. Without one,
        NAME is the URDF's own folder or the one above it.
    above : Path, optional
        A folder below which the mesh may lie, too, resolved. A package may be that folder, or one
        right in it.

    Raises
    ------
    MeshError
        If there is no such file, or if it is outside the robot's folder. That is the folder above
        the URDF with a ``package.xml``, or else the URDF's own.
    """
    folder = urdf.resolve().parent
    scheme, _, path = reference.rpartition("://")
    if scheme == "package":
        name, _, path = path.lstrip("/").partition("/")  # some write three slashes
        base = root = _package(folder, name, above)
    elif scheme or Path(path).is_absolute():
        raise MeshError(
            f"expected package:// or a path relative to {folder}, got {reference!r}"
            f"{_relative(folder, path)}"
        )
    else:
        base = folder
        packages = (f for f in (folder, *folder.parents) if (f / "package.xml").is_file())
        root = next(packages, folder)
    try:
        found = (base / path).resolve()
        inside = any(one and found.is_relative_to(one) for one in (root, above))
        if Path(path).is_absolute() or not inside:
            more = "or below --root DIR" if above is None else f"or below {above}"
            raise MeshError(f"expected a mesh inside {root}, {more}, got {reference!r}")
        if not found.is_file():
            raise MeshError(f"expected a mesh file, got none at {found}")
    except (OSError, ValueError) as error:  # a name that no system accepts
        raise MeshError(f"expected a mesh file, got {reference!r}: {error}") from None
    return found


def _relative(folder: Path, path: str) -> str:
    """How to write an absolute path to a file below a folder: a hint, or nothing."""
    try:
        inside = Path(path).resolve().relative_to(folder)
    except (OSError, ValueError):
        return ""
    return f": write {inside.as_posix()!r}"


def _package(folder: Path, name: str, root: Path | None) -> Path:
    """The package of that name above a URDF's folder; a downloaded archive has another folder."""
    above = (folder, *folder.parents)
    packages = [f for f in above if (f / "package.xml").is_file()]
    found = [f for f in packages if name and _stated_name(f / "package.xml") == name]
    found += [f for f in above if name and f.name == name and (f in above[:2] or f in packages)]
    if root is not None and name and not found:
        inside = (root / name).resolve()
        found += [f for f in (inside, root) if f.name == name and f.is_dir()]
        found = [f for f in found if f.is_relative_to(root)]
    if not found:
        said = [f"{_stated_name(f / 'package.xml')!r} of {f}" for f in packages]
        raise MeshError(
            f"expected a folder above {folder} with a package.xml that states <name>{name}</name>, "
            f"or a package, {folder} or its parent of that name, got {', '.join(said) or 'none'}"
        )
    return found[0]


def _stated_name(package: Path) -> str | None:
    """The ``<name>`` in a ``package.xml``; None if it has none or cannot be read."""
    try:
        name = strict_xml.read(package).node.findtext("name")
    except UrdfError:
        return None
    return None if name is None else name.strip()


def read(path: Path) -> tuple[Mesh, ...]:
    """The parts of a mesh file, in its own frame and in metres.

    Raises
    ------
    MeshError
        For a format that is not known or a file that cannot be read.
    """
    stamp = path.stat()
    return _read(path, stamp.st_mtime_ns, stamp.st_size)


@cache
def _read(path: Path, _modified: int, size: int) -> tuple[Mesh, ...]:
    import trimesh

    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise MeshError(f"expected a mesh as {', '.join(FORMATS)}, got {path}")
    if size > MAX_BYTES:
        raise MeshError(f"expected a mesh of at most {MAX_BYTES} bytes, got {size} in {path}")
    content = path.read_bytes()
    if kind == "dae" and re.search(rb"<!(DOCTYPE|ENTITY)", content):
        raise MeshError(f"expected a mesh without a document type, got one in {path}")
    try:
        with np.errstate(all="ignore"):  # too large numbers are refused below
            scene = trimesh.load_scene(
                io.BytesIO(content), file_type=kind, resolver=_materials(path)
            )
        scale = _unit(scene)
        parts = [_part(part, scale) for part in scene.dump() if len(getattr(part, "faces", ()))]
    except MeshError:
        raise
    except Exception as error:  # mesh readers raise exceptions of any kind on bad files
        raise MeshError(f"expected a {kind} mesh, got {type(error).__name__} in {path}") from error
    if not parts:
        raise MeshError(f"expected triangles, got none in {path}")
    return tuple(parts)


def _materials(mesh: Path) -> dict[str, bytes]:
    """The material libraries beside a Wavefront mesh, by name; its reader opens no other file."""
    if mesh.suffix.lower() != ".obj":
        return {}
    found = {
        path.name: path
        for path in mesh.parent.glob("*.mtl")
        if path.is_file() and path.resolve().parent == mesh.parent  # no pipe: it would never end
    }
    for path in found.values():
        if path.stat().st_size > MAX_MATERIALS:
            raise MeshError(f"expected at most {MAX_MATERIALS} bytes of materials, got {path}")
    return {name: path.read_bytes() for name, path in found.items()}


def _unit(scene: Any) -> float:
    """Metres per unit of a COLLADA file; 1 for formats without units."""
    for geometry in scene.geometry.values():
        found = re.fullmatch(r"([\d.eE+-]+) \* meters", str(geometry.metadata.get("units", "")))
        if found:
            return float(found[1])
    return 1.0


def _part(part: Any, scale: float) -> Mesh:
    vertices, faces = np.asarray(part.vertices, float) * scale, np.asarray(part.faces)
    if not (np.abs(vertices) < LARGEST).all():  # NaN is not
        raise MeshError(f"expected vertices within {LARGEST:g} m, got others")
    rgba = None
    if part.visual.defined and part.visual.kind in ("texture", "face", "vertex"):
        colour = np.asarray(part.visual.material.main_color if part.visual.kind == "texture"
                            else part.visual.main_color, float)  # fmt: skip
        rgba = tuple((colour / 255).tolist())
    return shown(vertices, faces, rgba)


def shown(
    vertices: np.ndarray, faces: np.ndarray, rgba: tuple[float, float, float, float] | None = None
) -> Mesh:
    """Thin the triangles and separate them at sharp edges, for display."""
    import trimesh

    if len(faces) > MAX_FACES:
        vertices, faces = _thinned(vertices, faces)
    mesh = trimesh.Trimesh(vertices, faces, process=True)  # merges equal vertices
    shaded = trimesh.graph.smooth_shade(mesh, angle=CREASE)
    return Mesh(np.asarray(shaded.vertices, np.float32), np.asarray(shaded.faces, np.uint32), rgba)


def _thinned(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge vertices within the cells of a grid that is coarse enough for `MAX_FACES`."""
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max()) or 1.0
    for cells in (160, 112, 80, 56, 40, 28, 20):
        key = ((vertices - low) / size * cells).astype(np.int64)
        _, first, where = np.unique(key, axis=0, return_index=True, return_inverse=True)
        merged = where.reshape(-1)[faces]
        a, b, c = merged.T
        kept = merged[(a != b) & (b != c) & (c != a)]
        if len(kept) <= MAX_FACES:
            break
    counts = np.bincount(where.reshape(-1), minlength=len(first))[:, None]
    sums = np.stack([np.bincount(where.reshape(-1), column) for column in vertices.T], axis=1)
    return sums / counts, kept
