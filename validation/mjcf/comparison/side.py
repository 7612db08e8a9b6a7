"""One file of a robot, opened once: all that a comparison, an engine or a page makes of it."""

from __future__ import annotations

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
from softdyn.validation.mjcf.mjcf_file import Contents, Mjcf, is_mjcf, read_mjcf


@dataclass(frozen=True, eq=False)
class Side:
    """A file, and what is made of it; each view is made when it is first asked for, and kept.

    Attributes
    ----------
    path : Path
        The file.
    contents : Contents
        The file, what it includes, and its meshes, as they were when they were first opened.
    floating : bool
        Whether a URDF's root link moves freely, which the format cannot say.
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
        """The file behind a path or a name; a `Side` stays what it is.

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
        """Whether it is an MJCF."""
        return is_mjcf(self.path, self.contents)

    @cached_property
    def robot(self) -> Robot:
        """A URDF, parsed strictly."""
        return parse(
            self.path, content=self.contents.text(self.path), floating=self.floating,
            repair_inertia=self.repair_inertia,
        )  # fmt: skip

    @cached_property
    def model(self) -> SoftModel:
        """A URDF's analytic model, as `softdyn.load` makes it."""
        for warning in self.robot.warnings:
            warnings.warn(warning, stacklevel=2)
        return build(self.robot, None if self.floating else bundled_name(self.path))

    @cached_property
    def mjcf(self) -> Mjcf:
        """An MJCF, read strictly, without what no dynamics depend on."""
        return read_mjcf(self.path, contents=self.contents)

    @cached_property
    def compiled(self) -> mujoco.MjModel:
        """What MuJoCo compiles of `mjcf`; not to be changed."""
        return compile_mjcf(self.mjcf)

    @cached_property
    def scene(self) -> mujoco.MjModel:
        """An MJCF as MuJoCo compiles it, all shapes and contacts kept; not to be changed."""
        return compile_mjcf(read_mjcf(self.path, whole=True, contents=self.contents))

    @cached_property
    def neutral(self) -> Neutral:
        """The robot in the neutral form."""
        if not self.is_mjcf:
            mended = [text for text in self.robot.warnings if "inertia repaired" in text]
            notes = tuple(text.removeprefix(f"{self.path}: ") for text in mended)
            return replace(from_urdf(self.robot), notes=notes)
        robot = from_mjcf(self.path, self.compiled)
        # models attached through MuJoCo's specification come after the bodies beside them
        note = "attached models: the order of joints is not compared"
        attached = bool(self.mjcf.attached)
        return replace(robot, orders=(), notes=(*robot.notes, note)) if attached else robot

    def beside(self, other: Side) -> Side:
        """The same file; a URDF floats where the other's robot does."""
        fixed = not self.is_mjcf and not stands_free(self.neutral)
        return replace(self, floating=True) if fixed and stands_free(other.neutral) else self


def stands_free(robot: Neutral) -> bool:
    """Whether the robot is on a free base; a free body beside others is an object of the scene."""
    free = [k for k, part in enumerate(robot.parts) if part.kind == "free"]
    return any(len(robot.subtree(k)) > 1 or len(robot.parts) == 1 for k in free)


def neutral(source: str | Path | Side, *, floating: bool = False) -> Neutral:
    """The neutral form of a URDF or an MJCF.

    Parameters
    ----------
    source : str, Path or Side
        A path, or what `softdyn.load` takes.
    floating : bool
        Whether a URDF's root link moves freely, which the format cannot say.

    Raises
    ------
    UrdfError
        For a file that cannot be used.
    InputError
        For a name that is no robot's.
    """
    return Side.of(source, floating=floating).neutral
