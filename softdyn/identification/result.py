"""The result of an identification: values, intervals, parameters that are not identifiable."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from softdyn.dynamics.model import SoftModel
from softdyn.identification.parameters import Parameter, member_values

COARSE = 0.3  # of a standard deviation; more, and the simulation's step is too coarse
NOT_WHITE = (
    "the model lacks something, or the data are simulated with too coarse a step. To find out, "
    "simulate them with half the step: only an effect of the step shrinks"
)


@dataclass(frozen=True, eq=False)
class Estimate:
    """One parameter: value, standard deviation, 95 % interval.

    If it is not identified, the value is the file's.
    """

    parameter: Parameter
    value: float
    deviation: float
    identified: bool

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval, by the normal distribution."""
        half = norm.ppf(0.975) * self.deviation
        return self.value - half, self.value + half


@dataclass(frozen=True, eq=False)
class Identified:
    """Parameters identified from data.

    Attributes
    ----------
    model : SoftModel
        The model with the identified values.
    estimates : tuple of Estimate
    names : tuple of str
        Names of the outputs.
    residuals : ndarray, (N, outputs)
        Measured minus simulated outputs; NaN if a stop may have pushed a joint.
    noise : ndarray, (outputs,)
        Standard deviation of each output's residual; NaN for a joint that is held.
    autocorrelation : ndarray, (LAGS, outputs)
        Autocorrelation of the residuals; for white ones it stays within 2/√N.
    white : float
        Probability of a larger Ljung–Box statistic if all residuals were white.
    held_out : float
        Rms of the residuals over `noise` in the part of the data that the fit did not see.
    unidentifiable : tuple of str
        The parameters, or combinations of them, that are not identifiable, as text.
    moved : float
        Largest change of an estimate with half of every step, over its standard deviation. It is
        NaN if the model cannot be simulated with half of every step.
    """

    model: SoftModel
    estimates: tuple[Estimate, ...]
    names: tuple[str, ...]
    residuals: np.ndarray
    noise: np.ndarray
    autocorrelation: np.ndarray
    white: float
    held_out: float
    unidentifiable: tuple[str, ...]
    moved: float

    @property
    def vague(self) -> tuple[str, ...]:
        """The old name of `unidentifiable`."""
        warnings.warn("vague is called unidentifiable", DeprecationWarning, stacklevel=2)
        return self.unidentifiable

    def values(self) -> dict[str, dict[str, float]]:
        """Identified values of the robot, by kind and member, as `rewritten` takes them."""
        known = [
            one for one in self.estimates if one.identified and not one.parameter.kind.measures
        ]
        theta = np.array([one.value for one in known])
        return member_values(self.model, [one.parameter for one in known], theta)

    def report(self) -> dict[str, Any]:
        """The results as plain data."""
        return {
            "parameters": [
                {"kind": one.parameter.kind.name, "label": one.parameter.label,
                 "unit": one.parameter.unit, "identified": one.identified, "value": one.value,
                 "deviation": one.deviation, "interval": one.interval,
                 "file": one.parameter.nominal}
                for one in self.estimates
            ],
            "noise": dict(zip(self.names, self.noise.tolist(), strict=True)),
            "white": self.white, "held_out": self.held_out, "not_told": list(self.unidentifiable),
            "moved": self.moved,
        }  # fmt: skip

    def __str__(self) -> str:
        width = max(len(one.parameter.label) for one in self.estimates)
        lines = []
        for one in self.estimates:
            line = f"{one.parameter.label:{width}}  {one.value:12.6g} {one.parameter.unit}"
            if one.identified:
                low, high = one.interval
                line += f"   95 %: {low:.6g} … {high:.6g}"
                if one.parameter.nominal:
                    line += f"   file {one.value / one.parameter.nominal - 1:+.1%}"
            else:
                line += "   NOT IDENTIFIED: the file's value"
            lines.append(line)
        lines += [f"not identifiable from these data: {text}" for text in self.unidentifiable]
        low, high = np.nanmin(self.noise), np.nanmax(self.noise)
        lines.append(f"residuals, standard deviation: {low:.3g} … {high:.3g}")
        if np.isfinite(self.held_out):
            lines.append(f"held-out part: {self.held_out:.3g} times the fit's residuals")
        if self.moved > COARSE:
            lines.append(
                f"half the step of the simulation would move an estimate by {self.moved:.2g} of its"
                " standard deviation: give a shorter --step"
            )
        if self.white < 0.01:
            lines.append(f"the residuals are not white: {NOT_WHITE}")
        return "\n".join(lines)
