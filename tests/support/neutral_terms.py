"""Dynamics of the neutral form at many states at once, in NumPy: M, bias, g, J, lengths.

A tendon's armature a adds a Jᵀ J to M and a Jᵀ J̇ q̇ to the bias, where J is that of its length.
Compensated weight is in neither bias nor g.

The algorithms are recursive Newton-Euler and composite rigid bodies (Featherstone, Rigid Body
Dynamics Algorithms, chapters 5 and 6). Spatial vectors (angular, linear) are at the world's origin
in the world's axes. No engine is used: this is the oracle for what MuJoCo measures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from softdyn.validation.mjcf.comparison.dynamics import States, Terms
from softdyn.validation.mjcf.comparison.neutral import (
    FREEDOMS,
    WORLD,
    Neutral,
    NeutralTendon,
    Point,
)
from softdyn.validation.mjcf.transform import cross, skew


def rotations(vectors: np.ndarray) -> np.ndarray:
    """Rotation matrices (…, 3, 3) of rotation vectors (…, 3), Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = skew(vectors)
    a = np.sinc(angle / np.pi)
    b = np.sinc(angle / (2 * np.pi)) ** 2 / 2
    return np.eye(3) + a * cross + b * cross @ cross


def motion_cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Spatial cross product a × b of motions (…, 6)."""
    w, v = a[..., :3], a[..., 3:]
    return np.concatenate((cross(w, b[..., :3]), cross(w, b[..., 3:]) + cross(v, b[..., :3])), -1)


def force_cross(a: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Spatial cross product a ×* f of a motion and a force (…, 6)."""
    w, v = a[..., :3], a[..., 3:]
    return np.concatenate((cross(w, f[..., :3]) + cross(v, f[..., 3:]), cross(w, f[..., 3:])), -1)


@dataclass(frozen=True, eq=False)
class Placed:
    """Poses of the parts: rotation (parts, samples, 3, 3), translation (parts, samples, 3)."""

    rotation: np.ndarray
    translation: np.ndarray

    def point(self, part: int, xyz: np.ndarray) -> np.ndarray:
        """A point of a part, or of the root, in the world (samples, 3)."""
        if part == WORLD:
            return np.broadcast_to(xyz, self.translation.shape[1:])
        return self.rotation[part] @ xyz + self.translation[part]


def forward_kinematics(robot: Neutral, states: States) -> Placed:
    """Forward kinematics, a product of exponentials."""
    parts = robot.parts
    turns = np.zeros((len(parts), len(states.v), 3))
    shifts = np.zeros_like(turns)
    for k, (part, q) in enumerate(zip(parts, states.q, strict=True)):
        if part.kind == "slide":
            shifts[k] = q * part.axis
        else:
            turns[k] = q * part.axis if part.kind == "hinge" else q[:, -3:]
        if part.kind == "free":
            shifts[k] = q[:, :3]
    R = rotations(turns)
    points = np.array([part.point for part in parts]).reshape(-1, 1, 3)
    p = shifts + points - np.einsum("ksij,ktj->ksi", R, points)
    for k, part in enumerate(parts):
        if part.parent != WORLD:
            above = R[part.parent]
            p[k] = (above @ p[k][..., None])[..., 0] + p[part.parent]
            R[k] = above @ R[k]
    return Placed(R, p)


def evaluate(robot: Neutral, states: States) -> Terms:
    """Every term at the states."""
    placed = forward_kinematics(robot, states)
    parts, samples, n = robot.parts, len(states.v), robot.nv
    owner = np.repeat(np.arange(len(parts)), [FREEDOMS[part.kind] for part in parts])
    S = _unit_velocities(robot, placed, samples)
    inertia = _spatial_inertias(robot, placed)
    velocity = np.zeros((len(parts), samples, 6))
    acceleration = np.zeros_like(velocity)
    base = np.concatenate((np.zeros(3), -robot.gravity))
    weighed = S * states.v[:, None]
    for k, part in enumerate(parts):
        root = part.parent == WORLD
        own = weighed[:, :, owner == k]
        # its first three coordinates do not rotate
        turning = own[:, :, 3:] if part.kind == "free" else own
        velocity[k] = own.sum(2) if root else velocity[part.parent] + own.sum(2)
        rate = motion_cross(velocity[k], turning.sum(2))
        acceleration[k] = (base if root else acceleration[part.parent]) + rate
    momentum = np.einsum("ksij,ksj->ksi", inertia, velocity)
    force = np.einsum("ksij,ksj->ksi", inertia, acceleration) + force_cross(velocity, momentum)
    for k in range(len(parts) - 1, -1, -1):
        if parts[k].parent != WORLD:
            inertia[parts[k].parent] += inertia[k]
            force[parts[k].parent] += force[k]
    momenta = np.einsum("nsij,sjn->sin", inertia[owner], S)
    upper = np.swapaxes(S, 1, 2) @ momenta
    carried = _ancestors(robot)[np.ix_(owner, owner)]  # row: mover, column: moved
    M = np.where(carried, upper, 0.0)
    M = np.where(carried, M, np.swapaxes(M, 1, 2))
    M[:, np.arange(n), np.arange(n)] += np.array([parts[k].armature for k in owner])
    bias = np.einsum("sin,nsi->sn", S, force[owner])
    lifted = _uplift(robot, placed, S, owner)
    bias, g = bias - lifted, np.einsum("sin,i->sn", momenta, base) - lifted
    move = _Motion(placed, S, owner, _ancestors(robot), velocity, acceleration - base)
    arms = np.zeros((samples, len(robot.cables), n))
    for k, tendon in enumerate(robot.cables):
        arms[:, k], rate = _tendon_row(robot, move, tendon)
        row = arms[:, k]
        if tendon.armature:  # none wraps a shape, as MuJoCo refuses that
            M += tendon.armature * row[:, :, None] * row[:, None, :]
            bias += tendon.armature * rate[:, None] * row
    tips, J = _tips(robot, placed, S, owner)
    ways = lengths(robot, states)
    return Terms(M, bias, g, J, tips, np.array([*ways.values()]).reshape(-1, samples).T, arms)


@dataclass(frozen=True, eq=False)
class _Motion:
    """Motion of the parts at the states: spatial vectors as in `evaluate`, without gravity."""

    placed: Placed
    S: np.ndarray
    owner: np.ndarray
    carried: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    def of(self, point: Point) -> tuple[np.ndarray, ...]:
        """Place, Jacobian (samples, 3, nv), velocity, and acceleration at q̈ = 0 of a point."""
        at = self.placed.point(point.part, point.xyz)
        if point.part == WORLD:
            still = np.zeros((len(at), 3))
            return at, np.zeros((len(at), 3, self.S.shape[2])), still, still
        columns = self.S[:, 3:] - skew(at) @ self.S[:, :3]
        columns = np.where(self.carried[self.owner, point.part], columns, 0.0)
        v, a = self.velocity[point.part], self.acceleration[point.part]
        speed = v[:, 3:] + cross(v[:, :3], at)
        rate = a[:, 3:] + cross(a[:, :3], at) + cross(v[:, :3], speed)
        return at, columns, speed, rate


def _tendon_row(
    robot: Neutral, move: _Motion, tendon: NeutralTendon
) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian (samples, nv) of a tendon's length, and J̇ q̇ (samples,)."""
    names = [robot.parts[k].name for k in move.owner]
    row = np.zeros((len(move.S), robot.nv))
    for joint, coefficient in tendon.terms.items():
        row[:, names.index(joint)] += coefficient
    rate = np.zeros(len(row))
    for divisor, ends in _branches(tendon):
        for (a, Ja, va, aa), (b, Jb, vb, ab) in pairwise(move.of(point) for point in ends):
            length = np.linalg.norm(b - a, axis=1)
            along = (b - a) / np.where(length, length, 1.0)[:, None]
            row += np.einsum("si,sin->sn", along, Jb - Ja) / divisor
            speed, turning = vb - va, length > 0
            stretch = np.einsum("si,si->s", along, speed)
            swing = np.where(turning, np.sum(speed**2, axis=1) - stretch**2, 0.0)
            swing /= np.where(turning, length, 1.0)
            rate += (np.einsum("si,si->s", along, ab - aa) + swing) / divisor
    return row, rate


def _branches(tendon: NeutralTendon) -> Iterator[tuple[float, list[Point]]]:
    """The parts of a path between pulleys, with the divisors of their lengths."""
    divisor: float = 1.0
    points: list[Point] = []
    for point in tendon.path:
        if point.around.startswith("pulley"):
            yield divisor, points
            divisor, points = float(point.around.split()[1]), []
        else:
            points.append(point)
    yield divisor, points


def _uplift(robot: Neutral, placed: Placed, S: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Generalized force (samples, nv) of compensated weight."""
    found = np.zeros((len(S), robot.nv))
    movers = _ancestors(robot)
    for k, part in enumerate(robot.parts):
        mass, *moment = part.uplift
        if mass or any(moment):
            # m (R c + p): the first moment about the world's origin
            arm = placed.rotation[k] @ np.array(moment) + mass * placed.translation[k]
            torque = cross(arm, np.broadcast_to(-robot.gravity, arm.shape))
            force = np.einsum("sin,si->sn", S[:, :3], torque)
            force += np.einsum("sin,i->sn", S[:, 3:], -mass * robot.gravity)
            found += np.where(movers[owner, k], force, 0.0)
    return found


def _unit_velocities(robot: Neutral, placed: Placed, samples: int) -> np.ndarray:
    """Spatial velocity (samples, 6, nv) of the part that each coordinate moves, at unit speed."""
    S = np.zeros((samples, 6, robot.nv))
    first = 0
    for k, part in enumerate(robot.parts):
        R, last = placed.rotation[k], first + FREEDOMS[part.kind]
        if part.kind == "slide":
            S[:, 3:, first] = R @ part.axis
        elif part.kind == "hinge":
            axis = R @ part.axis
            S[:, :3, first] = axis
            S[:, 3:, first] = cross(placed.point(k, part.point), axis)
        else:
            anchor = placed.point(k, part.point)
            S[:, :3, last - 3 : last], S[:, 3:, last - 3 : last] = R, skew(anchor) @ R
            if part.kind == "free":
                S[:, 3:, first : first + 3] = np.eye(3)
        first = last
    return S


def _spatial_inertias(robot: Neutral, placed: Placed) -> np.ndarray:
    """Spatial inertia (parts, samples, 6, 6) of every body at the world's origin."""
    bodies = [part.inertia for part in robot.parts]
    R = placed.rotation
    mass = np.array([body.mass for body in bodies]).reshape(-1, 1, 1, 1)
    com = np.array([body.com for body in bodies]).reshape(-1, 1, 3)
    tensor = np.array([body.tensor for body in bodies]).reshape(-1, 1, 3, 3)
    arm = skew(np.einsum("ksij,ktj->ksi", R, com) + placed.translation)
    found = np.empty((*R.shape[:2], 6, 6))
    found[..., :3, :3] = R @ tensor @ R.swapaxes(2, 3) + mass * arm @ arm.swapaxes(2, 3)
    found[..., :3, 3:] = mass * arm
    found[..., 3:, :3] = -mass * arm
    found[..., 3:, 3:] = mass * np.eye(3)
    return found


def _ancestors(robot: Neutral) -> np.ndarray:
    """(parts, parts) bool: whether the row's part is, or carries, the column's part."""
    found = np.eye(len(robot.parts), dtype=bool)
    for k, part in enumerate(robot.parts):
        if part.parent != WORLD:
            found[:, k] |= found[:, part.parent]
    return found


def _tips(
    robot: Neutral, placed: Placed, S: np.ndarray, owner: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tips (samples, tips, 3) and their Jacobians (samples, tips, 3, nv)."""
    leaves = [k for k in range(len(robot.parts)) if not robot.children(k)]
    movers = _ancestors(robot)
    points, jacobians = [], []
    for k in leaves:
        point = placed.point(k, robot.parts[k].pose.translation)
        columns = S[:, 3:] - skew(point) @ S[:, :3]
        points.append(point)
        jacobians.append(np.where(movers[owner, k], columns, 0.0))
    if not leaves:
        return np.zeros((len(S), 0, 3)), np.zeros((len(S), 0, 3, 0))
    return np.stack(points, 1), np.stack(jacobians, 1)


def lengths(robot: Neutral, states: States) -> dict[str, np.ndarray]:
    """Length (samples,) of every cable; a wrapped shape counts as a point."""
    placed = forward_kinematics(robot, states)
    coordinate = {part.name: q[:, 0] for part, q in zip(robot.parts, states.q, strict=True)}
    found = {}
    for cable in robot.cables:
        length = np.zeros(len(states.v))
        for joint, coefficient in cable.terms.items():
            length = length + coefficient * coordinate[joint]
        for divisor, points in _branches(cable):
            ends = [placed.point(point.part, point.xyz) for point in points]
            for a, b in pairwise(ends):
                length = length + np.linalg.norm(b - a, axis=1) / divisor
        found[cable.name] = length
    return found
