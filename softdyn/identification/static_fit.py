"""The fit of static data: each row is an equilibrium under its input."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.identification.blocks import ResidualBlock
from softdyn.identification.data import Measurements
from softdyn.identification.intervals import fit_length, half_widths
from softdyn.identification.parameters import Parameter
from softdyn.identification.problem import Acquisition, Fit, FitProblem, Run, Simulated
from softdyn.identification.rests import Inputs, rests
from softdyn.identification.unknowns.kinds import INPUT_LOSS, Around


class StaticFit(FitProblem):
    """One run of rows at rest.

    All outputs of one kind have one common noise, and the intervals allow errors that the outputs
    of a row share (`intervals.half_widths`).
    """

    @classmethod
    def of(
        cls, model: SoftModel, data: Measurements, unknowns: tuple[Parameter, ...], step: float,
        acquisition: Acquisition,
    ) -> StaticFit:  # fmt: skip
        """The problem of all rows; there are no steps over time."""
        return cls(model, unknowns, data, ((0, len(data.t)),), acquisition)

    @staticmethod
    def cleaned(model: SoftModel, data: Measurements) -> Measurements:
        """The data themselves."""
        return data

    @staticmethod
    def parts(data: Measurements, hold_out: float) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the rows to fit, and of those held out, which are spread over the data."""
        fit_length(data, hold_out)  # checks it
        every = np.arange(len(data.t))
        count = round(len(every) * hold_out)
        held = ((np.arange(count) + 0.5) * len(every) / max(count, 1)).astype(int)
        return np.setdiff1d(every, held), held

    def _path(
        self, model: SoftModel, theta: np.ndarray, run: Run, first: np.ndarray, around: Around,
        slopes: bool,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        return rests(model, self.unknowns, self.inputs(theta, run), around)

    def inputs(self, theta: np.ndarray, run: Run) -> Inputs:
        """The inputs of static rows, with what friction takes of them."""
        loss = np.zeros(self.base.nu)
        for one, value in zip(self.unknowns, theta, strict=True):
            if one.kind is INPUT_LOSS:
                loss += value * one.weights
        data, part = self.data, slice(*run)
        way = None if data.direction is None else data.direction[part]
        return Inputs(data.u[part], loss, way, self.acquisition.guesses)

    def _late(self, model: SoftModel, run: Run, out: np.ndarray, slope: np.ndarray) -> None:
        """Nothing: a robot at rest has been there for long."""

    def starting_point(self) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """The file's values, and noise from the outputs' ranges."""
        theta = np.array([parameter.nominal for parameter in self.unknowns])
        return theta, self.firsts(), self._pooled(self.first_noise())

    def noise(
        self, theta: np.ndarray, simulated: Sequence[Simulated], before: np.ndarray
    ) -> np.ndarray:
        """Standard deviations (outputs,) of the residuals, the same for all outputs of a kind."""
        left = self.residuals(simulated)
        samples = np.isfinite(left).sum(0)
        least = 1e-9 * self.first_noise()
        spent = len(theta) / left.shape[1]
        return np.maximum(self._pooled(np.sqrt(np.nanmean(left**2, axis=0))), least) * float(
            np.sqrt(samples.mean() / max(samples.mean() - spent, 0.5))
        )

    def correlation(self, residuals: np.ndarray) -> np.ndarray:
        """None: rows have no order in time."""
        return np.zeros((0, residuals.shape[1]))

    def half_widths(self, blocks: list[ResidualBlock], residuals: np.ndarray) -> np.ndarray:
        """Half the widths (P,) of the 95 % intervals; the outputs of a row may share errors."""
        return half_widths(blocks[0], np.nonzero(np.isfinite(residuals))[0])

    def held_out(self, found: Fit, data: Measurements, left_out: np.ndarray) -> np.ndarray:
        """Residuals (N, outputs) of the rows `left_out` of the data."""
        there = StaticFit.of(
            self.base, data.rows(left_out), self.unknowns, np.inf, self.acquisition
        )
        return there.data.outputs - there.outputs(found.theta, there.firsts())[0]

    def _pooled(self, noise: np.ndarray) -> np.ndarray:
        """One noise for all outputs of a kind, because few rows tell little about each output's."""
        kinds = [(name.partition(".")[0], ".r" in name[-3:]) for name in self.data.names]
        found = np.empty(len(noise))
        for kind in set(kinds):
            same = np.array([one == kind for one in kinds])
            found[same] = np.sqrt(np.mean(noise[same] ** 2))
        return found
