"""The result of an identification: values, intervals, parameters that are not identifiable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from softdyn.dynamics.model import SoftModel
from softdyn.identification.data import Measurements
from softdyn.identification.markers.camera import MarkerView
from softdyn.identification.parameters import Parameter, member_values
from softdyn.identification.problem import Fit
from softdyn.identification.unknowns.kinds import SENSOR_ERRORS
from softdyn.identification.unknowns.sensor_errors import READ, noises

COARSE = 0.3  # of a standard deviation; more, and the simulation's step is too coarse
FAR = 10.0  # times the file's value, or its part; a larger change is written as a factor
COLOURED = 0.01  # probability of the residuals if they were white; below, they are not
NOT_WHITE = (
    "the model lacks something, or the data are simulated with too coarse a step. To find out, "
    "simulate them with half the step: only an effect of the step shrinks"
)


@dataclass(frozen=True, eq=False)
class Estimate:
    """One parameter: value, and half the width of its 95 % interval.

    If it is not identified, the value is the file's.
    """

    parameter: Parameter
    value: float
    half: float
    identified: bool

    @property
    def deviation(self) -> float:
        """The standard deviation of a normal distribution with this interval."""
        return float(self.half / norm.ppf(0.975))

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval."""
        return self.value - self.half, self.value + self.half


@dataclass(frozen=True, eq=False)
class Identified:
    """Parameters identified from data.

    Attributes
    ----------
    model : SoftModel
        The model with the identified values.
    estimates : tuple of Estimate
    data : Measurements
        The samples that were fitted.
    residuals : ndarray, (N, outputs)
        Measured minus simulated outputs; NaN if a stop may have pushed a joint.
    noise : ndarray, (outputs,)
        Standard deviation of each output's residual; NaN for a joint that is held.
    autocorrelation : ndarray, (LAGS, outputs)
        Autocorrelation of the residuals; for white ones it stays within 2/√N.
    white : float
        Probability of a larger Ljung–Box statistic if all residuals were white.
    held_out : float
        Rms of the residuals over `noise` in the data that the fit did not see.
    rms_held_out : float
        The same in the outputs' own units: of the markers' distances (m), or else of all outputs.
    unidentifiable : tuple of str
        The parameters, or combinations of them, that are not identifiable, as text.
    moved : float
        Largest change of an estimate with half of every step, over its standard deviation. It is
        NaN if the model cannot be simulated with half of every step, and for static data.
    fit : Fit
        The problem and its solution.
    """

    model: SoftModel
    estimates: tuple[Estimate, ...]
    data: Measurements
    residuals: np.ndarray
    noise: np.ndarray
    autocorrelation: np.ndarray
    white: float
    held_out: float
    rms_held_out: float
    unidentifiable: tuple[str, ...]
    moved: float
    fit: Fit

    @property
    def static(self) -> bool:
        """Whether each sample is an equilibrium."""
        return self.fit.problem.acquisition.static

    @property
    def camera(self) -> np.ndarray | None:
        """The camera (6,) that was fitted or stated."""
        view = self.fit.problem.seen(self.fit.theta).view
        return None if view is None else view.camera

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.data.names

    @property
    def rms(self) -> float:
        """Rms residual of the fit, as `rms_held_out`."""
        return distance(self.names, self.residuals)

    @property
    def coloured(self) -> bool:
        """Whether the residuals are not white."""
        return self.white < COLOURED

    def beside_noise(self) -> dict[str, Any] | None:
        """The residuals of sensors beside the noise that the robot's file states.

        `ratios` by reading are rms over noise, and `chi2` is the sum of the squares over that
        noise, of `samples` numbers; `p` is the probability of a larger one by chance. None without
        such a sensor.
        """
        stated = noises(self.model.robot)
        squares = {
            name: (self.residuals[:, k] / stated[name.removeprefix(READ)]) ** 2
            for k, name in enumerate(self.names)
            if name.startswith(READ) and stated.get(name.removeprefix(READ), 0.0) > 0
        }
        finite = {name: one[np.isfinite(one)] for name, one in squares.items()}
        finite = {name: one for name, one in finite.items() if one.size}
        if not finite:
            return None
        statistic = float(sum(one.sum() for one in finite.values()))
        samples = sum(one.size for one in finite.values())
        return {
            "ratios": {name: float(np.sqrt(one.mean())) for name, one in finite.items()},
            "chi2": statistic, "samples": samples, "p": float(chi2.sf(statistic, samples)),
        }  # fmt: skip

    def values(self) -> dict[str, dict[str, float]]:
        """Identified values of the robot, by kind and member, as `rewrite_urdf` takes them."""
        known = [
            one for one in self.estimates
            if one.identified
            and (not one.parameter.kind.measures or one.parameter.kind in SENSOR_ERRORS)
        ]  # fmt: skip
        theta = np.array([one.value for one in known])
        return member_values(self.model, [one.parameter for one in known], theta)

    def report(self) -> dict[str, Any]:
        """The results as plain data."""
        return {
            "parameters": [
                {"kind": one.parameter.names[0], "member": one.parameter.names[1],
                 "label": one.parameter.label, "unit": one.parameter.unit, "value": one.value,
                 "low": one.interval[0], "high": one.interval[1], "identifiable": one.identified,
                 "identified": one.identified, "deviation": one.deviation,
                 "interval": one.interval, "file": one.parameter.nominal,
                 "white": not self.coloured}
                for one in self.estimates
            ],
            "noise": dict(zip(self.names, self.noise.tolist(), strict=True)),
            "rms": self.rms, "rms_held_out": self.rms_held_out,
            "white": self.white, "held_out": self.held_out, "not_told": list(self.unidentifiable),
            "moved": self.moved, "file_noise": self.beside_noise(),
        }  # fmt: skip

    def __str__(self) -> str:
        width = max(len(one.parameter.label) for one in self.estimates)
        lines = []
        for one in self.estimates:
            line = f"{one.parameter.label:{width}}  {one.value:12.6g} {one.parameter.unit}"
            if one.identified:
                low, high = one.interval
                line += f"   95 %: {low:.6g} … {high:.6g}" + (" (?)" if self.coloured else "")
                if one.parameter.nominal and not one.parameter.kind.about_zero:
                    line += f"   file {_change(one.value / one.parameter.nominal)}"
            else:
                line += "   NOT IDENTIFIED: the file's value"
            lines.append(line)
        lines += [f"not identifiable from these data: {text}" for text in self.unidentifiable]
        low, high = np.nanmin(self.noise), np.nanmax(self.noise)
        lines.append(f"residuals, standard deviation: {low:.3g} … {high:.3g}")
        if (beside := self.beside_noise()) is not None:
            shown = ", ".join(
                f"{name.removeprefix(READ)} {ratio:.3g}" for name, ratio in beside["ratios"].items()
            )
            lines.append(
                f"residuals over the sensors' noise in the file: {shown}; "
                f"χ² {beside['chi2']:.5g} of {beside['samples']} numbers"
                + (": the model lacks something, or the noise is larger"
                   if beside["p"] < COLOURED else "")
            )  # fmt: skip
        if np.isfinite(self.held_out):
            lines.append(f"held-out part: {self.held_out:.3g} times the fit's residuals")
        if MarkerView.of(self.names).positions:
            lines.append(
                f"distance of the markers, rms: {1e3 * self.rms:.3g} mm in the fit"
                + (f", {1e3 * self.rms_held_out:.3g} mm in the data held out"
                   if np.isfinite(self.rms_held_out) else "")
            )  # fmt: skip
        if self.moved > COARSE:
            lines.append(
                f"half the step of the simulation would move an estimate by {self.moved:.2g} of its"
                " standard deviation: give a shorter --step"
            )
        if self.coloured:
            lines.append(f"(?) the residuals are not white: {NOT_WHITE}")
        return "\n".join(lines)


def _change(ratio: float) -> str:
    """A value over the file's, in percent or as a factor."""
    return f"{ratio - 1:+.1%}" if 1 / FAR < ratio < FAR else f"times {ratio:.3g}"


def rms(values: np.ndarray) -> float:
    """Root mean square of the numbers that are finite; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def distance(names: Sequence[str], residuals: np.ndarray) -> float:
    """Rms residual: of the distance (m) if positions of markers were measured, else of all."""
    view = MarkerView.of(names)
    if not view.positions:
        return rms(residuals)
    return rms(np.linalg.norm(view.points(residuals), axis=2))
