"""The model's motion under a measured input, and its derivatives by the unknown parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from softdyn.dynamics.balance import BalanceTerms, ForceBalance
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import SoftdynError
from softdyn.identification.parameters import Parameter, columns_of
from softdyn.identification.unknowns.friction import Friction, friction_of
from softdyn.identification.unknowns.kinds import Around, MotionSample
from softdyn.identification.unknowns.relaxation import CreepingSprings

# Five stages with one diagonal entry, order 4, L-stable and stiffly accurate (Hairer and Wanner,
# Solving Ordinary Differential Equations II, table IV.6.5), because joint damping is stiff and
# inputs jump. With samples every 5 ms its error in 5 s of the SpiRob is 1e-3 of 5 mrad of noise. A
# method with two stages of order 2 moved a stiffness by five standard deviations.
STAGES = (
    (1 / 4,),
    (1 / 2, 1 / 4),
    (17 / 50, -1 / 25, 1 / 4),
    (371 / 1360, -137 / 2720, 15 / 544, 1 / 4),
    (25 / 24, -49 / 48, 125 / 16, -85 / 12, 1 / 4),
)
ITERATIONS = 30
TOLERANCE = 1e-9


class TrajectoryError(SoftdynError, ArithmeticError):
    """The model could not be simulated; its parameters are probably far from the robot's."""


@dataclass(frozen=True, eq=False)
class Start:
    """The state at the first sample and its derivatives by all unknowns (n, P).

    Attributes
    ----------
    q, v : ndarray, (n,)
    by_q, by_v : ndarray, (n, P)
    torques : (ndarray, ndarray), optional
        Those of Maxwell branches (nz,), and their derivatives (nz, P); zero by default.
    """

    q: np.ndarray
    v: np.ndarray
    by_q: np.ndarray
    by_v: np.ndarray
    torques: tuple[np.ndarray, np.ndarray] | None = None


Torques = tuple[np.ndarray, np.ndarray]


class CreepingStage(NamedTuple):
    """The torques z of Maxwell branches in one stage, z = (z₀ + hγ k q̇) / (1 + hγ / τ).

    Attributes
    ----------
    creep : CreepingSprings
    begin : (ndarray, ndarray)
        z₀ (nz,) and its derivatives (nz, P).
    hg : float
        hγ (s).
    share : ndarray, (nz,)
        1 / (1 + hγ / τ).
    """

    creep: CreepingSprings
    begin: Torques
    hg: float
    share: np.ndarray

    @classmethod
    def of(
        cls, creep: CreepingSprings, torques: Torques, before: Iterable[tuple[float, Torques]],
        h: float, hg: float,
    ) -> CreepingStage:  # fmt: skip
        """The stage after those of the weights and rates `before`, in a step h from `torques`."""
        z, dz = torques
        for weight, (rate, by) in before:
            z, dz = z + h * weight * rate, dz + h * weight * by
        return cls(creep, (z, dz), hg, 1 / (1 + hg / creep.branches.time))

    def _torque(self, v: np.ndarray) -> np.ndarray:
        branches = self.creep.branches
        moved = self.hg * branches.stiffness * (branches.rates @ v)
        result: np.ndarray = self.share * (self.begin[0] + moved)
        return result

    def force(self, v: np.ndarray) -> np.ndarray:
        """Joint forces (n,) at the rates v (n,), on the left-hand side."""
        return self._torque(v) @ self.creep.branches.rates

    @property
    def slope(self) -> np.ndarray:
        """∂force/∂v (n, n)."""
        rates = self.creep.branches.rates
        return (rates.T * (self.share * self.hg * self.creep.branches.stiffness)) @ rates

    def _by(self, v: np.ndarray) -> np.ndarray:
        """∂z/∂θ (nz, P) at given rates."""
        branches, z = self.creep.branches, self._torque(v)
        by = self.creep.stiffness_by * (branches.rates @ v)[:, None]
        by = by + self.creep.time_by * (z / branches.time**2)[:, None]
        result: np.ndarray = self.share[:, None] * (self.begin[1] + self.hg * by)
        return result

    def load(self, v: np.ndarray) -> np.ndarray:
        """∂force/∂θ (n, P) at given rates."""
        return self.creep.branches.rates.T @ self._by(v)

    def reached(self, v: np.ndarray, dv: np.ndarray) -> Torques:
        """z (nz,) and its derivatives (nz, P), with those of the rates (n, P)."""
        branches = self.creep.branches
        moved = (self.share * self.hg * branches.stiffness)[:, None] * (branches.rates @ dv)
        return self._torque(v), self._by(v) + moved

    def rates(self, reached: Torques) -> Torques:
        """ż and its derivatives."""
        z, dz = ((one - begin) / self.hg for one, begin in zip(reached, self.begin, strict=True))
        return z, dz


def creeping_springs(
    model: SoftModel, unknowns: Sequence[Parameter], count: int
) -> CreepingSprings | None:
    """The branches of a model with the unknowns' values, and derivatives by all P = `count`."""
    kinds = ((one.kind.name, one.weights) for one in unknowns)
    return CreepingSprings.of(model, kinds, count)


class Driven(NamedTuple):
    """Joints (h,) whose motion is known: a spline (h,) over time (s)."""

    joints: np.ndarray
    motion: BSpline

    def at(self, times: np.ndarray) -> np.ndarray:
        """Coordinates, rates and accelerations (times, 3, h)."""
        return np.stack([self.motion(times, order) for order in range(3)], 1)


def follow(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    t: np.ndarray,
    u: np.ndarray,
    start: Start,
    driven: Driven | None = None,
    step: float = np.inf,
    around: Around | None = None,
    finer: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Joint coordinates (N, n) at the samples, and their derivatives (N, n, P).

    The method is a diagonally implicit Runge–Kutta method. Each interval between samples is one
    step, or several of at most `step` seconds, under the input of its beginning. The derivatives
    are those of the discrete equations: with r(q, v, a; θ) = 0 in each stage,
    (M + hγ ∂r/∂v + h²γ² ∂r/∂q) da = -(∂r/∂q dq + ∂r/∂v dv + ∂r/∂θ). Without derivatives (P = 0) it
    takes half the time. The torques of Maxwell branches are part of the state.

    Parameters
    ----------
    model : SoftModel
        The model with the parameters' values.
    unknowns : sequence of Parameter
        The first of the P unknowns.
    t : ndarray, (N,)
        Times (s).
    u : ndarray, (N, m)
        Inputs, each held from its sample to the next one.
    start : Start
    driven : Driven, optional
        Joints that follow their measured motion, because stops push them; `start` has the others.
    step : float
        Longest step (s).
    around : Around, optional
        The model with the file's masses, and neighbours; by default `model` alone.
    finer : int
        Factor of the number of steps in each interval.

    Raises
    ------
    TrajectoryError
        If no solution of a step's equations is found.
    """
    n, count = model.nv, start.by_q.shape[1]
    q, v = start.q.copy(), start.v.copy()
    dq, dv = start.by_q.copy(), start.by_v.copy()
    path, sensitivities = np.empty((len(t), n)), np.empty((len(t), n, count))
    a = np.zeros(n)
    joints = driven.joints if driven else np.zeros(0, int)
    free, known = np.setdiff1d(np.arange(n), joints), np.zeros((len(STAGES), 3, 0))
    ends = np.array([sum(row) for row in STAGES])
    if driven:
        q[joints], v[joints] = driven.at(t[:1])[0, :2]
    rub, balance = friction_of(model), ForceBalance(model, motors=())
    creep = creeping_springs(model, unknowns, count)
    torques = None
    if creep is not None:
        zero = np.zeros(len(creep.branches.time)), np.zeros_like(creep.time_by)
        torques = zero if start.torques is None else start.torques
    for k in range(len(t)):
        path[k], sensitivities[k] = q, dq
        if k + 1 == len(t):
            break
        interval = t[k + 1] - t[k]
        pieces = finer * int(np.ceil(interval / step * (1 - 1e-9)) if np.isfinite(step) else 1)
        h = interval / pieces
        for piece in range(pieces):
            if driven:
                known = driven.at(t[k] + h * (piece + ends))
            q, v, dq, dv, a, torques = _step(
                (model, around or Around(model)), balance, rub, unknowns, q, v, dq, dv, a, u[k], h,
                free, joints, known, creep, torques,
            )  # fmt: skip
    return path, sensitivities


def _step(
    models: tuple[SoftModel, Around], balance: ForceBalance, rub: Friction,
    unknowns: Sequence[Parameter], q: np.ndarray, v: np.ndarray, dq: np.ndarray, dv: np.ndarray,
    a: np.ndarray, u: np.ndarray, h: float, free: np.ndarray, driven: np.ndarray, known: np.ndarray,
    creep: CreepingSprings | None, torques: Torques | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, Torques | None]:  # fmt: skip
    """One step: the state at its end, its derivatives, the last acceleration and the torques.

    `known` (stages, 3, driven) is the motion of the driven joints.
    """
    model, around = models

    def balanced() -> tuple[BalanceTerms, np.ndarray]:
        terms = balance.trusted(model.configuration(Q), V, a, u, no_disturbance)
        r = terms.residual + rub.size * rub.signs(V)
        if stage is not None:
            r += stage.force(V)
        return terms, r[free]

    def linearised(terms: BalanceTerms) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        by_q, by_v = terms.by_q, terms.by_v + rub.slope(V)
        if stage is not None:
            by_v = by_v + stage.slope
        return by_q, by_v, np.linalg.inv((terms.by_a + hg * by_v + hg * hg * by_q)[block])

    def reached() -> tuple[np.ndarray, np.ndarray]:
        V = v0 + hg * a
        Q = q0 + hg * V
        Q[driven], V[driven] = moving[:2]
        return Q, V

    block, no_disturbance = np.ix_(free, free), np.zeros(0)
    slopes: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []  # V, A, dV, dA
    flows: list[Torques] = []  # rates of the torques and of their derivatives
    for weights, moving in zip(STAGES, known, strict=True):
        hg = h * weights[-1]
        a = a.copy()
        a[driven] = moving[2]
        q0, v0, dq0, dv0 = q.copy(), v.copy(), dq.copy(), dv.copy()
        for weight, (V, A, dV, dA) in zip(weights[:-1], slopes, strict=True):
            q0, v0 = q0 + h * weight * V, v0 + h * weight * A
            dq0, dv0 = dq0 + h * weight * dV, dv0 + h * weight * dA
        stage = None
        if creep is not None and torques is not None:
            stage = CreepingStage.of(creep, torques, zip(weights[:-1], flows, strict=True), h, hg)
        last, least, change = np.inf, np.inf, np.zeros(len(free))
        for _ in range(ITERATIONS):
            Q, V = reached()
            terms, r = balanced()
            if (r @ r) > least:  # the step went too far, past the bend of a friction: halve it
                change /= 2
                a[free] += change
                continue
            least = r @ r
            small = TOLERANCE * (1 + np.abs(a).max())
            _, _, inverse = linearised(terms)
            change = inverse @ r
            size = np.abs(change).max(initial=0)
            a = a.copy()
            a[free] -= change
            left = size * min(1.0, size / last) if np.isfinite(last) else size
            if left <= small or not np.isfinite(size):  # `left` estimates the next change
                break
            last = size
        else:
            raise TrajectoryError(f"no solution of a step of {h:.3g} s: give a shorter one")
        if not np.isfinite(a).all():
            raise TrajectoryError("the model's motion is not finite under these parameters")
        dA = np.zeros_like(dq)
        Q, V = reached()
        if dA.size:  # linearise at the solution, not at the last iteration's start
            by_q, by_v, inverse = linearised(balanced()[0])
            state = model.state(model.configuration(Q), V)
            columns = columns_of(unknowns, MotionSample(state, a, u, around), dq.shape[1])
            load = columns + by_q @ (dq0 + hg * dv0) + by_v @ dv0
            if stage is not None:
                load += stage.load(V)
            dA[free] = -inverse @ load[free]
        dV = dv0 + hg * dA
        slopes.append((V, a, dV, dA))
        reached_torques = None
        if stage is not None:
            reached_torques = stage.reached(V, dV)
            flows.append(stage.rates(reached_torques))
        end = (Q, V, dq0 + hg * dV, dV, a, reached_torques)
    return end
