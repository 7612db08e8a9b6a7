"""The problem behind a fallback, kept so that another solver can look at it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import Reference, State
from softdyn.copies import Frozen, freeze
from softdyn.files import atomic

PARTS = "H", "g", "A", "lower", "upper", "status"
NOTHING = np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros(0)


@dataclass(frozen=True, eq=False)
class FailedProblem(Frozen):
    """The QP of a command that is a fallback, and the state and reference that it was made from.

        minimise ½ xᵀ H x + gᵀ x   subject to   lower ≤ A x ≤ upper

    The first unknowns are the input u (N, N m or m/s, by actuator); for `Mpc` they are its changes,
    and for tasks of several levels they are those of the level that failed. All five have size 0
    where there is no QP: for a controller in closed form, and for numbers that gave none.

    Attributes
    ----------
    status : str
        The command's `Status`: ``not solved``, or ``non-finite`` where the QP's numbers are not.
    H, g : ndarray, (n, n), (n,)
        The objective.
    A : ndarray, (rows, n)
        The rows.
    lower, upper : ndarray, (rows,)
        Their bounds; infinite where a row is open.
    state : State or None
        What the controller saw; None only until its call ends.
    reference : Reference or None
        What it was asked for.
    """

    status: str
    H: np.ndarray
    g: np.ndarray
    A: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    state: State | None = None
    reference: Reference | None = None

    def __post_init__(self) -> None:
        freeze((self.H, self.g, self.A, self.lower, self.upper))

    @classmethod
    def of(cls, status: str, problem: tuple[np.ndarray, ...] | None) -> FailedProblem:
        """The problem (H, g, A, lower, upper), copied; None for a controller without a QP."""
        H, g, A, lower, upper = (np.array(part) for part in problem or NOTHING)
        return cls(status, H, g, A, lower, upper)

    def arrays(self) -> dict[str, Any]:
        """All that `save` writes, by name."""
        found: dict[str, Any] = {name: getattr(self, name) for name in PARTS}
        if self.state is not None:
            model = self.state.model
            found |= {"robot": model.name, "digest": model.robot.digest, "q": self.state.q,
                      "v": self.state.v, "u_min": model.u_min, "u_max": model.u_max}  # fmt: skip
        if self.reference is not None:
            found |= {name: getattr(self.reference, name) for name in ("y", "ydot", "yddot")}
            for task, target in getattr(self.reference, "targets", {}).items():
                found |= {f"{task}.{name}": getattr(target, name) for name in ("y", "ydot")}
        return found

    def save(self, path: str | Path, **more: Any) -> None:
        """Write an NPZ file that ``numpy.load`` reads without pickles.

        It holds ``H g A lower upper status``, the state ``q v`` with the robot's ``robot digest
        u_min u_max``, and the reference ``y ydot yddot``; of tasks also ``NAME.y NAME.ydot``.
        `more` adds arrays by their names.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        with atomic(path) as file:
            np.savez(file, **self.arrays(), **more)
