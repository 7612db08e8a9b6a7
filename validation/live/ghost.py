"""The analytic model beside the twin: Pinocchio's motion under the input that the plant gets."""

from __future__ import annotations

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.validation.crosschecks.trajectories import IMPLICIT


class Ghost:
    """A robot that Pinocchio moves, with the scheme and the step of the twin.

    It has no stops, contacts, mismatch or pull by the mouse. So its difference to the plant is the
    effect of these.

    Parameters
    ----------
    model : SoftModel
        The robot.
    q, v : ndarray, (nq,), (nv,)
        The initial state.
    timestep : float
        The plant's step (s).
    """

    def __init__(self, model: SoftModel, q: np.ndarray, v: np.ndarray, timestep: float) -> None:
        self._model, self._h = model, timestep
        self._step = IMPLICIT.free_step if model.robot.floating else IMPLICIT.step
        self.q, self._v = q, v

    def advance(self, u: np.ndarray, steps: int) -> None:
        """Run a number of plant steps under a held input.

        Raises
        ------
        InputError
            The motion is no longer finite.
        """
        for _ in range(steps):
            try:
                with np.errstate(all="ignore"):
                    self.q, self._v = self._step(self._model, self.q, self._v, u, self._h)
            except np.linalg.LinAlgError as error:
                raise InputError("ghost", "a mass matrix", error) from None

    @property
    def y(self) -> np.ndarray:
        """Position (3,) of the tip in the world (m)."""
        return self._model.state(self.q, np.zeros(self._model.nv)).y
