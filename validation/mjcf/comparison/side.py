"""One file of a robot, opened once, with all views that a comparison, an engine or a page needs."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import mujoco

from softdyn.description.library import bundled_name, find
from softdyn.description.robot import Robot
from softdyn.description.urdf import parse
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel
from softdyn.validation.mjcf.comparison.from_mjcf import compile_mjcf, from_mjcf
from softdyn.validation.mjcf.comparison.from_urdf import from_urdf
from softdyn.validation.mjcf.comparison.neutral import Neutral
from softdyn.validation.mjcf.compiled_rig import sensors_of
from softdyn.validation.mjcf.mjcf_file import Contents, Mjcf, is_mjcf, read_mjcf

DIGITS = 6
NUMBER = re.compile(r"[+-]?(\d*)\.?(\d*)(?:[eE][+-]?\d+)?")  # integer and decimal digits


@dataclass(frozen=True, eq=False)
class Side:
    """A file and its views; each view is made at its first use, and kept.

    Attributes
    ----------
    path : Path
        The file.
    contents : Contents
        The file, its includes and its meshes, as first opened.
    floating : bool
        Whether a URDF's root link moves freely, which the format cannot state.
    repair_inertia : bool
        Whether a URDF's impossible inertias become the nearest possible ones.
    """

    path: Path
    contents: Contents = field(default_factory=Contents, repr=False)
    floating: bool = False
    repair_inertia: bool = False

    @classmethod
    def of(
        cls, source: str | Path | Side, contents: Contents | None = None, **options: bool
    ) -> Side:
        """The side of a path or a name; a `Side` is returned unchanged.

        Raises
        ------
        InputError
            For a name that is no robot's.
        """
        if isinstance(source, Side):
            return source
        return cls(find(source), Contents() if contents is None else contents, **options)

    @cached_property
    def is_mjcf(self) -> bool:
        """Whether the file is an MJCF."""
        return is_mjcf(self.path, self.contents)

    @cached_property
    def robot(self) -> Robot:
        """The strictly parsed URDF."""
        return parse(
            self.path, content=self.contents.text(self.path), floating=self.floating,
            repair_inertia=self.repair_inertia, root=self.contents.root,
        )  # fmt: skip

    @cached_property
    def model(self) -> SoftModel:
        """The analytic model of a URDF, as from `softdyn.load`."""
        for warning in self.robot.warnings:
            warnings.warn(warning, stacklevel=2)
        return build(self.robot, None if self.floating else bundled_name(self.path))

    @cached_property
    def mjcf(self) -> Mjcf:
        """The strictly read MJCF, without elements that do not influence the dynamics."""
        return read_mjcf(self.path, contents=self.contents)

    @cached_property
    def compiled(self) -> mujoco.MjModel:
        """MuJoCo's compiled model of `mjcf`; do not change it."""
        return compile_mjcf(self.mjcf)

    @cached_property
    def scene(self) -> mujoco.MjModel:
        """MuJoCo's compiled model with all shapes and contacts; do not change it."""
        return compile_mjcf(read_mjcf(self.path, whole=True, contents=self.contents))

    @property
    def rounded(self) -> bool:
        """Whether no number of the file has more significant digits than MuJoCo saves."""
        root = self.contents.xml(self.path).node
        texts = [
            str(value) for node in root.iter("*") for value in (*node.values(), node.text or "")
        ]
        found = (NUMBER.fullmatch(word) for text in texts for word in text.split())
        return all(len("".join(m.groups()).strip("0")) <= DIGITS for m in found if m is not None)

    @cached_property
    def neutral(self) -> Neutral:
        """The robot in the neutral form."""
        if not self.is_mjcf:
            mended = [text for text in self.robot.warnings if "inertia repaired" in text]
            notes = tuple(text.removeprefix(f"{self.path}: ") for text in mended)
            return replace(from_urdf(self.robot), notes=notes, rounded=self.rounded)
        robot = replace(
            from_mjcf(self.path, self.compiled), sensors=sensors_of(self.mjcf.sensors),
            rounded=self.rounded,
        )  # fmt: skip
        # models attached through MuJoCo's specification come after the bodies beside them
        note = "attached models: the order of joints is not compared"
        attached = bool(self.mjcf.attached)
        return replace(robot, orders=(), notes=(*robot.notes, note)) if attached else robot

    def beside(self, other: Side) -> Side:
        """The same file; a URDF gets a floating base if the other file's robot has one."""
        fixed = not self.is_mjcf and not stands_free(self.neutral)
        return replace(self, floating=True) if fixed and stands_free(other.neutral) else self


def stands_free(robot: Neutral) -> bool:
    """Whether the robot has a free base; a free body beside others is an object of the scene."""
    free = [k for k, part in enumerate(robot.parts) if part.kind == "free"]
    return any(len(robot.subtree(k)) > 1 or len(robot.parts) == 1 for k in free)


def neutral(source: str | Path | Side, *, floating: bool = False) -> Neutral:
    """The neutral form of a URDF or an MJCF.

    Parameters
    ----------
    source : str, Path or Side
        A path, or an argument of `softdyn.load`.
    floating : bool
        Whether a URDF's root link moves freely, which the format cannot state.

    Raises
    ------
    UrdfError
        For a file that cannot be used.
    InputError
        For a name that is no robot's.
    """
    return Side.of(source, floating=floating).neutral
