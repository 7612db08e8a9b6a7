"""Writes the problem behind each fallback of a run to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from softdyn import InputError, State
from softdyn.controllers import Status
from softdyn.files import not_writable


class KeptProblems:
    """Called at each control step of a run, it writes the problem of a fallback to a file.

    The files are ``fallback_T.npz`` with the time T (s) of the step; see
    `softdyn.controllers.FailedProblem`, whose arrays they hold, and `t`. The folder is made for the
    first one.

    Parameters
    ----------
    folder : str or Path
        Where they go.
    controller : Any
        The controller, with an attribute `failed_problem`.

    Attributes
    ----------
    count : int
        Number of files written.

    Raises
    ------
    InputError
        A controller that keeps no problem; a file that cannot be written.
    """

    def __init__(self, folder: str | Path, controller: Any) -> None:
        if not hasattr(controller, "failed_problem"):
            name = getattr(controller, "name", type(controller).__name__)
            raise InputError("--keep-failed", "a controller with `failed_problem`", name)
        self._folder, self._controller, self.count = Path(folder), controller, 0

    def __call__(self, t: float, state: State, output: Any) -> None:
        """Write the problem of `output`, the answer at t (s), if it is a fallback."""
        found = self._controller.failed_problem
        if found is None or getattr(output, "status", Status.OK) is Status.OK:
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise not_writable(self._folder, error) from None
        found.save(self._folder / f"fallback_{t:09.4f}.npz", t=t)
        self.count += 1
