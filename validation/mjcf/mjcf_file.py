"""The strict reader of an MJCF, before MuJoCo sees it: one text, and the meshes that it needs.

Included files are inserted here. They must lie in the folder of the main file or below it, or below
a folder that the user names. Elements without influence on the dynamics are removed: pictures,
sensors, contacts, keyframes, shapes of bodies with given inertia. So a comparison needs only the
meshes that determine inertias, and MuJoCo opens no file.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath, PureWindowsPath

from lxml import etree

from softdyn.description.strict_xml import MAX_BYTES, Element, content, read_bytes
from softdyn.exceptions import UrdfError, one_line

MAX_ELEMENTS = 100_000
MAX_COPIES = 1024  # of a <replicate>, nested ones multiplied
MAX_DEPTH = 200
MAX_FILES = 64
MAX_ATTACHED = 64  # attached models, a nested one counted each time
PLACE = "softdyn attach {}"  # name of the frame at which a model is attached
MAX_MESHES = 512 * 2**20
NOT_FINITE = re.compile(r"(?:^|\s)[+-]?(nan|inf|infinity)(?=\s|$)", re.IGNORECASE | re.ASCII)
WORDS = {"name", "class", "childclass", "file", "model", "content_type", "prefix"}
REFUSED = ("composite", "flexcomp", "flex", "plugin")
NO_PLANT = ("sensor", "keyframe", "visual", "statistic", "custom", "size", "deformable")
NO_DYNAMICS = (*NO_PLANT, "contact")
PICTURES = ("texture", "material", "skin", "camera", "light")


@dataclass(frozen=True)
class Mjcf:
    """A checked file: its text, the content of the meshes that it needs, and its sensors.

    A sensor is the name of its element and its attributes.
    """

    path: Path
    text: str
    meshes: dict[str, bytes]
    attached: tuple[Attached, ...] = ()
    sensors: tuple[tuple[str, dict[str, str]], ...] = ()


@dataclass(frozen=True)
class Attached:
    """A model attached at the named frame: one body of it, or all bodies if `body` is empty."""

    frame: str
    model: Mjcf
    body: str
    prefix: str


class Contents(dict[Path, bytes]):
    """Contents of files by resolved path; each file is opened only once.

    Includes and meshes may lie below `root`, too: a folder above the file's own.
    """

    def __init__(self, opened: Mapping[Path, bytes] | None = None, root: Path | None = None):
        super().__init__(opened or {})
        self.root = None if root is None else root.resolve()

    def text(self, path: Path, what: str = "URDF or MJCF") -> bytes:
        """The bytes of an XML file; `what` describes it in an error."""
        if (key := path.resolve()) not in self:
            self[key] = content(path, what)
        return self[key]

    def xml(self, path: Path, what: str = "MJCF") -> Element:
        """The root element, parsed strictly; every call returns a new tree."""
        return read_bytes(path, self.text(path, what))

    def mesh(self, element: Element, path: Path, most: int) -> bytes:
        """The bytes of a mesh that `element` names, of at most `most`."""
        if path not in self:
            try:
                with path.open("rb") as file:
                    found = file.read(most + 1)
            except OSError as error:
                raise element.error("a mesh to read", error.strerror or error) from None
            if len(found) > most:
                raise element.error(f"meshes of at most {MAX_MESHES} bytes", "more")
            self[path] = found
        return self[path]


def is_mjcf(path: Path, contents: Contents | None = None) -> bool:
    """Whether the root element is MJCF's; the URDF reader judges all other files."""
    contents = Contents() if contents is None else contents
    return contents.xml(path, "URDF or MJCF").tag == "mujoco"


def read_mjcf(path: Path, *, whole: bool = False, contents: Contents | None = None) -> Mjcf:
    """Read an MJCF with its includes.

    Parameters
    ----------
    path : Path
        The file.
    whole : bool
        Whether to keep all shapes and contacts, for a simulation.
    contents : Contents, optional
        Files that are already open; files opened here are added.

    Raises
    ------
    UrdfError
        The file is malformed, too large, has a number that is not finite, or has elements that a
        comparison does not support. Also if an include or a needed mesh is missing, or outside the
        file's folder and the root of `contents`.
    """
    return _read(path, _Reading(whole, Contents() if contents is None else contents))


@dataclass(frozen=True)
class _Reading:
    """Settings for reading a file and the files that it attaches.

    Attributes
    ----------
    above : tuple of Path
        Files that attach this one, directly or not.
    count : list of Path
        All files attached so far.
    wrapped : frozenset of str
        Names, in the files above, of shapes that their tendons wrap.
    """

    whole: bool
    contents: Contents
    above: tuple[Path, ...] = ()
    count: list[Path] = field(default_factory=list)
    wrapped: frozenset[str] = frozenset()


def _read(path: Path, reading: _Reading) -> Mjcf:
    root = reading.contents.xml(path)
    if root.tag != "mujoco":
        raise root.error("the root element <mujoco>", f"<{root.tag}>")
    insert_includes(root.node, path, path.resolve().parent, [path.resolve()], reading.contents)
    main = Element(path, root.node, "<mujoco>")
    _judge(main)
    reading = replace(reading, wrapped=reading.wrapped | _wrapped(root.node))
    attached = tuple(_attached(main, replace(reading, above=(*reading.above, path.resolve()))))
    folder, strip = _mesh_folder(root.node)
    nodes = root.node.iterfind("sensor/*")
    sensors = tuple((str(one.tag), {str(k): str(v) for k, v in one.items()}) for one in nodes)
    _strip(root.node, reading)
    meshes = _meshes(main, folder, strip, reading.contents)
    return Mjcf(path, etree.tostring(root.node, encoding="unicode"), meshes, attached, sensors)


def _attached(root: Element, reading: _Reading) -> Iterator[Attached]:
    """Read the models of a file, and put a frame at the place of each."""
    models: dict[str, Path] = {}
    for node in list(root.node.iter("model")):
        element = Element(root.file, node, one_line(f'<model file="{node.get("file")}">'))
        folder, name = root.file.resolve().parent, element.text("file")
        target = inside(root.file, element, folder, name, reading.contents.root)
        if target in reading.above:
            raise element.error("a model that does not attach itself", repr(node.get("file")))
        models[node.get("name") or target.stem] = target
        _remove(node)
    for k, node in enumerate(list(root.node.iter("attach"))):
        element = Element(root.file, node, one_line(f'<attach model="{node.get("model")}">'))
        if (model := element.text("model")) not in models:
            raise element.error("the name of a <model>", repr(model))
        if next(node.iterancestors("replicate"), None) is not None:
            raise element.error("no <replicate> around it", "one")
        reading.count.append(models[model])
        if len(reading.count) > MAX_ATTACHED:
            raise element.error(f"at most {MAX_ATTACHED} attached models", "more")
        child = _read(models[model], reading)
        yield Attached(PLACE.format(k), child, node.get("body", ""), node.get("prefix", ""))
        node.tag = "frame"
        node.attrib.clear()
        node.set("name", PLACE.format(k))


def inside(file: Path, element: Element, folder: Path, name: str, root: Path | None = None) -> Path:
    """The file of a `name` relative to `folder`.

    It must lie in `folder` or in `root`, also after resolving links.
    """
    absolute = PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive or "\\" in name
    try:
        target = (folder / name).resolve()
        within = any(one and target.is_relative_to(one) for one in (folder, root))
        found = not absolute and "\0" not in name and within
    except (OSError, ValueError, RuntimeError):
        found = False
    if not found:
        more = "or below --root DIR" if root is None else f"or below {one_line(root)}"
        raise element.error(f"a file in the folder of {one_line(file)}, {more}", repr(name))
    return target


def insert_includes(
    node: etree._Element, path: Path, folder: Path, opened: list[Path], contents: Contents
) -> None:
    """Replace every <include> by the children of the root element of its file.

    Parameters
    ----------
    node : lxml.etree._Element
        The root element of `path`; it is changed.
    path : Path
        The file.
    folder : Path
        The folder of the main file; included files lie in it or below it.
    opened : list of Path
        Files that are open; those opened here are added.
    contents : Contents
        Their contents.

    Raises
    ------
    UrdfError
        An included file is missing, outside the folder or included twice, or there are too many.
    """
    for place in list(node.iter("include")):
        element = Element(path, place, one_line(f'<include file="{place.get("file")}">'))
        target = inside(path, element, folder, element.text("file"), contents.root)
        if target in opened:
            raise element.error("a file that was not included before", repr(place.get("file")))
        if len(opened) >= MAX_FILES:
            raise element.error(f"at most {MAX_FILES} files", "more")
        opened.append(target)
        included = contents.xml(target).node
        insert_includes(included, target, folder, opened, contents)
        parent = place.getparent()
        if parent is None:
            raise element.error("the root element <mujoco>", "<include>")
        at = parent.index(place)
        parent[at : at + 1] = list(included)


def _judge(root: Element) -> None:
    """Refuse a tree that is too large, not finite, or not supported."""
    copies: dict[etree._Element, int] = {}
    depth: dict[etree._Element, int] = {}
    for count, node in enumerate(root.node.iter()):
        if not isinstance(node.tag, str):
            continue
        element = Element(root.file, node, one_line(f"<{node.tag}>"))
        if count >= MAX_ELEMENTS:
            raise element.error(f"at most {MAX_ELEMENTS} elements", "more")
        above = node.getparent()
        depth[node] = 0 if above is None else depth[above] + 1
        if depth[node] > MAX_DEPTH:
            raise element.error(f"at most {MAX_DEPTH} elements inside each other", "more")
        copies[node] = 1 if above is None else copies[above]
        if node.tag in REFUSED:
            said = [f'{k}="{node.get(k)}"' for k in ("type", "plugin", "name") if k in node.attrib]
            got = one_line(f"<{' '.join([node.tag, *said])}>")
            raise element.error("bodies, joints and tendons, which can be compared", got)
        if node.tag == "replicate":
            copies[node] *= max(1, int(element.number("count")))
            if copies[node] > MAX_COPIES:
                raise element.error(f"at most {MAX_COPIES} copies", copies[node])
        for name, value in node.attrib.items():
            text = str(value)
            if str(name) not in WORDS and (NOT_FINITE.search(text) or _overflows(text)):
                raise element.error(f"finite numbers as {one_line(name)}", repr(one_line(text)))


def _overflows(text: str) -> bool:
    """Whether a number in an attribute is too large for a float."""
    if "e" not in text and "E" not in text and len(text) < 300:
        return False
    for word in text.split():
        try:
            if not math.isfinite(float(word)):
                return True
        except ValueError:
            continue
    return False


def _mesh_folder(root: etree._Element) -> tuple[str, bool]:
    """The folder of meshes relative to the file, and whether folders in their names are removed."""
    folder, strip = "", False
    for compiler in root.iter("compiler"):
        folder = compiler.get("assetdir") or folder
        folder = compiler.get("meshdir") or folder
        strip = compiler.get("strippath", str(strip)).lower() == "true"
        for name in ("meshdir", "assetdir", "texturedir", "strippath"):
            _drop(compiler, name)
    return folder, strip


def _wrapped(root: etree._Element) -> set[str]:
    """Shapes that tendons wrap, by name."""
    spatial = (node for tendon in root.iter("spatial") for node in tendon.iter("geom"))
    return {str(node.get("geom")) for node in spatial}


def _strip(root: etree._Element, reading: _Reading) -> None:
    """Remove elements that do not influence the dynamics; only pictures and sensors if `whole`."""
    whole = reading.whole
    # settotalmass counts all bodies that MuJoCo keeps, and it keeps those that something names
    total = any("settotalmass" in c.attrib for c in root.iter("compiler"))
    needless = NO_PLANT if whole or total else NO_DYNAMICS
    pictures = PICTURES if whole else (*PICTURES, "hfield")
    for node in list(root):
        if not isinstance(node.tag, str) or node.tag in needless:
            root.remove(node)
    for node in list(root.iter(*pictures, etree.Comment, etree.ProcessingInstruction)):
        _remove(node)
    for node in root.iter():
        for attribute in ("material", "texture", *(() if whole else ("hfield",))):
            _drop(node, attribute)
    if whole:
        return
    by_shapes = any(c.get("inertiafromgeom") == "true" for c in root.iter("compiler"))
    # shapes in a fluid are needed, too
    by_shapes |= any("fluidshape" in geom.attrib for geom in root.iter("geom"))
    moving = bool(reading.above)  # its world body may be attached to a moving body
    for world in list(root.iter("worldbody")):
        for geom in _needless(world, moving=moving, by_shapes=by_shapes, total=total):
            name = geom.get("name")
            # copies and attached models have the name with a prefix or suffix
            copied = name and geom.get("mesh") is None and any(name in w for w in reading.wrapped)
            if not copied and name not in reading.wrapped:
                _remove(geom)
    used = {node.get("mesh") for tag in ("geom", "site") for node in root.iter(tag)}
    for mesh in list(root.iter("mesh")):
        name = mesh.get("name") or PurePosixPath(mesh.get("file") or "").stem
        above = mesh.getparent()
        if name not in used and above is not None and above.tag == "asset":
            _remove(mesh)


def _needless(
    node: etree._Element, *, moving: bool, by_shapes: bool, total: bool
) -> Iterator[etree._Element]:
    """Shapes of bodies with given inertia, and of bodies that never move."""
    own = list(_own(node))
    moving = moving or any(child.tag in ("joint", "freejoint") for child in own)
    given = any(child.tag == "inertial" for child in own) and not by_shapes
    if given or not (moving or total):
        yield from (child for child in own if child.tag == "geom")
    for child in own:
        if child.tag == "body":
            yield from _needless(child, moving=moving, by_shapes=by_shapes, total=total)


def _own(node: etree._Element) -> Iterator[etree._Element]:
    """The elements of a body, also those inside <frame> and <replicate>."""
    for child in node:
        if child.tag in ("frame", "replicate"):
            yield from _own(child)
        else:
            yield child


def _drop(node: etree._Element, attribute: str) -> None:
    if attribute in node.attrib:
        del node.attrib[attribute]


def _remove(node: etree._Element) -> None:
    above = node.getparent()
    if above is not None:
        above.remove(node)


def _meshes(root: Element, folder: str, strip: bool, contents: Contents) -> dict[str, bytes]:
    """Content of the meshes that are still named; they get new names in the text."""
    found: dict[str, bytes] = {}
    size = 0
    base = root.file.resolve().parent
    for node in root.node.iter("mesh", "hfield"):
        name = node.get("file")
        if name is None:
            continue
        element = Element(root.file, node, one_line(f'<{node.tag} file="{name}">'))
        if strip:
            name = PurePosixPath(name).name
        name_inside = str(PurePosixPath(folder) / name)
        target = inside(root.file, element, base, name_inside, contents.root)
        mesh = contents.mesh(element, target, MAX_MESHES - size)
        size += len(mesh)
        # one name per file, for all models
        key = hashlib.sha256(str(target).encode()).hexdigest()[:24] + target.suffix.lower()
        if node.get("name") is None:
            node.set("name", PurePosixPath(name).stem)
        node.set("file", key)
        found[key] = mesh
    return found


__all__ = ["MAX_BYTES", "Mjcf", "UrdfError", "is_mjcf", "read_mjcf"]
