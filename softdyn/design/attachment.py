"""Two robots joined into one: an arm is fixed to a link of a base."""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from lxml import etree

from softdyn.checks import did_you_mean, instance, vector
from softdyn.description.library import find
from softdyn.description.meshes import MeshError, locate
from softdyn.description.robot import Joint, Link, Origin, Robot, moving_link_of
from softdyn.description.stated_task import StatedTask, only_the_tip
from softdyn.description.urdf import parse, parse_text
from softdyn.description.urdf_writer import write
from softdyn.design.source import Design, read
from softdyn.exceptions import InputError
from softdyn.files import as_path, read_toml

Data = TypeVar("Data")
JOINED = "Joined by softdyn attach: change its parts, not this file."
REFERENCES = {"name", "link", "to", "parent", "child", "frame", "task", "joint", "leader", "tendon"}
"""Fields of a robot's data that hold the name of a link, joint, tendon and the like."""
NOTES = {"warnings", "ignored", "adopted"}
SEPARATE = NOTES | {"others", "tasks", "gravity", "forces"}
"""Tuples of a robot that `attach` does not simply put one behind the other."""


def attach(
    arm: str | Path | Robot | Design,
    base: str | Path | Robot | Design,
    link: str,
    at: Sequence[float] = (0.0,) * 6,
    *,
    prefix: str = "",
    name: str | None = None,
    folder: str | Path | None = None,
) -> Design:
    """Fix the root link of an arm to a link of a base, and return both as one robot.

    The new robot has the links, joints, shapes and springs of both, and both ``<softdyn>`` blocks.
    The base's parts come first. The tip of the new robot is the arm's. A tip of the base that does
    not carry the arm remains as a second task, before the arm's. Comments of the two files are
    lost, and so are other tools' elements inside links and joints. Gravity is that of the base.

    Parameters
    ----------
    arm, base : str, Path, Robot or Design
        A robot's name, its URDF, the TOML file of a design, or a robot that was read before, e.g.
        ``softdyn.load("ur5", annotations=file).robot``.
    link : str
        The link of the base that carries the arm.
    at : sequence of float, (6,)
        The pose of the arm's root link in the frame of `link`: x, y, z (m), then roll, pitch and
        yaw (rad).
    prefix : str
        Text before each name of the arm. It is needed if a name occurs in both robots.
    name : str, optional
        The new robot's name; by default the names of both.
    folder : str or Path, optional
        The folder of the new file. The new file names meshes below this folder; other meshes are
        copied.

    Returns
    -------
    Design
        The annotated URDF, the meshes to write beside it by their path, and key figures.

    Raises
    ------
    InputError
        For a link that the base does not have, a name that occurs in both robots, or a bad
        argument.
    UrdfError
        If a file cannot be used, or the joined robot would be none.
    """
    if not re.fullmatch(r"[\w.-]*", instance("prefix", prefix, str, "a text")):
        raise InputError("prefix", "letters, digits, _ . and -", repr(prefix))
    instance("name", name, (str, type(None)), "a text")
    instance("link", link, str, "the name of a link")
    folder = None if folder is None else as_path("folder", folder)
    x, y, z, *angles = vector("at", at, 6).tolist()
    lower, upper = _Part.of("base", base), _Part.of("arm", arm)
    names = [one.name for one in lower.robot.links]
    if link not in names:
        raise InputError("link", f"a link of {lower.robot.name}", did_you_mean(link, names))
    _check_names(lower.robot, upper.robot, prefix)
    shelf = _Shelf(None if folder is None else folder.resolve())
    one, other = lower.robot, _renamed(upper.robot, prefix, set(lower.robot.others))
    one = replace(one, links=tuple(_looking(x, lower, shelf) for x in one.links))
    other = replace(other, links=tuple(_looking(x, upper, shelf) for x in other.links))
    taken = {joint.name for joint in (*one.joints, *other.joints)}
    weld = f"{other.root}_weld"
    while weld in taken:
        weld += "_2"
    place = Origin((x, y, z), tuple(angles))
    joint = Joint(weld, "fixed", link, other.root, place)
    robot = _joined(one, other, joint, name or f"{one.name}_{prefix}{other.name}")
    text = write(robot)
    path = (folder or Path()) / f"{robot.name}.urdf"
    parse_text(text, path=path, floating=robot.floating)
    figures = {
        "mass_kg": sum(part.mass for part in robot.links),
        "degrees_of_freedom": sum(j.moves and j.mimic is None for j in robot.joints),
        "inputs": len(robot.actuators),
    }
    return Design(robot.name, text, shelf.copies, figures)


@dataclass(frozen=True)
class _Part:
    """One of the two robots, and the meshes that are on no disk yet."""

    robot: Robot
    meshes: Mapping[str, bytes] = field(default_factory=dict)

    @classmethod
    def of(cls, what: str, source: str | Path | Robot | Design) -> _Part:
        if isinstance(source, Robot):
            if source.forces:
                names = ", ".join(repr(force.name) for force in source.forces)
                raise InputError(what, "a robot without forces of one's own", names)
            return cls(source)
        if isinstance(source, str | Path):
            path = Path(source)
            if path.suffix.lower() != ".toml" or not path.is_file():
                return cls(parse(find(source)))
            source = read(read_toml(path), str(path))
        if not isinstance(source, Design):
            raise InputError(what, "a name, a file, a Robot or a Design", repr(source))
        path = Path(f"{source.name}.urdf")
        return cls(parse_text(source.text, path=path), source.meshes)

    def files(self, reference: str) -> dict[str, bytes]:
        """A mesh and the material libraries beside it, by the files' names."""
        if reference in self.meshes:
            return {Path(reference).name: self.meshes[reference]}
        path = locate(self.robot.path, reference, self.robot.root_folder)
        beside = path.parent.glob("*.mtl") if path.suffix.lower() == ".obj" else ()
        return {one.name: one.read_bytes() for one in (path, *sorted(beside)) if one.is_file()}


class _Shelf:
    """The meshes of the new robot, by their path below its folder."""

    def __init__(self, folder: Path | None) -> None:
        self.copies: dict[str, bytes] = {}
        self._folder = folder

    def place(self, part: _Part, reference: str) -> str:
        """The path of a mesh for the new file; the mesh is copied if it lies elsewhere."""
        if reference not in part.meshes:
            found = locate(part.robot.path, reference, part.robot.root_folder)
            if self._folder is not None and found.is_relative_to(self._folder):
                return found.relative_to(self._folder).as_posix()
        files = part.files(reference)
        made = [str(Path(reference).parent)] if reference in part.meshes else []
        for folder in itertools.chain(made, self._folders(part.robot.name)):
            there = {f"{folder}/{name}": content for name, content in files.items()}
            if all(self.copies.get(name, content) == content for name, content in there.items()):
                self.copies |= there
                return next(iter(there))
        raise AssertionError("folders are numbered without end")

    @staticmethod
    def _folders(robot: str) -> Iterator[str]:
        own = "meshes/" + (re.sub(r"[^\w-]+", "_", robot) or "robot")
        return (own if k == 1 else f"{own}_{k}" for k in itertools.count(1))


def _looking(link: Link, part: _Part, shelf: _Shelf) -> Link:
    """A link whose shapes name their meshes from the new place."""
    looks = []
    for look in link.looks:
        node = etree.fromstring(look)
        for mesh in node.iterfind("geometry/mesh"):
            reference = mesh.get("filename", "")
            try:
                mesh.set("filename", shelf.place(part, reference))
            except MeshError as error:  # the dynamics do not need it
                warnings.warn(f"{part.robot.path}: link {link.name!r}: {error}", stacklevel=3)
        looks.append(_spelled(node))
    return replace(link, looks=tuple(looks))


def _spelled(node: etree._Element) -> str:
    return etree.tostring(node, encoding="unicode", with_tail=False)


def _named(robot: Robot) -> dict[str, set[str]]:
    """The names in a robot, by the kind of what they name."""
    found = {
        part.name: {one.name for one in getattr(robot, part.name)}
        for part in fields(robot)
        if isinstance(getattr(robot, part.name), tuple) and part.name not in SEPARATE
    }
    return found | {"tasks": {task.name for task in robot.tasks}}


def _check_names(base: Robot, arm: Robot, prefix: str) -> None:
    """Refuse a name that occurs in both robots; the error proposes a prefix."""

    def common(prefix: str) -> list[str]:
        theirs, own = _named(base), _named(arm)
        found = [
            (kind, [name for name in sorted(own[kind]) if prefix + name in theirs[kind]])
            for kind in own
        ]
        materials = _materials(base.others)
        other = _materials(set(arm.others) - set(base.others))
        found.append(("materials", [n for n in sorted(other) if prefix + n in materials]))
        return [f"{kind} {', '.join(map(repr, same))}" for kind, same in found if same]

    if same := common(prefix):
        stem = re.sub(r"[^\w.-]+", "_", arm.name)
        tried = (f"{stem}_{k}_" if k else f"{stem}_" for k in (0, *range(2, 1000)))
        good = next((one for one in tried if not common(one)), f"{stem}_1000_")
        expected = f"a prefix with which no name occurs twice, such as {good!r}"
        raise InputError("prefix", expected, f"{prefix!r}: both have {'; '.join(same)}")


def _materials(others: Iterable[str]) -> set[str]:
    """Names of the materials among a robot's other elements."""
    nodes = map(etree.fromstring, others)
    return {str(node.get("name")) for node in nodes if node.tag == "material"}


def _renamed(arm: Robot, prefix: str, shared: set[str]) -> Robot:
    """The arm with a prefix before each name; materials that the base has, too, keep theirs."""
    if not prefix:
        return arm
    parts = {link.name for link in arm.links} | {joint.name for joint in arm.joints}
    kept = _materials(set(arm.others) & shared)

    def other(text: str) -> str:
        node = etree.fromstring(text)
        if text in shared and node.tag == "material":
            return text
        for one in node.iter(etree.Element):
            for key, value in one.attrib.items():
                if value in parts:
                    one.set(key, prefix + value)
            if one.text and one.text.strip() in parts:
                one.text = prefix + one.text.strip()
        own = node.get("name")
        if own is not None and own not in parts:
            node.set("name", prefix + own)
        return _spelled(node)

    def look(text: str) -> str:
        node = etree.fromstring(text)
        for material in node.iterfind("material"):
            if (own := material.get("name")) and own not in kept:
                material.set("name", prefix + own)
        return _spelled(node)

    found = {
        part.name: _prefixed(getattr(arm, part.name), prefix)
        for part in fields(arm)
        if isinstance(getattr(arm, part.name), tuple) and part.name not in NOTES
    }
    links = tuple(replace(link, looks=tuple(map(look, link.looks))) for link in found["links"])
    return replace(arm, **found | {
        "links": links, "others": tuple(map(other, arm.others)), "task": prefix + arm.task,
    })  # fmt: skip


def _prefixed(data: Data, prefix: str) -> Data:
    """Data with a prefix before each name in them, also inside."""
    if isinstance(data, tuple):
        return tuple(_prefixed(one, prefix) for one in data)  # type: ignore[return-value]
    if not is_dataclass(data) or isinstance(data, type):
        return data
    new: dict[str, Any] = {}
    for part in fields(data):
        value = getattr(data, part.name)
        if part.name in REFERENCES and isinstance(value, str):
            new[part.name] = value and prefix + value
        elif part.name == "joints" and all(isinstance(one, str) for one in value):
            new[part.name] = tuple(prefix + name for name in value)
        elif is_dataclass(value) or isinstance(value, tuple):
            new[part.name] = _prefixed(value, prefix)
    return replace(data, **new)


def _joined(base: Robot, arm: Robot, weld: Joint, name: str) -> Robot:
    """Both robots as one, without a file."""
    both = {
        part.name: getattr(base, part.name) + getattr(arm, part.name)
        for part in fields(base)
        if isinstance(getattr(base, part.name), tuple) and part.name not in SEPARATE
    }
    both["links"] = (*base.links, *arm.dry.links)  # the fluid is the base's
    both["joints"] = (*base.joints, weld, *arm.joints)
    both["others"] = (*base.others, *(one for one in arm.others if one not in base.others))
    comment = f"\n  {arm.name} on link {weld.parent!r} of {base.name}.\n  {JOINED}\n"
    robot = Robot(name, floating=base.floating, comment=comment, gravity=base.gravity,
        fluid=base.fluid, **both,
    )  # fmt: skip
    tasks = _tasks(base, arm, robot)
    if only_the_tip(tasks):
        return replace(robot, task=tasks[0].frame)
    return replace(robot, task=tasks[0].frame, tasks=tasks)


def _tasks(base: Robot, arm: Robot, joined: Robot) -> tuple[StatedTask, ...]:
    """The tasks of both; see `attach`."""
    own = arm.tasks or (StatedTask(arm.task, arm.task),)
    below = {joint.parent for joint in joined.chain(arm.root)}
    if base.tasks:
        carrying = tuple(task for task in base.tasks if task.frame in below)
        beside = tuple(task for task in base.tasks if task.frame not in below)
        return (*beside, *own, *carrying)
    annotated = base.tendons or base.actuators or base.sensors
    moves = base.floating or moving_link_of(base)[base.task] != base.root
    if annotated and moves and base.task not in below:
        return (StatedTask(base.task, base.task), *own)
    return own
