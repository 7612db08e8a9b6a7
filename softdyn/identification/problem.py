"""The problem of a fit: simulates outputs, compares them with the data, solves for the unknowns.

`static_fit` and `dynamic_fit` are its two kinds: rows at rest, and motion over time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.identification.blocks import DONE, ResidualBlock, least_squares
from softdyn.identification.data import Measurements, spread
from softdyn.identification.markers.camera import MarkerView
from softdyn.identification.outputs import compute_outputs
from softdyn.identification.parameters import Parameter, apply_values, neighbours_of
from softdyn.identification.trajectory import TrajectoryError
from softdyn.identification.unknowns.kinds import SEEN, SENSOR_BIAS, Around
from softdyn.identification.unknowns.sensor_errors import READ, biases
from softdyn.statics.equilibrium import StaticsError

Run = tuple[int, int]


class Simulated(NamedTuple):
    """Outputs of a run (N, outputs), their derivatives by θ and by the run's first state."""

    out: np.ndarray
    by_theta: np.ndarray
    by_first: np.ndarray
    first: np.ndarray


@dataclass(frozen=True, eq=False)
class Acquisition:
    """How the data were taken.

    Attributes
    ----------
    static : bool
        Whether each row is an equilibrium under its input.
    view : MarkerView, optional
        The markers and the camera that saw them; without it the outputs are in the world's frame.
    guesses : dict
        Equilibria of the rows (n,) from earlier simulations, where the next search starts.
    """

    static: bool = False
    view: MarkerView | None = None
    guesses: dict[bytes, np.ndarray] = field(default_factory=dict)


PLAIN = Acquisition()


def idle() -> None:
    """Show no bar."""


@dataclass(frozen=True, eq=False)
class FitProblem(ABC):
    """The data of a fit's residuals, without the values of its unknowns.

    Attributes
    ----------
    base : SoftModel
        The model with the file's values.
    unknowns : tuple of Parameter
    data : Measurements
    runs : tuple of (begin, end)
        Stretches of samples that are simulated.
    acquisition : Acquisition
        How the data were taken.
    tick : callable
        Called before each simulation with derivatives, for a bar.
    """

    base: SoftModel
    unknowns: tuple[Parameter, ...]
    data: Measurements
    runs: tuple[Run, ...]
    acquisition: Acquisition
    tick: Callable[[], object] = field(default=idle, kw_only=True)

    # -- what the two kinds do in their own way ----------------------------------------------------

    @abstractmethod
    def _path(
        self, model: SoftModel, theta: np.ndarray, run: Run, first: np.ndarray, around: Around,
        slopes: bool,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """The run's coordinates (N, n), and derivatives (N, n, P + first states) if `slopes`."""

    @abstractmethod
    def _late(self, model: SoftModel, run: Run, out: np.ndarray, slope: np.ndarray) -> None:
        """Read the outputs as late as the sensors do, in place."""

    @abstractmethod
    def starting_point(self) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Parameters, first states and noise (outputs,) from which the fit starts."""

    @abstractmethod
    def noise(
        self, theta: np.ndarray, simulated: Sequence[Simulated], before: np.ndarray
    ) -> np.ndarray:
        """Standard deviations (outputs,) of the residuals; `before` for those without any."""

    def within(self, data: Measurements, keep: np.ndarray) -> Self:
        """The problem that knows the samples `data` from which its own, `keep`, were taken."""
        return self

    def shorter(self, found: Fit) -> FitProblem | None:
        """The problem again on the part of the data that this fit shows to be usable."""
        return None

    @abstractmethod
    def correlation(self, residuals: np.ndarray) -> np.ndarray:
        """Autocorrelation (lags, outputs) of the residuals."""

    @abstractmethod
    def half_widths(self, blocks: list[ResidualBlock], residuals: np.ndarray) -> np.ndarray:
        """Half the widths (P,) of the 95 % intervals; the blocks' residuals have variance 1."""

    @abstractmethod
    def held_out(self, found: Fit, data: Measurements, left_out: np.ndarray) -> np.ndarray:
        """Residuals (N, outputs) of the samples `left_out` of the data.

        Nothing but first states is fitted to them.
        """

    def moved(self, found: Fit) -> float:
        """Largest change of θ with half of every step, over its deviation; NaN if unknown."""
        return float("nan")

    # -- simulation --------------------------------------------------------------------------------

    def simulated(self, theta: np.ndarray, firsts: Sequence[np.ndarray]) -> list[Simulated]:
        """Outputs of each run and their derivatives by θ and by the run's first state."""
        self.tick()
        model, count, found = apply_values(self.base, self.unknowns, theta), len(theta), []
        around = Around(self.base, neighbours_of(self.base, self.unknowns, theta))
        for run, first in zip(self.runs, firsts, strict=True):
            out, slope = self._outputs(model, theta, run, first, around, True)
            found.append(Simulated(out, slope[:, :, :count], slope[:, :, count:], first))
        return found

    def outputs(self, theta: np.ndarray, firsts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Outputs (N, outputs) of each run without derivatives, in half the time."""
        model, around = apply_values(self.base, self.unknowns, theta), Around(self.base)
        return [
            self._outputs(model, theta, run, first, around, False)[0]
            for run, first in zip(self.runs, firsts, strict=True)
        ]

    def _outputs(
        self, model: SoftModel, theta: np.ndarray, run: Run, first: np.ndarray, around: Around,
        slopes: bool,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        path, by = self._path(model, theta, run, first, around, slopes)
        out, slope = self._read(model, run, path, by)
        for k, beside, width in around.neighbours:  # their markers may be elsewhere, too
            there = self._read(beside, run, path, by[:, :, :0])[0]
            slope[:, :, k] += (there - out) / width
        for k, (unknown, value) in enumerate(zip(self.unknowns, theta, strict=True)):
            shift = unknown.shift(model, self.data.names)
            if unknown.kind is not SENSOR_BIAS:  # the model has these
                out += value * shift
            if slope.shape[2]:
                slope[:, :, k] += shift
        self._see(theta, out, slope, self.data.outputs[slice(*run)])
        return out, slope

    def _read(
        self, model: SoftModel, run: Run, path: np.ndarray, by: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Outputs of a path with the errors of the model's sensors, and their derivatives."""
        names = self.data.names
        out, slope = compute_outputs(model, names, path, by)
        if not any(name.startswith(READ) for name in names):
            return out, slope
        self._late(model, run, out, slope)
        bias = biases(model.robot)
        out += [bias.get(name.removeprefix(READ), 0.0) for name in names]
        return out, slope

    def _see(self, theta: np.ndarray, out: np.ndarray, slope: np.ndarray, data: np.ndarray) -> None:
        """Move the outputs of a run and their derivatives into the camera's frame, in place."""
        view = self.seen(theta).view
        if view is None:
            return
        by = view.seen(out, slope, data)
        for k, one in enumerate(self.unknowns if slope.shape[2] else ()):
            if one.kind is SEEN:
                slope[:, :, k] += by @ one.weights

    def seen(self, theta: np.ndarray) -> Acquisition:
        """The experiment with the camera of θ."""
        if self.acquisition.view is None:
            return self.acquisition
        camera = np.array(self.acquisition.view.camera)
        for one, value in zip(self.unknowns, theta, strict=True):
            if one.kind is SEEN:
                camera[one.weights != 0] = value
        return replace(self.acquisition, view=replace(self.acquisition.view, camera=camera))

    # -- residuals ---------------------------------------------------------------------------------

    def blocks(self, simulated: Sequence[Simulated], noise: np.ndarray) -> list[ResidualBlock]:
        """Residuals of the counted outputs and of the first rates, over their standard deviations.

        If joint damping stops a first rate within one sample time, the outputs do not show it. A
        fit could then choose any rate and lose the measured motion. The first rates are therefore
        kept near the smoothed ones, with the joint's range in `SHORTEST` samples as standard
        deviation. This is tens of times wider than the outputs' own information on other rates.
        """
        use, found = self.counted(), []
        for (begin, end), run, near in zip(self.runs, simulated, self.firsts(), strict=True):
            residual = ((run.out - self.data.outputs[begin:end]) / noise)[:, use]
            known = np.isfinite(residual)
            residual = residual[known]
            by_theta, by_first = ((part / noise[:, None])[:, use][known] for part in run[1:3])
            wide = 1 / self.wide()[1]
            rates = slice(len(near) - len(wide), None)
            left = (run.first - near)[rates] * wide
            found.append(
                ResidualBlock(
                    np.append(residual, left),
                    np.vstack((by_theta, np.zeros((len(wide), by_theta.shape[1])))),
                    np.vstack((by_first, np.eye(len(near))[rates] * wide[:, None])),
                )
            )
        return found

    def wide(self) -> tuple[np.ndarray, np.ndarray]:
        """Ranges of the free joints, and standard deviations of their first rates.

        The deviations are relative to the smoothed rates. Both are empty if no rates are unknown.
        """
        return np.zeros(0), np.zeros(0)

    def residuals(self, simulated: Sequence[Simulated]) -> np.ndarray:
        """Measured minus simulated outputs (N, outputs); NaN for outputs that do not count."""
        left = np.full(self.data.outputs.shape, np.nan)
        use = self.counted()
        for (begin, end), run in zip(self.runs, simulated, strict=True):
            left[begin:end, use] = (self.data.outputs[begin:end] - run.out)[:, use]
        return left

    def counted(self) -> np.ndarray:
        """Whether each output (outputs,) counts."""
        return np.ones(len(self.data.names), bool)

    def firsts(self) -> list[np.ndarray]:
        """The measured first states of the runs; empty where none is unknown."""
        return [np.zeros(0) for _ in self.runs]

    def first_noise(self) -> np.ndarray:
        """A first value of the noise (outputs,), from the outputs' ranges."""
        wide = spread(self.data.outputs)
        return 1e-3 * np.maximum(wide, 1e-3 * wide.max())

    # -- solution ----------------------------------------------------------------------------------

    def solved(
        self,
        theta: np.ndarray,
        firsts: Sequence[np.ndarray],
        noise: np.ndarray,
        done: float = DONE,
    ) -> tuple[np.ndarray, list[np.ndarray], list[Simulated]]:
        """Parameters, first states and outputs with the least sum of squares over the noise."""
        lower = np.array([p.lower for p in self.unknowns])
        theta = np.maximum(theta, lower)
        best = self.simulated(theta, firsts)  # an error at the first guess reaches the user
        kept = {_key(theta, firsts): best}

        def blocks(at: np.ndarray, own: Sequence[np.ndarray]) -> list[ResidualBlock] | None:
            key = _key(at, own)
            if key not in kept:
                kept.clear()
                try:
                    kept[key] = self.simulated(at, own)
                except (TrajectoryError, StaticsError, InputError):
                    return None  # these values cannot be simulated
            return self.blocks(kept[key], noise)

        theta, own = least_squares(blocks, theta, firsts, lower, done)
        key = _key(theta, own)
        return theta, own, kept[key] if key in kept else self.simulated(theta, own)


@dataclass(frozen=True, eq=False)
class Fit:
    """The least-squares solution of a problem.

    Attributes
    ----------
    problem : FitProblem
        The problem without the unknowns that are not identifiable.
    theta : ndarray, (P,)
        Values of its unknowns.
    noise : ndarray, (outputs,)
        Standard deviations of the residuals.
    simulated : list of Simulated
        The simulation of each run.
    unidentifiable : tuple of str
        The parameters, or combinations of them, that are not identifiable, as text.
    """

    problem: FitProblem
    theta: np.ndarray
    noise: np.ndarray
    simulated: list[Simulated]
    unidentifiable: tuple[str, ...]


def _key(theta: np.ndarray, own: Sequence[np.ndarray]) -> bytes:
    return np.concatenate((theta, *own)).tobytes()
