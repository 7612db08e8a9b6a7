"""An observer's estimate, with its uncertainty, and what an observer is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.special import ndtri

from softdyn.checks import number
from softdyn.copies import Frozen, freeze
from softdyn.exceptions import InputError


@dataclass(frozen=True, eq=False)
class StateEstimate(Frozen):
    """The estimate at one instant; its arrays are read-only.

    Attributes
    ----------
    q, v : ndarray, (nq,), (nv,)
        Configuration and velocity.
    covariance : ndarray, (2 nv, 2 nv)
        Covariance of their errors, along q ⊕ dq and v + dv.
    disturbances : dict of str to ndarray
        The estimated disturbances by their names.
    deviations : dict of str to ndarray
        Their standard deviations, with the error by friction of cables that the file states.
    nis : float
        Normalised innovation squared: the sum of e² / variance over the readings just used.
    used : int
        The number of these readings. `nis` is chi-squared with so many degrees of freedom, if the
        filter is consistent: see `softdyn.estimation.consistency`.
    residuals, normalised : ndarray, (k,)
        Each reading minus its prediction, in its unit, and in deviations: independent and of
        variance 1 in a consistent filter. NaN for a reading that was not used.
    """

    q: np.ndarray
    v: np.ndarray
    covariance: np.ndarray
    disturbances: dict[str, np.ndarray]
    deviations: dict[str, np.ndarray]
    nis: float
    used: int
    residuals: np.ndarray
    normalised: np.ndarray

    def __post_init__(self) -> None:
        freeze(vars(self).values())

    def interval(self, name: str, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper ends of a disturbance's interval at a level, component by component.

        Raises
        ------
        InputError
            A disturbance that is not estimated, a level outside (0, 1).
        """
        if name not in self.disturbances:
            raise InputError("name", " or ".join(self.disturbances) or "no name", repr(name))
        level = number("level", level, above=0.0)
        if level >= 1:
            raise InputError("level", "a number < 1", repr(level))
        reach = float(ndtri(0.5 + level / 2)) * self.deviations[name]
        return self.disturbances[name] - reach, self.disturbances[name] + reach


class Observer(Protocol):
    """An observer of a closed loop: any class with these two methods.

    On a real rig `reset` is told the rest ``q`` (nq,) in which the run begins, and `step` the
    ``stamps`` (k,) of the readings and the time at which `u` was ``sent``, if they have such
    arguments (`Ekf.step`).
    """

    def reset(self) -> None:
        """Begin a run."""

    def step(self, t: float, measurements: np.ndarray, u: np.ndarray) -> Any:
        """The estimate at t (s), an object with `q` (nq,) and `v` (nv,), and maybe `covariance`.

        `measurements` (k,) are the sensors' readings at t; `u` (nu,) are the commands that were
        sent at the last step and have been held since.
        """
