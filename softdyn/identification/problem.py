"""Runs of the data without a stop, simulated: what the residual of the fit depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.identification.blocks import Block
from softdyn.identification.data import AXES, SHORTEST, Measurements, at_stops, stretches
from softdyn.identification.linear import smoothed
from softdyn.identification.parameters import Moment, Parameter, columns_of, with_values
from softdyn.identification.trajectory import Start, follow
from softdyn.statics.equilibria import settle


class Simulated(NamedTuple):
    """Outputs of a run (N, outputs), their derivatives by θ and by its own first state."""

    out: np.ndarray
    by_theta: np.ndarray
    by_first: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem:
    """All that the residual of the fit depends on but the unknowns.

    Attributes
    ----------
    base : SoftModel
        With the file's values.
    unknowns : tuple of Parameter
    data : Measurements
    step : float
        Longest step (s) of the simulation.
    runs : tuple of (begin, end)
        Stretches of samples that are simulated.
    smooth : ndarray, (3, N, n), or None
        Smoothed angles, rates and accelerations; None where not all joints were measured: the one
        run then begins at rest.
    stops : ndarray of bool, (N, n)
        Of `at_stops`.
    held : ndarray of bool, (n,)
        Joints that stand still at their stops in all runs.
    """

    base: SoftModel
    unknowns: tuple[Parameter, ...]
    data: Measurements
    step: float
    runs: tuple[tuple[int, int], ...]
    smooth: np.ndarray | None
    stops: np.ndarray
    held: np.ndarray

    def simulated(self, theta: np.ndarray, firsts: Sequence[np.ndarray]) -> list[Simulated]:
        """Outputs of each run and their derivatives by θ and by the run's first state."""
        model = with_values(self.base, self.unknowns, theta)
        count, found = len(theta), []
        for (begin, end), first in zip(self.runs, firsts, strict=True):
            t, u = self.data.t[begin:end], self.data.u[begin:end]
            moving = self.smooth is not None
            start = self._moving(begin, end, first) if moving else self.at_rest(model)
            path, by = follow(model, self.unknowns, t, u, start, self.held, self.step, self.base)
            out, slope = measured(model, self.data.names, path, by)
            for k, (unknown, value) in enumerate(zip(self.unknowns, theta, strict=True)):
                shift = unknown.shift(model, self.data.names)
                out, slope[:, :, k] = out + value * shift, slope[:, :, k] + shift
            found.append(Simulated(out, slope[:, :, :count], slope[:, :, count:]))
        return found

    def blocks(self, simulated: Sequence[Simulated], noise: np.ndarray) -> list[Block]:
        """Residuals over their noise, of the outputs that count."""
        use, found = self.counted(), []
        for (begin, end), run in zip(self.runs, simulated, strict=True):
            residual = ((run.out - self.data.outputs[begin:end]) / noise)[:, use]
            slopes = [(part / noise[:, None])[:, use] for part in run[1:]]
            found.append(
                Block(residual.ravel(), *(part.reshape(residual.size, -1) for part in slopes))
            )
        return found

    def residuals(self, simulated: Sequence[Simulated]) -> np.ndarray:
        """Measured less simulated (N, outputs); NaN where it does not count."""
        left = np.full(self.data.outputs.shape, np.nan)
        use = self.counted()
        for (begin, end), run in zip(self.runs, simulated, strict=True):
            left[begin:end, use] = (self.data.outputs[begin:end] - run.out)[:, use]
        return left

    def counted(self) -> np.ndarray:
        """Which outputs (outputs,) count: not those of joints that are held."""
        held = {f"q.{self.base.joint_names[j]}" for j in np.flatnonzero(self.held)}
        return np.array([name not in held for name in self.data.names])

    def firsts(self) -> list[np.ndarray]:
        """The measured first states of the runs: q and v of the joints that are free."""
        if self.smooth is None:
            return [np.zeros(0) for _ in self.runs]
        free = ~self.held
        return [self.smooth[:2, begin, free].ravel() for begin, _ in self.runs]

    def _moving(self, begin: int, end: int, first: np.ndarray) -> Start:
        """From the unknown state of the free joints; the held ones are where their stops are."""
        assert self.smooth is not None
        free = np.flatnonzero(~self.held)
        q, v = self.smooth[0, begin:end].mean(0), np.zeros(self.base.nv)
        q[free], v[free] = np.split(first, 2)
        by_q, by_v = np.zeros((2, len(q), len(self.unknowns) + len(first)))
        by_q[free, -2 * len(free) : -len(free)] = by_v[free, -len(free) :] = np.eye(len(free))
        return Start(q, v, by_q, by_v)

    def at_rest(self, model: SoftModel) -> Start:
        """In equilibrium under the first input."""
        n, count = model.nv, len(self.unknowns)
        by_q, by_v = np.zeros((2, n, count))
        u = self.data.u[0]
        rest = settle(model, u)
        state = model.state(rest.q, np.zeros(n))
        moment = Moment(state, np.zeros(n), u, self.base)
        columns = columns_of(self.unknowns, moment, count)
        free = (model.coordinates(rest.q) > model.lower) & (model.coordinates(rest.q) < model.upper)
        block = np.ix_(free, free)
        by_q[free] = -np.linalg.solve(stiffness(model, rest.q, u)[block], columns[free])
        return Start(model.coordinates(rest.q), np.zeros(n), by_q, by_v)


def measured(
    model: SoftModel, names: Sequence[str], path: np.ndarray, by: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The outputs (N, outputs) of a path (N, n), and their derivatives from the path's."""
    out, slope = np.empty((len(path), len(names))), np.empty((len(path), len(names), by.shape[2]))
    joints = {f"q.{name}": k for k, name in enumerate(model.joint_names)}
    of_joints = [(k, joints[name]) for k, name in enumerate(names) if name in joints]
    of_tip = [(k, AXES.index(name[-1])) for k, name in enumerate(names) if name.startswith("tip.")]
    lengths = {f"length.{name}": k for k, name in enumerate(model.tendons.names)}
    of_cables = [(k, lengths[name]) for k, name in enumerate(names) if name in lengths]
    for k, j in of_joints:
        out[:, k], slope[:, k] = path[:, j], by[:, j]
    if of_tip or of_cables:
        still = np.zeros(model.nv)
        for i, point in enumerate(path):
            state = model.state(model.configuration(point), still)
            for k, axis in of_tip:
                out[i, k], slope[i, k] = state.y[axis], state.J[axis] @ by[i]
            for k, t in of_cables:
                out[i, k], slope[i, k] = state.lengths[t], state.moment_arms[t] @ by[i]
    return out, slope


def problem_of(
    model: SoftModel, data: Measurements, unknowns: tuple[Parameter, ...], step: float
) -> Problem:
    """What is to be fitted."""
    joints = data.joints(model)
    if joints is None:
        none = np.zeros((len(data.t), model.nv), bool)
        return Problem(model, unknowns, data, step, ((0, len(data.t)),), None, none, none[0])
    smooth = smoothed(data, joints)
    stops = at_stops(model, smooth[0])
    held, runs = stretches(stops)
    if not runs:
        raise InputError("data", f"{SHORTEST} samples in a row away from the stops", "none")
    return Problem(model, unknowns, data, step, tuple(runs), smooth, stops, held)


def first_stop(problem: Problem, z: np.ndarray) -> int:
    """The sample at which the run that began at rest comes to a stop, or the run's end."""
    model = with_values(problem.base, problem.unknowns, z)
    end = problem.runs[0][1]
    t, u, start = problem.data.t[:end], problem.data.u[:end], problem.at_rest(model)
    path, _ = follow(model, problem.unknowns, t, u, start, None, problem.step, problem.base)
    near = np.flatnonzero(at_stops(model, path).any(1))
    return int(near[0]) if near.size else end
