"""The fit of static data: each row is an equilibrium under its input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.identification.blocks import ResidualBlock
from softdyn.identification.data import Measurements
from softdyn.identification.intervals import fit_length, half_widths
from softdyn.identification.parameters import Parameter, apply_values
from softdyn.identification.problem import Acquisition, Fit, FitProblem, Run, Simulated
from softdyn.identification.rests import Inputs, directions, rests, slid
from softdyn.identification.unknowns.kinds import CABLE_FRICTION, INPUT_LOSS, Around
from softdyn.statics.equilibrium import StaticsError

LEAST = 3  # rows of a fit, and of a test; with fewer held out there is no test


@dataclass(frozen=True, eq=False)
class StaticFit(FitProblem):
    """One run of rows at rest.

    All outputs of one kind have one common noise, and the intervals allow errors that the outputs
    of a row share (`intervals.half_widths`).

    Attributes
    ----------
    sequence : Measurements, optional
        All rows in the order of time, those held out too, if cables rub and no row states the
        direction in which they slid last.
    keep : ndarray of int, (N,)
        The rows of it to fit.
    """

    sequence: Measurements | None = None
    keep: np.ndarray | None = None

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
        count = count if count >= LEAST else 0
        held = ((np.arange(count) + 0.5) * len(every) / max(count, 1)).astype(int)
        return np.setdiff1d(every, held), held

    def within(self, data: Measurements, keep: np.ndarray) -> StaticFit:
        """The problem that knows the rows `data` from which its own, `keep`, were taken."""
        if data.direction is not None or not self._rubs():
            return self
        way = directions(self.base, Inputs(data.u, np.zeros(self.base.nu)))
        own = replace(self.data, direction=way[keep])
        return replace(self, data=own, sequence=data, keep=keep)

    def shorter(self, found: Fit) -> StaticFit | None:
        """The rows in which the cables slid as a whole, under the friction found.

        Raises
        ------
        InputError
            For too few such rows, and rows that no slow motion joins.
        """
        if self.sequence is None or self.keep is None:
            return None
        way, whole = self._slid(found, self.sequence)
        rows = self.keep[whole[self.keep]]
        if len(rows) < LEAST:
            expected = f"{LEAST} rows or more in which the cables slid all the way after they"
            expected += " turned; a larger change of the input, or direction.INPUT"
            raise InputError("data", expected, f"{len(rows)} of {len(self.keep)}")
        own = replace(self.sequence.rows(rows), direction=way[rows])
        before = found.problem.data
        same = before.direction is not None and np.array_equal(way[rows], before.direction)
        if same and np.array_equal(own.t, before.t):
            return None
        return replace(self, data=own, runs=((0, len(rows)),))

    @property
    def in_part(self) -> int:
        """The number of rows left out because the cables slid back only in part."""
        return 0 if self.keep is None else len(self.keep) - len(self.data.t)

    def _rubs(self) -> bool:
        kinds = {one.names[0] for one in self.unknowns}
        rubs = any(tendon.rubs for tendon in self.base.robot.tendons)
        return rubs or not kinds.isdisjoint((INPUT_LOSS.name, CABLE_FRICTION.name))

    def _slid(self, found: Fit, rows: Measurements) -> tuple[np.ndarray, np.ndarray]:
        """`rests.slid` with the values found."""
        problem, theta = found.problem, found.theta
        assert isinstance(problem, StaticFit)
        model = apply_values(problem.base, problem.unknowns, theta)
        try:
            return slid(model, rows.u, problem.inputs(theta, (0, len(problem.data.t))).loss)
        except StaticsError as error:
            expected = "rows that a slow motion joins, or the columns direction.INPUT"
            raise InputError("data", expected, error) from None

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
        for one in self.unknowns:
            if one.kind.from_none and not one.nominal:
                raise InputError(one.label, "a first guess in the robot's file", "none of it")
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
        rows = data.rows(left_out)
        if self._rubs() and data.direction is None:
            way, whole = self._slid(found, data)
            if (left_out := left_out[whole[left_out]]).size < LEAST:
                return np.zeros((0, len(found.noise)))
            rows = replace(data.rows(left_out), direction=way[left_out])
        there = StaticFit.of(self.base, rows, self.unknowns, np.inf, self.acquisition)
        return there.data.outputs - there.outputs(found.theta, there.firsts())[0]

    def _pooled(self, noise: np.ndarray) -> np.ndarray:
        """One noise for all outputs of a kind, because few rows tell little about each output's."""
        kinds = [(name.partition(".")[0], ".r" in name[-3:]) for name in self.data.names]
        found = np.empty(len(noise))
        for kind in set(kinds):
            same = np.array([one == kind for one in kinds])
            found[same] = np.sqrt(np.mean(noise[same] ** 2))
        return found
