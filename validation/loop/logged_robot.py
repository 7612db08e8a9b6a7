"""The robot of a log, kept as the text of its files, so that later edits do not change it."""

from __future__ import annotations

from dataclasses import dataclass

from softdyn import InputError, SoftModel
from softdyn.loading import load_text


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
        SHA-256 of everything on which the dynamics depend.
    """

    path: str
    text: str
    annotations: str
    floating: bool
    bundled: str | None
    digest: str

    @classmethod
    def of(cls, model: SoftModel) -> LoggedRobot:
        """Return the robot of a model."""
        robot = model.robot
        path = str(robot.path.absolute())
        return cls(path, robot.text, robot.annotations, robot.floating, model.bundled, robot.digest)

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
            bundled=self.bundled,
        )  # fmt: skip
        self.check(found, "the text of the log's robot")
        return found

    def check(self, model: SoftModel, name: str) -> None:
        """Refuse a model of another robot, called `name`.

        Raises
        ------
        InputError
            The model is of another robot; the error names both.
        """
        if model.robot.digest != self.digest:
            raise InputError(
                name,
                f"the robot of the log, {self.path} ({self.digest[:12]})",
                f"another, {model.robot.path} ({model.robot.digest[:12]})",
            )
