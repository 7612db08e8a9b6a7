"""Pinocchio's own MJCF reader against MuJoCo: the files that it reads wrongly, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from softdyn.description.inertia import Inertia
from softdyn.description.strict_xml import Element
from softdyn.exceptions import SoftdynError, one_line
from softdyn.validation.mjcf.comparison.comparison import compare_neutral
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral, Part
from softdyn.validation.mjcf.comparison.result import Comparison
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.mjcf.mjcf_file import Contents, insert_includes, inside
from softdyn.validation.mjcf.transform import Transform
from tests.proof.mjcf.mjcf_reader import read_mjcf_by_pinocchio

EXACT = 1e-9
READ = {"base", "pose", "zero", "axis", "mass", "centre", "inertia", "armature", "gravity"}


def from_pinocchio(path: Path) -> Neutral:
    """The neutral form of Pinocchio's reading: only joints, bodies, armature and gravity.

    Raises
    ------
    UrdfError
        When Pinocchio refuses the file.
    """
    readings, gravity = read_mjcf_by_pinocchio(path)
    parts: list[Part] = []
    last = {-1: WORLD}
    for k, found in enumerate(readings):
        pose = Transform(found.rotation, found.translation)
        body: tuple[tuple[str, Inertia], ...] = ()
        if found.mass:
            body = ((found.name, Inertia(found.mass, found.com, found.tensor)),)
        above = last[found.parent]
        if found.free or found.ball:
            kind = "free" if found.free else "ball"
            point = np.zeros(3) if found.free else found.translation
            part = Part(found.name, found.name, kind, above, np.zeros(3), point, body, pose)
            parts.append(replace(part, armature=float(found.armature[0])))
        else:
            for m, (row, armature) in enumerate(zip(found.directions, found.armature, strict=True)):
                turns = bool(np.linalg.norm(row[:3]) > 0.5)
                end = m == len(found.directions) - 1
                name = found.name if len(found.directions) == 1 else f"{found.name} {m}"
                axis = row[:3] if turns else row[3:]
                point = np.cross(axis, row[3:]) if turns else found.translation
                part = Part(
                    name, found.name if end else "", "hinge" if turns else "slide", above, axis,
                    point, body if end else (), pose,
                )  # fmt: skip
                parts.append(replace(part, armature=float(armature)))
                above = len(parts) - 1
        last[k] = len(parts) - 1
    names = tuple(part.name for part in parts)
    return Neutral(path, "mjcf", tuple(parts), gravity=gravity, orders=(names,))


@dataclass(frozen=True)
class ReaderVerdict:
    """Pinocchio's reading of one MJCF compared with MuJoCo's, or why it was not compared.

    Attributes
    ----------
    file : str
        The file.
    result : Comparison or None
        MuJoCo's reading (A) against Pinocchio's (B); None if one of them cannot read the file.
    error : str
        Why they were not compared.
    includes : bool
        Whether missing parts are in files included at the top level, which the reader ignores.
    """

    file: str
    result: Comparison | None
    error: str = ""
    includes: bool = False

    @property
    def exact(self) -> bool:
        """Whether all joints are read, and M, bias, g and J agree."""
        found = self.result
        if found is None or any(found.unmatched.values()) or not found.waterfall:
            return False
        return max(found.waterfall[0].left.values()) < EXACT

    @property
    def why(self) -> str:
        """The error in words."""
        found = self.result
        if self.includes and (found is None or found.unmatched["a"]):
            return "a top-level <include> is passed over"
        if found is None:
            return self.error
        words = []
        if gone := found.unmatched["a"]:
            more = " …" if len(gone) > 2 else ""
            words.append(f"{len(gone)} joints missing ({', '.join(gone[:2])}{more})")
        kinds: dict[str, list[Any]] = {}
        for cause in found.causes:
            if cause.kind in READ and cause.weight > EXACT:
                kinds.setdefault(cause.kind, []).append(cause)
        for kind, causes in kinds.items():
            more = f" (+{len(causes) - 1})" if len(causes) > 1 else ""
            words.append(f"{kind} of {causes[0].where} {causes[0].detail}".rstrip() + more)
        return "; ".join(words)

    def to_dict(self) -> dict[str, Any]:
        """The verdict as plain data."""
        errors = self.result.waterfall[0].left if self.result and self.result.waterfall else None
        return {"file": self.file, "exact": self.exact, "errors": errors, "why": self.why}


def pinocchio_reads(source: str | Path | Side, label: str = "") -> ReaderVerdict:
    """Read an MJCF by MuJoCo and by Pinocchio, and compare.

    Pinocchio needs the path, because it opens the file and its includes itself.

    Raises
    ------
    UrdfError
        For a file that cannot be used, or that names files outside its folder.
    """
    side = Side.of(source)
    label = label or str(side.path)
    _judge_paths(side.path, side.contents)
    ours, main = side.neutral, side.contents.xml(side.path)
    own = {node.get("name") for node in main.node.iter("joint", "freejoint")}
    includes = main.node.find("include") is not None
    try:
        theirs = from_pinocchio(side.path)
    except SoftdynError as error:
        bodies = main.node.find(".//body") is not None
        return ReaderVerdict(
            label, None, str(error).partition(", got ")[2], includes and not bodies
        )
    bare = replace(ours, frames={}, cables=(), motors=(), couplings=())
    found = compare_neutral(_plain(bare), _plain(theirs))
    return ReaderVerdict(label, found, "", includes and not own.intersection(found.unmatched["a"]))


def _judge_paths(path: Path, contents: Contents) -> None:
    """Refuse a file that names a file outside its folder; Pinocchio would open it."""
    root = contents.xml(path)
    base = path.resolve().parent
    insert_includes(root.node, path, base, [path.resolve()], contents)
    folders = {""} | {
        str(value)
        for compiler in root.node.iter("compiler")
        for name, value in compiler.attrib.items()
        if name in ("meshdir", "assetdir", "texturedir")
    }
    for node in root.node.iter():
        if isinstance(node.tag, str) and (name := node.get("file")) is not None:
            element = Element(path, node, one_line(f'<{node.tag} file="{name}">'))
            for folder in folders:
                inside(path, element, base, str(PurePosixPath(folder) / name))


def _plain(robot: Neutral) -> Neutral:
    """Without body names and fields that enter none of M, bias, g, J: Pinocchio's differ."""
    parts = tuple(
        replace(
            part, pieces=tuple(("", piece) for _, piece in part.pieces), link="",
            lower=-np.pi, upper=np.pi, effort=0.0, damping=0.0, friction=0.0, stiffness=0.0,
        )
        for part in robot.parts
    )  # fmt: skip
    return replace(robot, parts=parts)
