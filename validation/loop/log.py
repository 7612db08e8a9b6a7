"""The record of one closed loop, its verdict, its files and its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.validation.loop import log_files, log_text
from softdyn.validation.loop.log_data import CHANNELS, LogData
from softdyn.validation.loop.repeat import experiment_of
from softdyn.validation.loop.verdict import Verdict, judge


@dataclass(frozen=True, eq=False, repr=False)
class Log(LogData):
    """The record of a closed loop, see `LogData` for its attributes, and what is made of it."""

    def __post_init__(self) -> None:
        for name in self.channels:
            check_channel_name(name)
        super().__post_init__()

    def __repr__(self) -> str:
        outcome = f"failed: {self.reason}" if self.failed else "done"
        return f"Log({self.robot}, {self.controller}, {self.steps} steps, {outcome})"

    def __str__(self) -> str:
        return self.summary()

    def plot(self, path: str | Path | None = None) -> Any:
        """Errors and inputs over time, as a Matplotlib figure that a notebook shows.

        Parameters
        ----------
        path : str or Path, optional
            A file to write it to, a PNG.

        Raises
        ------
        InputError
            When nothing can be written there.
        """
        # local, because runs need no Matplotlib
        from softdyn.validation.loop.pictures.time_figures import plot

        return plot(self, path)

    def show(self, model: SoftModel | None = None) -> Any:
        """An interactive replay page of the run, for a notebook's cell or, by ``save``, a file.

        Parameters
        ----------
        model : SoftModel, optional
            The log's robot; by default it is made from the text in the log.

        Raises
        ------
        InputError
            The model is of another robot.
        """
        from softdyn.validation.loop.pictures.replay import replay

        return replay(self, self.source.model() if model is None else model)

    def verdict(self, tolerance: float | None = None) -> Verdict:
        """Whether the run reached its reference, with settling time, effort and missed deadlines.

        Parameters
        ----------
        tolerance : float, optional
            Tolerance (m); 1 % of the robot's length by default.

        Raises
        ------
        InputError
            For a tolerance that is no number > 0.
        """
        return judge(self, tolerance)

    def report(self, tolerance: float | None = None) -> dict[str, Any]:
        """The run's figures with the keys of the commands' JSON; `tolerance` is in m."""
        return log_text.report(self, tolerance)

    def summary(
        self, beside: Mapping[str, str] | None = None, tolerance: float | None = None
    ) -> str:
        """The same figures as several lines of text.

        Parameters
        ----------
        beside : Mapping[str, str], optional
            Text after a figure, by the figure's key in `report`: ``final_error_cm``, ``mse_cm2``.
        tolerance : float, optional
            Tolerance of the `verdict` (m).
        """
        return log_text.summary(self, beside, tolerance)

    @property
    def experiment(self) -> dict[str, Any]:
        """The arguments that repeat the run: ``simulate(**log.experiment)``.

        The model is that of the log's text; controller, reference and settings are made from the
        log's `record`. `simulate` refuses a part that the record cannot make, by its name; another
        one may stand in its place: ``log.experiment | {"controller": mine}``.

        Raises
        ------
        InputError
            The log has no record, or a file of the record is missing.
        """
        return experiment_of(self.record, self.source)[0]

    def save(self, path: str | Path) -> None:
        """Write the log as a compressed NPZ file; the file appears complete or not at all.

        Raises
        ------
        InputError
            When nothing can be written there.
        """
        log_files.save_npz(path, self)

    def to_csv(self, path: str | Path) -> None:
        """Write the run as CSV (see `log_files.csv_text`), complete or not at all.

        Raises
        ------
        InputError
            When nothing can be written there, or the run has no control step.
        """
        log_files.save_csv(path, self)

    @classmethod
    def load(cls, path: str | Path) -> Log:
        """Read a log exactly as it was saved.

        Raises
        ------
        InputError
            The file cannot be read, or is not a complete, consistent log of this version.
        """
        return cls(**log_files.load_npz(path))

    @classmethod
    def from_csv(cls, path: str | Path, model: SoftModel | None = None) -> Log:
        """Read a log exactly as `to_csv` wrote it, or what a rig recorded.

        Parameters
        ----------
        path : str or Path
            The file.
        model : SoftModel, optional
            The robot of a recording, which is a file without a log's settings; see
            `log_files.load_recording`.

        Raises
        ------
        InputError
            The file cannot be read, or is not a complete, consistent log of this version.
        """
        if model is not None and not log_files.is_log(path):
            return cls(**log_files.load_recording(path, model))
        return cls(**log_files.load_csv(path))


def check_channel_name(name: str, own: bool = False) -> None:
    """Refuse a channel's name that cannot be an attribute of a log, or is one already.

    Parameters
    ----------
    name : str
        The name.
    own : bool
        Whether it must be no channel of softdyn either, such as ``measured``.

    Raises
    ------
    InputError
        It is no Python name, or the name of a field or a method.
    """
    free = name.isidentifier() and not name.startswith("_") and name not in Log.__dataclass_fields__
    known = name in CHANNELS and not own
    if not free or (hasattr(Log, name) and not known):
        raise InputError("channels", "a name that is no attribute of a log", name)
