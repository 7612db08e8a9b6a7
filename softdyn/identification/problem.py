"""The residuals of a fit: simulates the runs of the data in which no stop acts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from softdyn.checks import instance, instances, number
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError
from softdyn.identification.blocks import ResidualBlock
from softdyn.identification.data import (
    SHORTEST,
    Measurements,
    at_stops,
    check_data,
    stretches,
)
from softdyn.identification.linear import smoothed
from softdyn.identification.markers.camera import MarkerView
from softdyn.identification.outputs import measured_outputs, of_sensors
from softdyn.identification.parameters import Parameter, neighbours_of, with_values
from softdyn.identification.rests import Inputs, rests
from softdyn.identification.trajectory import Driven, Start, follow
from softdyn.identification.unknowns.kinds import (
    INPUT_LOSS,
    SEEN,
    SENSOR_BIAS,
    SENSOR_LATENCY,
    Around,
)
from softdyn.identification.unknowns.sensor_errors import READ, biases, read_late

CLEAR = 10  # a held joint follows its measurement if its motion over its noise is larger


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


@dataclass(frozen=True, eq=False)
class FitProblem:
    """The data of a fit's residuals, without the values of its unknowns.

    Attributes
    ----------
    base : SoftModel
        The model with the file's values.
    unknowns : tuple of Parameter
    data : Measurements
    step : float
        Longest step (s) of the simulation.
    runs : tuple of (begin, end)
        Stretches of samples that are simulated.
    smooth : ndarray, (3, N, n), or None
        Smoothed angles, rates and accelerations. None if not all joints were measured; there is
        then one run, which begins at rest.
    stops : ndarray of bool, (N, n)
        The result of `at_stops`.
    held : ndarray of bool, (n,)
        Joints that are at their stops in all runs.
    finer : int
        Factor of the number of steps in each interval between samples.
    taken : Acquisition
        How the data were taken.
    """

    base: SoftModel
    unknowns: tuple[Parameter, ...]
    data: Measurements
    step: float
    runs: tuple[tuple[int, int], ...]
    smooth: np.ndarray | None
    stops: np.ndarray
    held: np.ndarray
    finer: int = 1
    taken: Acquisition = PLAIN

    def simulated(self, theta: np.ndarray, firsts: Sequence[np.ndarray]) -> list[Simulated]:
        """Outputs of each run and their derivatives by θ and by the run's first state."""
        model, count, found = with_values(self.base, self.unknowns, theta), len(theta), []
        around = Around(self.base, neighbours_of(self.base, self.unknowns, theta))
        for run, first in zip(self.runs, firsts, strict=True):
            start = None if self.taken.static else self._start(model, around, run, first)
            out, slope = self._outputs(model, theta, run, start, around)
            found.append(Simulated(out, slope[:, :, :count], slope[:, :, count:], first))
        return found

    def outputs(self, theta: np.ndarray, firsts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Outputs (N, outputs) of each run without derivatives, in half the time."""
        model, found = with_values(self.base, self.unknowns, theta), []
        around, none = Around(self.base), np.zeros((model.nv, 0))
        for run, first in zip(self.runs, firsts, strict=True):
            start = None
            if not self.taken.static:
                start = replace(self._start(model, around, run, first), by_q=none, by_v=none)
            found.append(self._outputs(model, theta, run, start, around)[0])
        return found

    def _outputs(
        self, model: SoftModel, theta: np.ndarray, run: tuple[int, int], start: Start | None,
        around: Around,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        t, u = self.data.t[slice(*run)], self.data.u[slice(*run)]
        if start is None:
            path, by = rests(model, self.unknowns, self.inputs(theta, run), around)
        else:
            unknowns, driven = self.unknowns if start.by_q.size else (), self._driven(run)
            path, by = follow(model, unknowns, t, u, start, driven, self.step, around, self.finer)
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
        self, model: SoftModel, run: tuple[int, int], path: np.ndarray, by: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Outputs of a path with the errors of the model's sensors, and their derivatives."""
        names, robot = self.data.names, model.robot
        out, slope = measured_outputs(model, names, path, by)
        if not any(name.startswith(READ) for name in names):
            return out, slope
        if not self.taken.static:
            t, known = self.data.t[slice(*run)], np.isfinite(self.data.outputs[slice(*run)])
            late = read_late(robot, names, t, known, self.smooth is None, out, slope)
            for k, one in enumerate(self.unknowns if slope.shape[2] else ()):
                if one.kind is SENSOR_LATENCY:
                    slope[:, :, k] += late * of_sensors(robot, names, one.weights)
        bias = biases(robot)
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

    def inputs(self, theta: np.ndarray, run: tuple[int, int]) -> Inputs:
        """The inputs of static rows, with what friction takes of them."""
        loss = np.zeros(self.base.nu)
        for one, value in zip(self.unknowns, theta, strict=True):
            if one.kind is INPUT_LOSS:
                loss += value * one.weights
        data, part = self.data, slice(*run)
        way = None if data.direction is None else data.direction[part]
        return Inputs(data.u[part], loss, way, self.taken.guesses)

    def seen(self, theta: np.ndarray) -> Acquisition:
        """The experiment with the camera of θ."""
        if self.taken.view is None:
            return self.taken
        camera = np.array(self.taken.view.camera)
        for one, value in zip(self.unknowns, theta, strict=True):
            if one.kind is SEEN:
                camera[one.weights != 0] = value
        return replace(self.taken, view=replace(self.taken.view, camera=camera))

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
        if self.smooth is None:
            return np.zeros(0), np.zeros(0)
        range_ = np.ptp(self.smooth[0][:, ~self.held], axis=0)
        range_ = np.maximum(range_, 1e-3 * range_.max())
        return range_, range_ / (SHORTEST * np.median(np.diff(self.data.t)))

    def residuals(self, simulated: Sequence[Simulated]) -> np.ndarray:
        """Measured minus simulated outputs (N, outputs); NaN for outputs that do not count."""
        left = np.full(self.data.outputs.shape, np.nan)
        use = self.counted()
        for (begin, end), run in zip(self.runs, simulated, strict=True):
            left[begin:end, use] = (self.data.outputs[begin:end] - run.out)[:, use]
        return left

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

    def _start(
        self, model: SoftModel, around: Around, run: tuple[int, int], first: np.ndarray
    ) -> Start:
        """The start from the unknown state of the free joints; `follow` sets the held ones."""
        if self.smooth is None:
            return self.at_rest(model, around)
        free = np.flatnonzero(~self.held)
        q, v = np.zeros((2, self.base.nv))
        q[free], v[free] = np.split(first, 2)
        by_q, by_v = np.zeros((2, len(q), len(self.unknowns) + len(first)))
        by_q[free, -2 * len(free) : -len(free)] = by_v[free, -len(free) :] = np.eye(len(free))
        return Start(q, v, by_q, by_v)

    def _driven(self, run: tuple[int, int]) -> Driven | None:
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


def problem_of(
    model: SoftModel,
    data: Measurements,
    unknowns: tuple[Parameter, ...],
    step: float = np.inf,
    taken: Acquisition = PLAIN,
) -> FitProblem:
    """The problem of these unknowns on the stretches of the data that no stop disturbs."""
    check_data(check_model(model), instance("data", data, Measurements, "Measurements"))
    unknowns = instances("unknowns", unknowns, Parameter, "a Parameter")
    step = number("step", step, above=0.0, finite=False)
    joints = None if taken.static else data.joints(model)
    if joints is None:
        none = np.zeros((len(data.t), model.nv), bool)
        whole = ((0, len(data.t)),)
        return FitProblem(model, unknowns, data, step, whole, None, none, none[0], taken=taken)
    smooth = smoothed(data, joints)
    stops = at_stops(model, smooth[0])
    held, runs = stretches(stops)
    if not runs:
        raise InputError("data", f"{SHORTEST} samples in a row away from the stops", "none")
    # at its stop a held joint moves less than on the way there, so each run is smoothed alone
    for begin, end in runs if held.any() else ():
        part = slice(begin, end)
        smooth[:, part, held] = smoothed(data.part(begin, end), joints[part][:, held])
    return FitProblem(model, unknowns, data, step, tuple(runs), smooth, stops, held, taken=taken)


def first_stop(problem: FitProblem, z: np.ndarray) -> int:
    """The first sample at which a joint of the run from rest is at a stop, or the run's end."""
    model = with_values(problem.base, problem.unknowns, z)
    end, none = problem.runs[0][1], np.zeros((model.nv, 0))
    t, u = problem.data.t[:end], problem.data.u[:end]
    around = Around(problem.base)
    start = replace(problem.at_rest(model, around), by_q=none, by_v=none)
    path, _ = follow(model, (), t, u, start, None, problem.step, around)
    near = np.flatnonzero(at_stops(model, path).any(1))
    return int(near[0]) if near.size else end
