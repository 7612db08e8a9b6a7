"""The balance of joint forces with its derivatives, in one call of Pinocchio and one kernel.

With the joint forces of springs, dampers, tendons and disturbances, the balance at (q, v, a) is

    r = M a + C v + g + D v + K - B u - E d.

Pinocchio's RNEA derivatives (Carpentier and Mansard 2018) give M a + C v + g, its Jacobians, M, the
joint Jacobian and the placements at once. The kernel adds the other terms. A winch is a cable that
only pulls, see `softdyn.actuation.winches`.

The disturbances d act through E:

- a force f at the tip, Jᵀ f; its Jacobian by q is f · (ω_j × J_k), joint j nearer to the base;
- a payload m at the tip, a point mass: the same derivatives of a robot of this mass alone, times m
  (below zero by its weight alone, since an inertia below zero has no motion);
- a factor 1 + s of the joint springs, -s K;
- offsets o of the springs' rest positions, k o.
"""

from __future__ import annotations

from enum import Enum
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.compiled import compiled
from softdyn.description.robot import sliding
from softdyn.dynamics.engine import Scratch
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.dynamics.tendons import TINY, moment_arms, segment_curvature


class Disturbance(Enum):
    """A slow quantity that the model lacks, estimated beside the state."""

    TIP_FORCE = "tip_force"
    """Force at the tip in the world's axes (N), three components."""
    PAYLOAD = "payload"
    """Mass at the tip (kg)."""
    STIFFNESS = "stiffness"
    """Relative change of all joint springs' stiffness."""
    JOINT_OFFSETS = "joint_offsets"
    """Offsets of the joint springs' rest positions (rad, m), one per degree of freedom."""

    def size(self, model: SoftModel) -> int:
        """The number of its components."""
        return len(self.units(model))

    def units(self, model: SoftModel) -> dict[str, str]:
        """The units of its components by their names, e.g. ``tip_force.x`` in N."""
        parts: dict[str, str] = {"": ""}
        if self is Disturbance.TIP_FORCE:
            parts = dict.fromkeys((".x", ".y", ".z"), "N")
        elif self is Disturbance.PAYLOAD:
            parts = {"": "kg"}
        elif self is Disturbance.JOINT_OFFSETS:
            slide = sliding(model.robot, names := model.joint_names)
            units = ("m" if slides else "rad" for slides in slide)
            parts = {f".{name}": unit for name, unit in zip(names, units, strict=True)}
        return {self.value + part: unit for part, unit in parts.items()}


class BalanceTerms(NamedTuple):
    """The balance at one point.

    Attributes
    ----------
    residual : ndarray, (n,)
        r (N m, N).
    by_q, by_v, by_a : ndarray, (n, n)
        Its Jacobians; the last is M.
    by_d : ndarray, (n, nd)
        -E, its Jacobian by the disturbances.
    by_commands : ndarray, (n, m)
        Its Jacobian by the commands.
    inputs : ndarray, (m,)
        The inputs u that act.
    """

    residual: np.ndarray
    by_q: np.ndarray
    by_v: np.ndarray
    by_a: np.ndarray
    by_d: np.ndarray
    by_commands: np.ndarray
    inputs: np.ndarray


class ForceBalance:
    """The balance of a robot's joint forces, with scratch memory of its own.

    Parameters
    ----------
    model : SoftModel
        The robot's model, without a floating base.
    disturbances : tuple of Disturbance
        The disturbances, in the order of d.
    """

    def __init__(self, model: SoftModel, disturbances: tuple[Disturbance, ...] = ()) -> None:
        tree, self._S = underlying_tree(model)
        self._model, self._tree, n, engine = model, tree, tree.nv, tree.pin_model
        frame = engine.frames[engine.getFrameId(tree.robot.task, pin.FrameType.BODY)]
        tip = frame.parentJoint
        self._scratch = Scratch(engine)
        self._point = Scratch(_point_mass(engine, tip, frame.placement.translation))
        moves_tip = np.zeros(n, bool)
        for j in engine.supports[tip]:
            if j > 0:
                moves_tip[engine.idx_vs[j] : engine.idx_vs[j] + 1] = True
        sizes = [one.size(tree) for one in disturbances]
        first = dict(zip(disturbances, np.cumsum([0, *sizes]), strict=False))
        self._places = np.array([first.get(one, -1) for one in Disturbance])
        actuators = tree.robot.actuators
        winches = [(a.is_winch, a.stiffness, a.damping) for a in actuators]
        tendons = tree.tendons
        self._constants: tuple[Any, ...] = (
            tip, np.array(frame.placement.translation), moves_tip,
            np.column_stack((tree.stiffness, tree.rest, tree.damping)),
            np.column_stack((
                tendons.offset, tree.tendon_stiffness, tree.tendon_rest, tree.tendon_damping,
                tree.tendon_slack,
            )),
            tendons.coefficients,
            np.column_stack((
                tree.gear, tree.u_min, tree.u_max, np.reshape(np.array(winches, float), (-1, 3)),
            )),
            tree.actuated, *tendons.segments,
        )  # fmt: skip
        self._results = (
            np.empty(n), *np.empty((3, n, n)), np.zeros((n, sum(sizes))),
            np.zeros((n, tree.nu)), np.empty(tree.nu),
        )  # fmt: skip
        self._still = np.zeros(n)

    def __call__(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, commands: np.ndarray, d: np.ndarray
    ) -> BalanceTerms:
        """The balance; the next call overwrites the arrays.

        Parameters
        ----------
        q, v, a : ndarray, (nq,), (n,), (n,)
            Configuration, velocity, acceleration.
        commands : ndarray, (m,)
            Inputs u; for a winch the free length of its cable.
        d : ndarray, (nd,)
            Disturbances.
        """
        S = self._S
        if S is not None and isinstance(self._model, Projection):
            q, v, a, d = self._model.expand(q), S @ v, S @ a, self._expanded(d)
        arguments = self.arguments(q, v, a, commands, d)
        balance_terms(*arguments)
        found = BalanceTerms(*arguments[:7])
        return found if S is None else self._projected(found, S)

    def arguments(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, commands: np.ndarray, d: np.ndarray
    ) -> tuple[Any, ...]:
        """Arguments of `balance_terms` at a point of the tree; the first seven are the results."""
        scratch, point = self._scratch, self._point
        pin.computeRNEADerivatives(scratch.model, scratch.data, q, v, a)
        place = self._places[1]
        if place >= 0:
            moves = (v, a) if d[place] >= 0 else (self._still, self._still)
            pin.computeRNEADerivatives(point.model, point.data, q, *moves)
        held = scratch.results()
        if not scratch.arguments or not scratch.in_view:
            whole, mass = (
                (one.tau, *(
                    np.reshape(block, (len(v), len(v)))
                    for block in (one.dtau_dq, one.dtau_dv, one.M.T)
                )) for one in (scratch.data, point.data)
            )  # fmt: skip
            scratch.arguments = (
                *self._results, *whole, *mass, held.S, held.rotations, held.translations
            )  # fmt: skip
        coordinates = self._tree.chart.of(q)
        return (*scratch.arguments, v, coordinates, commands, d, self._places, *self._constants)

    def _expanded(self, d: np.ndarray) -> np.ndarray:
        """The disturbances (nd,) with one offset for each joint of the tree."""
        assert self._S is not None
        first, n = self._places[-1], self._S.shape[1]
        if first < 0:
            return d
        return np.concatenate((d[:first], self._S @ d[first : first + n], d[first + n :]))

    def _projected(self, of_tree: BalanceTerms, S: np.ndarray) -> BalanceTerms:
        residual, by_q, by_v, M, by_d, by_commands, inputs = of_tree
        first, n = self._places[-1], len(S)
        if first >= 0:
            offsets = by_d[:, first : first + n] @ S
            by_d = np.hstack((by_d[:, :first], offsets, by_d[:, first + n :]))
        return BalanceTerms(
            S.T @ residual, S.T @ by_q @ S, S.T @ by_v @ S, S.T @ M @ S, S.T @ by_d,
            S.T @ by_commands, inputs,
        )  # fmt: skip


def _point_mass(engine: pin.Model, joint: int, place: np.ndarray) -> pin.Model:
    """The tree with a mass of 1 kg at a place of a joint, and no other."""
    alone = engine.copy()
    for k in range(len(alone.inertias)):
        alone.inertias[k] = pin.Inertia.Zero()
    alone.inertias[joint] = pin.Inertia(1.0, place, np.zeros((3, 3)))
    alone.armature[:] = 0.0
    return alone


@compiled
def balance_terms(
    residual, by_q, by_v, by_a, by_d, by_commands, inputs, tau, tau_q, tau_v, M, mass_tau, mass_q,
    mass_v, mass_M, S, rotations, translations, v, coordinates, commands, d, places, tip,
    tip_offset, moves_tip, joints, tendons, coefficients, actuators, actuated, bodies, offsets,
    pairs, signs,
):  # fmt: skip
    """Fill in the `BalanceTerms`."""
    n = len(v)
    for i in range(n):
        residual[i] = tau[i]
        for j in range(n):
            by_q[i, j] = tau_q[i, j]
            by_v[i, j] = tau_v[i, j]
            by_a[i, j] = M[i, j]
    if places[1] >= 0:
        mass, inertia = d[places[1]], max(d[places[1]], 0.0)
        for i in range(n):
            residual[i] += mass * mass_tau[i]
            by_d[i, places[1]] = mass_tau[i]
            for j in range(n):
                by_q[i, j] += mass * mass_q[i, j]
                by_v[i, j] += inertia * mass_v[i, j]
                by_a[i, j] += inertia * mass_M[i, j]
    _joints(residual, by_q, by_v, by_d, v, coordinates, d, places, joints)
    if len(tendons) > 0:
        _tendons(
            residual, by_q, by_v, by_commands, inputs, S, rotations, translations, v, coordinates,
            commands, tendons, coefficients, actuators, actuated, bodies, offsets, pairs, signs,
        )  # fmt: skip
    if places[0] >= 0:
        force = d[places[0] : places[0] + 3]
        columns = by_d[:, places[0] : places[0] + 3]
        _tip_force(
            residual, by_q, columns, S, rotations, translations, force, tip, tip_offset, moves_tip
        )


@compiled
def _joints(residual, by_q, by_v, by_d, v, coordinates, d, places, joints):
    """Add the joint springs and dampers, with their disturbances."""
    factor, offsets = places[2], places[3]
    scale = 1.0 + d[factor] if factor >= 0 else 1.0
    for i in range(len(v)):
        stiffness = joints[i, 0]
        stretch = coordinates[i] - joints[i, 1]
        if offsets >= 0:
            stretch -= d[offsets + i]
            by_d[i, offsets + i] = -scale * stiffness
        if factor >= 0:
            by_d[i, factor] = stiffness * stretch
        residual[i] += scale * stiffness * stretch + joints[i, 2] * v[i]
        by_q[i, i] += scale * stiffness
        by_v[i, i] += joints[i, 2]


@compiled
def _tendons(
    residual, by_q, by_v, by_commands, inputs, S, rotations, translations, v, coordinates,
    commands, tendons, coefficients, actuators, actuated, bodies, offsets, pairs, signs,
):  # fmt: skip
    """Subtract the forces of tendons and actuators."""
    n, count = len(v), len(tendons)
    arms, lengths, rates = coefficients.copy(), np.empty(count), np.empty(count)
    for t in range(count):
        lengths[t] = tendons[t, 0]
        for i in range(n):
            lengths[t] += coefficients[t, i] * coordinates[i]
    moment_arms(arms, lengths, S, rotations, translations, bodies, offsets, pairs, signs)
    force, gain, damping = np.zeros(count), np.zeros(count), np.zeros(count)
    for t in range(count):
        rates[t] = 0.0
        for i in range(n):
            rates[t] += arms[t, i] * v[i]
        tension = tendons[t, 1] * (lengths[t] - tendons[t, 2]) + tendons[t, 3] * rates[t]
        if tendons[t, 4] == 0 or tension > 0:
            force[t], gain[t], damping[t] = -tension, tendons[t, 1], tendons[t, 3]
    for i in range(len(actuated)):
        t, gear = actuated[i], actuators[i, 0]
        u, slope = commands[i], gear
        if actuators[i, 3] != 0:
            slope = 0.0
            tension = actuators[i, 4] * (lengths[t] - u) + actuators[i, 5] * rates[t]
            free = -max(tension, 0.0) / gear
            u = min(max(free, actuators[i, 1]), actuators[i, 2])
            if tension > 0 and u == free:
                slope = actuators[i, 4]
                gain[t] += slope
                damping[t] += actuators[i, 5]
        inputs[i] = u
        force[t] += gear * u
        for j in range(n):
            by_commands[j, i] = -slope * arms[t, j]
    for t in range(count):
        for i in range(n):
            arm = arms[t, i]
            if arm != 0:
                residual[i] -= arm * force[t]
                if gain[t] != 0 or damping[t] != 0:
                    for j in range(n):
                        by_q[i, j] += gain[t] * arm * arms[t, j]
                        by_v[i, j] += damping[t] * arm * arms[t, j]
    if len(bodies) > 0:
        start, direction, norms = directions(rotations, translations, bodies, offsets)
        bend, arm_rates = segment_curvature(
            S.T, start, direction, norms, bodies, pairs, signs, force, v
        )
        for i in range(n):
            for j in range(n):
                by_q[i, j] -= bend[i, j]
        for t in range(count):
            if damping[t] != 0:
                for i in range(n):
                    for j in range(n):
                        by_q[i, j] += damping[t] * arms[t, i] * arm_rates[t, j]


@compiled
def directions(rotations, translations, bodies, offsets):
    """Start points and unit directions (segments, 3), and lengths (segments,)."""
    start, direction = np.empty((len(bodies), 3)), np.empty((len(bodies), 3))
    norms = np.empty(len(bodies))
    for s in range(len(bodies)):
        i, j = bodies[s, 0], bodies[s, 1]
        square = 0.0
        for x in range(3):
            a, b = translations[i, x], translations[j, x]
            for y in range(3):
                a += rotations[i, x, y] * offsets[s, y]
                b += rotations[j, x, y] * offsets[s, 3 + y]
            start[s, x], direction[s, x] = a, b - a
            square += (b - a) * (b - a)
        norms[s] = np.sqrt(square)
        for x in range(3):
            direction[s, x] /= max(norms[s], TINY)
    return start, direction, norms


@compiled
def _tip_force(
    residual, by_q, by_force, S, rotations, translations, force, tip, tip_offset, moves_tip
):
    """Subtract a force at the tip."""
    n, y = len(residual), np.empty(3)
    J = np.zeros((n, 3))
    for x in range(3):
        y[x] = translations[tip, x]
        for i in range(3):
            y[x] += rotations[tip, x, i] * tip_offset[i]
    for k in range(n):
        if not moves_tip[k]:
            continue
        J[k, 0] = S[k, 0] + S[k, 4] * y[2] - S[k, 5] * y[1]
        J[k, 1] = S[k, 1] + S[k, 5] * y[0] - S[k, 3] * y[2]
        J[k, 2] = S[k, 2] + S[k, 3] * y[1] - S[k, 4] * y[0]
        for x in range(3):
            residual[k] -= J[k, x] * force[x]
            by_force[k, x] = -J[k, x]
        a, b, c = J[k, 0], J[k, 1], J[k, 2]
        for j in range(k + 1):
            if moves_tip[j]:
                value = (
                    force[0] * (S[j, 4] * c - S[j, 5] * b) + force[1] * (S[j, 5] * a - S[j, 3] * c)
                    + force[2] * (S[j, 3] * b - S[j, 4] * a)
                )  # fmt: skip
                by_q[k, j] -= value
                if j != k:
                    by_q[j, k] -= value
