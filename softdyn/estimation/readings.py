"""The readings of a channel and their derivatives, without a `State` if its sensors need none.

Lengths, positions and joints depend on q alone. One kernel computes them from Pinocchio's joint
Jacobian. `softdyn.sensing.Sensors` reads all others, and the sensors of a robot with mimic joints.

A turn about joint j carries the Jacobian columns J_k of a point that joint k moves, if joint k is
not nearer to the base. The second derivatives of a point are therefore ω_j × J_k; those of lengths
are in `softdyn.dynamics.tendons`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.compiled import compiled
from softdyn.description.rig import Sensor, SensorKind
from softdyn.dynamics.engine import Scratch, moved_bodies
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import underlying_tree
from softdyn.dynamics.tendons import moment_arms, segment_curvature
from softdyn.estimation.balance import directions
from softdyn.sensing import Sensors
from softdyn.sensing.sensors import place_of

STEP = 1e-5  # rad, m; of the differences of other sensors' Jacobians
SIMPLE = (SensorKind.LENGTH, SensorKind.JOINT, SensorKind.POSITION)  # the kernel's numbers


class Prediction(NamedTuple):
    """The readings of a reader.

    Attributes
    ----------
    values : ndarray, (k,)
        The readings without errors.
    jacobian : ndarray, (k, 2n)
        Their derivatives by q and v.
    """

    values: np.ndarray
    jacobian: np.ndarray


class Reader:
    """Sensors of a robot on a fixed base, with scratch memory of their own.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    sensors : tuple of Sensor
        Its sensors.

    Attributes
    ----------
    components : Components
        Names and kinds of the readings.
    """

    def __init__(self, model: SoftModel, sensors: tuple[Sensor, ...]) -> None:
        self._model, self._sensors = model, Sensors(model, sensors)
        self.components = self._sensors.components
        size = len(self.components.names)
        self._found = Prediction(np.empty(size), np.zeros((size, 2 * model.nv)))
        tree, S = underlying_tree(model)
        self._simple = S is None and all(sensor.kind in SIMPLE for sensor in sensors)
        if not self._simple:
            return
        self._tree, self._scratch = tree, Scratch(tree.pin_model)
        places = [place_of(tree, sensor) for sensor in sensors]
        numbers = [
            (SIMPLE.index(one.kind), at.number) for one, at in zip(sensors, places, strict=True)
        ]
        tendons = tree.tendons
        self._constants: tuple[Any, ...] = (
            np.array(numbers), np.array([at.frame.translation for at in places]),
            moved_bodies(tree.pin_model), np.empty_like(tendons.coefficients),
            np.empty_like(tendons.offset), tendons.coefficients, tendons.offset, *tendons.segments,
        )  # fmt: skip

    def __call__(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> Prediction:
        """The readings at q (nq,), v (nv,) and u (nu,); the next call overwrites the arrays."""
        values, jacobian = self._found
        if not self._simple:
            measured = self._sensors.measure(self._model.state(q, v), u)
            values[:], jacobian[:] = measured.values, measured.jacobian
            return self._found
        pin.computeJointJacobians(self._scratch.model, self._scratch.data, q)
        held = self._scratch.results()
        _read(
            values, jacobian, held.S, held.rotations, held.translations, self._tree.chart.of(q),
            *self._constants,
        )  # fmt: skip
        return self._found

    def hessians(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The second derivatives (k, n, n) by q, symmetric; differences of Jacobians if need be."""
        n = len(v)
        if not self._simple:
            ends = (
                [
                    self(self._model.integrate(q, x), v, u).jacobian[:, :n].copy()
                    for x in (step, -step)
                ]
                for step in STEP * np.eye(n)
            )
            found = np.stack([ahead - behind for ahead, behind in ends], axis=2) / (2 * STEP)
            return 0.5 * (found + found.transpose(0, 2, 1))
        jacobian = self(q, v, u).jacobian
        hessians, held = np.zeros((len(jacobian), n, n)), self._scratch.memory
        numbers, _, moves, _, offset, *_ = self._constants
        _bend(
            hessians, jacobian, held.S, held.rotations, held.translations, numbers, moves,
            np.zeros(len(offset)), *self._tree.tendons.segments,
        )  # fmt: skip
        return hessians


@compiled
def _read(
    values, jacobian, S, rotations, translations, coordinates, sensors, points, moves, arms,
    lengths, coefficients, offset, bodies, ends, pairs, signs,
):  # fmt: skip
    """Fill in the values (k,) and what may differ from zero in their Jacobian (k, 2n).

    `arms` and `lengths` are scratch.
    """
    n, row = len(S), 0
    if sensors[:, 0].min() == 0:
        for t in range(len(lengths)):
            lengths[t] = offset[t]
            for i in range(n):
                arms[t, i] = coefficients[t, i]
                lengths[t] += coefficients[t, i] * coordinates[i]
        moment_arms(arms, lengths, S, rotations, translations, bodies, ends, pairs, signs)
    for s in range(len(sensors)):
        kind, place = sensors[s, 0], sensors[s, 1]
        if kind == 0:
            values[row] = lengths[place]
            for i in range(n):
                jacobian[row, i] = arms[place, i]
            row += 1
        elif kind == 1:
            values[row], jacobian[row, place] = coordinates[place], 1.0
            row += 1
        else:
            y = values[row : row + 3]
            for x in range(3):
                y[x] = translations[place, x]
                for i in range(3):
                    y[x] += rotations[place, x, i] * points[s, i]
            for i in range(n):
                if moves[i, place]:
                    jacobian[row, i] = S[i, 0] + S[i, 4] * y[2] - S[i, 5] * y[1]
                    jacobian[row + 1, i] = S[i, 1] + S[i, 5] * y[0] - S[i, 3] * y[2]
                    jacobian[row + 2, i] = S[i, 2] + S[i, 3] * y[1] - S[i, 4] * y[0]
            row += 3


@compiled
def _bend(
    hessians, jacobian, S, rotations, translations, sensors, moves, force, bodies, ends, pairs,
    signs,
):  # fmt: skip
    """Fill in the zero second derivatives (k, n, n); `force` (tendons,) is zero."""
    n, row, still = len(S), 0, np.zeros(len(S))
    start, direction, norms = directions(rotations, translations, bodies, ends)
    for s in range(len(sensors)):
        kind, place = sensors[s, 0], sensors[s, 1]
        if kind == 0:
            force[place] = 1.0
            hessians[row] = segment_curvature(
                S.T, start, direction, norms, bodies, pairs, signs, force, still
            )[0]
            force[place] = 0.0
        if kind != 2:
            row += 1
            continue
        for k in range(n):
            if not moves[k, place]:
                continue
            a, b, c = jacobian[row, k], jacobian[row + 1, k], jacobian[row + 2, k]
            for j in range(k + 1):
                if moves[j, place]:
                    hessians[row, j, k] = S[j, 4] * c - S[j, 5] * b
                    hessians[row + 1, j, k] = S[j, 5] * a - S[j, 3] * c
                    hessians[row + 2, j, k] = S[j, 3] * b - S[j, 4] * a
                    for x in range(3):
                        hessians[row + x, k, j] = hessians[row + x, j, k]
        row += 3
