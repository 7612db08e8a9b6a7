"""The fit of motion: the stretches of the data in which no stop acts, and their first states."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.stats import norm

from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.identification.blocks import ResidualBlock, reduced
from softdyn.identification.data import SHORTEST, Measurements, at_stops, cut, gaps, stretches
from softdyn.identification.intervals import (
    FEWEST,
    SHARE,
    autocorrelation,
    deviations,
    fit_length,
)
from softdyn.identification.linear import first_guess, near_file, smoothed
from softdyn.identification.outputs import of_sensors
from softdyn.identification.parameters import Parameter, apply_values
from softdyn.identification.problem import PLAIN, Acquisition, Fit, FitProblem, Run, Simulated
from softdyn.identification.rests import Inputs, rests
from softdyn.identification.trajectory import (
    Driven,
    Start,
    TrajectoryError,
    creeping_springs,
    follow,
)
from softdyn.identification.unknowns.kinds import SENSOR_LATENCY, Around
from softdyn.identification.unknowns.sensor_errors import read_late, without_repeats
from softdyn.statics.equilibrium import StaticsError

CLEAR = 10  # a held joint follows its measurement if its motion over its noise is larger
USUAL = 1.5  # times the usual distance of rows: a step's length; rows may be that unsteady
PIECE = 100  # samples of the first pieces that are fitted
LATE = 4  # least length of a piece over the largest latency; before that a piece has no readings
ROUGH = 1e-3  # pieces are joined if a step would reduce the cost by a smaller share


@dataclass(frozen=True, eq=False)
class DynamicFit(FitProblem):
    """Stretches of motion, each with its own first state.

    Attributes
    ----------
    step : float
        Longest step (s) of the simulation.
    smooth : ndarray, (3, N, n), or None
        Smoothed angles, rates and accelerations. None if not all joints were measured; there is
        then one run, which begins at rest.
    stops : ndarray of bool, (N, n)
        The result of `at_stops`.
    held : ndarray of bool, (n,)
        Joints that are at their stops in all runs.
    finer : int
        Factor of the number of steps in each interval between samples.
    """

    step: float
    smooth: np.ndarray | None
    stops: np.ndarray
    held: np.ndarray
    finer: int = 1

    @classmethod
    def of(
        cls, model: SoftModel, data: Measurements, unknowns: tuple[Parameter, ...], step: float,
        acquisition: Acquisition = PLAIN,
    ) -> DynamicFit:  # fmt: skip
        """The problem on the stretches of the data that no stop disturbs.

        A step is no longer than rows usually are apart, also where rows are lost.
        """
        step = min(step, USUAL * float(np.median(np.diff(data.t))))
        joints = data.joints(model)
        if joints is None:
            none, whole = np.zeros((len(data.t), model.nv), bool), ((0, len(data.t)),)
            return cls(model, unknowns, data, whole, acquisition, step, None, none, none[0])
        smooth = smoothed(data, joints)
        stops = at_stops(model, smooth[0])
        held, runs = stretches(stops)
        if not runs:
            raise InputError("data", f"{SHORTEST} samples in a row away from the stops", "none")
        runs = cut(runs, gaps(data), min(SHORTEST, len(data.t)))
        # at its stop a held joint moves less than on the way there, so each run is smoothed alone
        for begin, end in runs if held.any() else ():
            part = slice(begin, end)
            smooth[:, part, held] = smoothed(data.part(begin, end), joints[part][:, held])
        return cls(model, unknowns, data, tuple(runs), acquisition, step, smooth, stops, held)

    @staticmethod
    def cleaned(model: SoftModel, data: Measurements) -> Measurements:
        """The data without readings that only repeat the one before."""
        fresh = without_repeats(model.robot, data.names, data.t, data.outputs)
        if len(data.t) < FEWEST:
            raise InputError("data", f"at least {FEWEST} samples", len(data.t))
        return replace(data, outputs=fresh)

    @staticmethod
    def parts(data: Measurements, hold_out: float) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the samples to fit, and of those held out, the last ones."""
        split, every = fit_length(data, hold_out), np.arange(len(data.t))
        return every[:split], every[split:]

    # -- simulation --------------------------------------------------------------------------------

    def _path(
        self, model: SoftModel, theta: np.ndarray, run: Run, first: np.ndarray, around: Around,
        slopes: bool,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        t, u = self.data.t[slice(*run)], self.data.u[slice(*run)]
        start = self._start(model, around, first)
        if not slopes:
            none = np.zeros((model.nv, 0))
            start = replace(start, by_q=none, by_v=none)
        if run[0] and self.smooth is not None:  # creep remembers the motion before
            known = self.unknowns if start.by_q.size else ()
            creep = creeping_springs(model, known, start.by_q.shape[1])
            if creep is not None:
                before = slice(0, run[0] + 1)
                torques = creep.along(self.data.t[before], self.smooth[0, before])
                start = replace(start, torques=torques)
        unknowns, driven = self.unknowns if start.by_q.size else (), self._driven(run)
        return follow(model, unknowns, t, u, start, driven, self.step, around, self.finer)

    def _late(self, model: SoftModel, run: Run, out: np.ndarray, slope: np.ndarray) -> None:
        names, robot = self.data.names, model.robot
        t, known = self.data.t[slice(*run)], np.isfinite(self.data.outputs[slice(*run)])
        late = read_late(robot, names, t, known, self.smooth is None, out, slope)
        for k, one in enumerate(self.unknowns if slope.shape[2] else ()):
            if one.kind is SENSOR_LATENCY:
                slope[:, :, k] += late * of_sensors(robot, names, one.weights)

    def wide(self) -> tuple[np.ndarray, np.ndarray]:
        """Ranges of the free joints, and standard deviations of their first rates.

        The deviations are relative to the smoothed rates. Both are empty if no rates are unknown.
        """
        if self.smooth is None:
            return np.zeros(0), np.zeros(0)
        range_ = np.ptp(self.smooth[0][:, ~self.held], axis=0)
        range_ = np.maximum(range_, 1e-3 * range_.max())
        return range_, range_ / (SHORTEST * np.median(np.diff(self.data.t)))

    def counted(self) -> np.ndarray:
        """Whether each output (outputs,) counts; that of a held joint does not."""
        held = {f"q.{self.base.joint_names[j]}" for j in np.flatnonzero(self.held)}
        return np.array([name not in held for name in self.data.names])

    def firsts(self) -> list[np.ndarray]:
        """The measured first states of the runs: q and v of the joints that are free."""
        if self.smooth is None:
            return [np.zeros(0) for _ in self.runs]
        free = ~self.held
        return [self.smooth[:2, begin, free].ravel() for begin, _ in self.runs]

    def _start(self, model: SoftModel, around: Around, first: np.ndarray) -> Start:
        """The start from the unknown state of the free joints; `follow` sets the held ones."""
        if self.smooth is None:
            return self.at_rest(model, around)
        free = np.flatnonzero(~self.held)
        q, v = np.zeros((2, self.base.nv))
        q[free], v[free] = np.split(first, 2)
        by_q, by_v = np.zeros((2, len(q), len(self.unknowns) + len(first)))
        by_q[free, -2 * len(free) : -len(free)] = by_v[free, -len(free) :] = np.eye(len(free))
        return Start(q, v, by_q, by_v)

    def _driven(self, run: Run) -> Driven | None:
        """Motion of the held joints: the measured one if it exceeds the noise, else none.

        A stop yields to the joint that presses it. Without noise all outputs show this motion. With
        noise, the acceleration of smoothed noise would disturb the other joints more than that.
        """
        joints = np.flatnonzero(self.held)
        if self.smooth is None or not joints.size:
            return None
        columns = [self.data.names.index(f"q.{self.base.joint_names[j]}") for j in joints]
        places = [self.smooth[0, slice(*one)][:, joints] for one in self.runs]
        left = [self.data.outputs[slice(*one)][:, columns] for one in self.runs]
        noise = (np.concatenate(left) - np.concatenate(places)).std(0)
        place = places[self.runs.index(run)]
        place = np.where(place.std(0) > CLEAR * noise, place, place.mean(0))
        return Driven(joints, make_interp_spline(self.data.t[slice(*run)], place, k=5))

    def at_rest(self, model: SoftModel, around: Around) -> Start:
        """The start in equilibrium under the first input."""
        path, by = rests(model, self.unknowns, Inputs(self.data.u[:1], np.zeros(model.nu)), around)
        still = np.zeros(model.nv)
        return Start(path[0], still, by[0], np.zeros_like(by[0]))

    def first_stop(self, theta: np.ndarray) -> int:
        """The first sample at which a joint of the run from rest is at a stop, or the run's end."""
        model = apply_values(self.base, self.unknowns, theta)
        end, none = self.runs[0][1], np.zeros((model.nv, 0))
        t, u = self.data.t[:end], self.data.u[:end]
        around = Around(self.base)
        start = replace(self.at_rest(model, around), by_q=none, by_v=none)
        path, _ = follow(model, (), t, u, start, None, self.step, around)
        near = np.flatnonzero(at_stops(model, path).any(1))
        return int(near[0]) if near.size else end

    # -- the fit -----------------------------------------------------------------------------------

    def starting_point(self) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """From smoothed angles if all joints were measured, else from growing parts of the run."""
        if self.smooth is None:
            return self._of_growing_parts(), self.firsts(), self.first_noise()
        guess = first_guess(self.base, self.unknowns, self.data, self.smooth, self.stops)
        return self.joined(self._better(near_file(self.unknowns, guess), guess))

    def _better(self, near: np.ndarray, far: np.ndarray) -> np.ndarray:
        """The one of two guesses under which short pieces of the runs stay closer to the data.

        Smoothed angles may give a guess that is worse than the file's values. But the file's may be
        wrong by decades.
        """
        if (near == far).all():
            return near
        short = replace(self, runs=_pieces(self.runs, PIECE))
        noise = self.first_noise()
        return min((near, far), key=lambda at: short._misfit(at, noise))

    def joined(self, theta: np.ndarray) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Parameters, first states and noise from short pieces of the runs, joined four by four.

        Some motions are sensitive: after seconds the first guess's motion is far from the measured
        one, and a fit would end in a wrong minimum. A short piece has its own first state and stays
        near the measured motion. Its fit gives a better guess for a longer piece (multiple
        shooting: Bock, Recent advances in parameter identification techniques for O.D.E., 1983).
        """
        noise, known = self.first_noise(), dict[int, np.ndarray]()
        late = max((sensor.latency for sensor in self.base.robot.sensors), default=0.0)
        length = max(PIECE, int(LATE * late / np.median(np.diff(self.data.t))))
        while True:
            parts = replace(self, runs=_pieces(self.runs, length))
            firsts = [
                known.get(begin, first)
                for (begin, _), first in zip(parts.runs, parts.firsts(), strict=True)
            ]
            if parts.runs == self.runs:
                return theta, firsts, noise
            theta, firsts, simulated = parts.solved(theta, firsts, noise, ROUGH)
            noise = parts.noise(theta, simulated, noise)
            known = {begin: first for (begin, _), first in zip(parts.runs, firsts, strict=True)}
            length *= 4

    def _of_growing_parts(self) -> np.ndarray:
        """θ from fits of growing parts of the run, each twice as long, up to half of the run.

        After seconds the motion under the file's values is far from the measured one, and the sum
        of squares has many minima. The first seconds may hold no information, so a part's θ is kept
        only if it also fits the part of twice the length better.
        """
        theta = np.array([parameter.nominal for parameter in self.unknowns])
        whole = self.runs[0][1]
        noise = self.first_noise()
        for short in (whole >> k for k in range(int(math.log2(whole / SHORTEST)), 0, -1)):
            part, ahead = (replace(self, runs=((0, end),)) for end in (short, 2 * short))
            there, _, _ = part.solved(theta, part.firsts(), noise, ROUGH)
            theta = min((theta, there), key=lambda at: ahead._misfit(at, noise))
        return theta

    def _misfit(self, theta: np.ndarray, noise: np.ndarray) -> float:
        """Sum of squares of the runs from their measured first states; inf without a motion."""
        try:
            outputs = self.outputs(theta, self.firsts())
        except (TrajectoryError, StaticsError, InputError):
            return math.inf
        left = [
            (out - self.data.outputs[slice(*run)])[:, self.counted()] / noise[self.counted()]
            for run, out in zip(self.runs, outputs, strict=True)
        ]
        return float(np.nansum(np.concatenate(left) ** 2))

    def noise(
        self, theta: np.ndarray, simulated: Sequence[Simulated], before: np.ndarray
    ) -> np.ndarray:
        """Standard deviations (outputs,) of the residuals; `before` for those that do not count."""
        left = self.residuals(simulated)
        samples = np.isfinite(left).sum(0)
        spent = (len(theta) + sum(len(run.first) for run in simulated)) / left.shape[1]
        power = np.nansum(left**2, axis=0) / np.maximum(samples - spent, 1)
        least = 1e-9 * self.first_noise()
        return np.where(samples > 0, np.maximum(np.sqrt(power), least), before)

    def shorter(self, found: Fit) -> DynamicFit | None:
        """The run from rest up to the first stop of the simulated motion, if it is not there yet.

        Raises
        ------
        InputError
            For too few samples before the stop.
        """
        if self.smooth is not None:
            return None
        end = replace(self, unknowns=found.problem.unknowns).first_stop(found.theta)
        if end == found.problem.runs[0][1]:
            return None
        if end < SHORTEST:
            raise InputError("data", f"{SHORTEST} samples before a joint is at its stop", f"{end}")
        return replace(self, runs=((0, end),))

    def correlation(self, residuals: np.ndarray) -> np.ndarray:
        """Autocorrelation (lags, outputs) of the residuals."""
        return autocorrelation(residuals)

    def half_widths(self, blocks: list[ResidualBlock], residuals: np.ndarray) -> np.ndarray:
        """Half the widths (P,) of the 95 % intervals."""
        return norm.ppf(SHARE) * deviations(reduced(blocks).R)

    def held_out(self, found: Fit, data: Measurements, left_out: np.ndarray) -> np.ndarray:
        """Residuals (N, outputs) of the samples `left_out`, the last ones of the data."""
        split, theta, none = int(left_out[0]), found.theta, np.zeros((0, len(found.noise)))
        if split > len(data.t) - FEWEST:
            return none
        if self.smooth is None:
            whole = replace(self, data=data, runs=((0, len(data.t)),))
            end = whole.first_stop(theta)
            out = whole.outputs(theta, whole.firsts())[0]
            return (data.outputs - out)[split:end]
        changed = apply_values(self.base, self.unknowns, theta)
        try:
            rest = DynamicFit.of(
                changed, data.part(split, len(data.t)), (), self.step, self.seen(theta)
            )
            zero, firsts, _ = rest.joined(np.zeros(0))
            _, _, simulated = rest.solved(zero, firsts, found.noise)
        except InputError:  # no joint moves there, all samples are at stops, or readings are older
            return none
        return rest.residuals(simulated)

    def moved(self, found: Fit) -> float:
        """Largest change of θ with half of every step, over its deviation, to first order.

        It is NaN if the model cannot be simulated with half the step.
        """
        coarse = found.simulated
        try:
            outputs = replace(self, finer=2).outputs(found.theta, [run.first for run in coarse])
        except TrajectoryError:  # the change is unknown, but the fit is still good
            return float("nan")
        fine = [run._replace(out=out) for run, out in zip(coarse, outputs, strict=True)]
        both = (self.blocks(runs, found.noise) for runs in (coarse, fine))
        blocks = [a._replace(residual=b.residual - a.residual) for a, b in zip(*both, strict=True)]
        linear = reduced(blocks)
        return float(np.abs(np.linalg.pinv(linear.R) @ linear.d / deviations(linear.R)).max())


def _pieces(runs: Sequence[tuple[int, int]], length: int) -> tuple[tuple[int, int], ...]:
    """The runs, halved until none has more samples than `length`."""
    found: list[tuple[int, int]] = []
    for begin, end in runs:
        count = 1
        while end - begin > count * length:
            count *= 2
        edges = np.linspace(begin, end, count + 1).astype(int).tolist()
        found += itertools.pairwise(edges)
    return tuple(found)
