"""The task error every law starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.gains import Gains
from softdyn import Reference, SetPoint, State


@dataclass(frozen=True, slots=True)
class Task:
    """Error of the tip, paper section "Input-Output Linearization".

    Attributes
    ----------
    eta : (6,) η = (e, ė), e = y - y_ref (m, m/s).
    mu_ref : (3,) μ_ref = -K_d ė - K_p e (m/s²).
    yddot : (3,) ÿ_ref.
    """

    eta: np.ndarray
    mu_ref: np.ndarray
    yddot: np.ndarray


def task_error(state: State, reference: Reference | SetPoint, gains: Gains) -> Task:
    """The error of `state` against `reference`."""
    e, edot = state.y - reference.y, state.ydot - reference.ydot
    return Task(np.concatenate((e, edot)), -gains.Kd * edot - gains.Kp * e, reference.yddot)
