"""The robot of a log, kept as the text of its files, so that later edits do not change it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.description.robot import EARTH, Robot
from softdyn.dynamics.reduced import Basis, ReducedModel, reduce
from softdyn.loading import load_text

OPTIONAL = ("basis", "gravity")  # fields that logs of most robots do not have


def without_forces(robot: Robot) -> Robot:
    """A robot without forces of one's own."""
    return replace(robot, forces=()) if robot.forces else robot


@dataclass(frozen=True)
class LoggedRobot:
    """A robot as text, from which its model can be rebuilt.

    Attributes
    ----------
    path : str
        Path of its file; meshes lie beside it.
    text, annotations : str
        The URDF, with repaired inertias if they were repaired, and the text of a separate
        annotation file, if there was one.
    floating : bool
        Whether the root link moved freely.
    bundled : str or None
        Its name, if it was a bundled robot's own file.
    digest : str
        SHA-256 of everything on which the dynamics depend but forces of one's own, which the
        record of the run states.
    basis : dict, optional
        The fields of the `Basis` of a reduced model, with its matrix as rows.
    gravity : tuple of float, (3,), optional
        Acceleration of gravity (m/s²), if it is not 0 0 -9.81.
    """

    path: str
    text: str
    annotations: str
    floating: bool
    bundled: str | None
    digest: str
    basis: dict[str, Any] | None = None
    gravity: tuple[float, ...] | None = None

    @classmethod
    def of(cls, model: SoftModel) -> LoggedRobot:
        """Return the robot of a model."""
        robot = model.robot
        path = str(robot.path.absolute())
        basis, inner = None, model
        if isinstance(model, ReducedModel):
            basis, inner = vars(model.basis) | {"matrix": model.basis.matrix.tolist()}, model.full
        digest = without_forces(robot).digest
        return cls(
            path, robot.text, robot.annotations, robot.floating, inner.bundled, digest, basis,
            None if robot.gravity == EARTH else robot.gravity,
        )  # fmt: skip

    @property
    def table(self) -> dict[str, Any]:
        """The fields as plain data, without optional ones that are not there."""
        return {name: value for name, value in vars(self).items() if name not in OPTIONAL or value}

    def model(self) -> SoftModel:
        """Build the model from this text.

        Raises
        ------
        InputError
            There is no text, or the digest is of another text.
        UrdfError
            The text cannot be used.
        """
        if not self.text:
            raise InputError("log", "the text of its robot's file", "none")
        found = load_text(
            self.text, self.annotations, path=self.path, floating=self.floating,
            bundled=self.bundled, gravity=self.gravity,
        )  # fmt: skip
        if self.basis is not None:
            rows, joints, names = (self.basis[part] for part in ("matrix", "joints", "names"))
            found = reduce(found, Basis(np.array(rows), tuple(joints), tuple(names)))
        self.check(found, "the text of the log's robot")
        return found

    def check(self, model: SoftModel, name: str) -> None:
        """Refuse a model of another robot, called `name`.

        Raises
        ------
        InputError
            The model is of another robot; the error names both.
        """
        if without_forces(model.robot).digest != self.digest:
            raise InputError(
                name,
                f"the robot of the log, {self.path} ({self.digest[:12]})",
                f"another, {model.robot.path} ({model.robot.digest[:12]})",
            )
