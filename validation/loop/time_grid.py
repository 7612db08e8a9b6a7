"""The division of a run into control periods, and of those into plant steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from softdyn import InputError
from softdyn.checks import number

# s; coarser steps add numerical damping, which improves the results of every controller
MAX_TIMESTEP = 5e-4
MAX_STEPS = 2_000_000


@dataclass(frozen=True)
class TimeGrid:
    """A run divided into control periods and plant steps.

    Attributes
    ----------
    duration, period, timestep : float
        Length of the run, control period and plant step (s).
    steps : int
        Number of control periods; the last one may be shorter.
    substeps, last : int
        Plant steps in a control period, and in the last period.
    """

    duration: float
    period: float
    timestep: float
    steps: int
    substeps: int
    last: int

    @classmethod
    def plan(
        cls,
        duration: float,
        period: float,
        timestep: float | None = None,
        most: float = MAX_TIMESTEP,
    ) -> TimeGrid:
        """Divide a run.

        Parameters
        ----------
        duration, period : float
            Length of the run and control period (s).
        timestep : float, optional
            Plant step (s), which must divide the period; by default the largest ≤ `most`. ``inf``
            is one step per period.
        most : float
            Largest default plant step (s).

        Raises
        ------
        InputError
            A time is not positive, the plant step does not divide the period, or the run is shorter
            than a plant step or longer than `MAX_STEPS` periods.
        """
        duration = number("duration", duration, above=0.0)
        period = number("period", period, above=0.0)
        if timestep is None:
            parts = period / most
            substeps = max(1, math.ceil(parts - 1e-9)) if parts <= MAX_STEPS else 0
        else:
            timestep = number("timestep", timestep, above=0.0, finite=False)
            timestep = period if timestep == math.inf else timestep
            parts = period / timestep
            substeps = round(parts) if parts <= MAX_STEPS else 0
            if not math.isclose(parts, substeps, rel_tol=1e-9):
                expected = f"an integer part of the period {period:g} s"
                raise InputError("timestep", expected, timestep)
        if substeps == 0:
            raise InputError("period", f"at most {MAX_STEPS} plant steps", f"{period:g} s")
        timestep = period / substeps
        if not duration / period <= MAX_STEPS or not duration / timestep < 1e15:
            raise InputError("duration", f"at most {MAX_STEPS} control periods", f"{duration:g} s")
        total = round(duration / timestep)
        if total == 0:
            expected = f"at least a plant step of {timestep:g} s"
            raise InputError("duration", expected, f"{duration:g} s")
        steps = -(-total // substeps)
        return cls(duration, period, timestep, steps, substeps, total - (steps - 1) * substeps)

    def times(self) -> np.ndarray:
        """Sampling times (steps + 1,) (s): the start of every hold, then the end of the run."""
        t = np.arange(self.steps + 1) * self.period
        if self.last < self.substeps:
            t[-1] = t[-2] + self.last * self.timestep
        return t

    def plant_steps(self, k: int) -> int:
        """Number of plant steps in control period `k`."""
        return self.substeps if k < self.steps - 1 else self.last
