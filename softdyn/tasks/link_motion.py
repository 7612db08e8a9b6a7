"""Motion of points and frames of any link at a State: pose, Jacobian, velocity and J̇ q̇.

Joint Jacobian columns are S_k = (v_k; ω_k) about the world's origin, as in
`softdyn.dynamics.kernels`. A body has the twist (V; W) = Σ S_k q̇_k and, at q̈ = 0, the acceleration
(a; α) = Σ Ṡ_k q̇_k over the joints that move it. For a point p of the body follows

    ṗ = V + W × p,    J̇ q̇ = a + α × p + W × ṗ.

A State has no kinematics of its links but the tip's. They are computed when a task first needs
them, and kept for the last State of each thread.
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.checks import did_you_mean
from softdyn.compiled import compiled
from softdyn.dynamics.engine import joint_tree, moved_bodies
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.projection import underlying_tree
from softdyn.exceptions import InputError

ZERO = np.zeros(3)
ZERO.flags.writeable = False


class LinkMotion(NamedTuple):
    """Motion of a frame at a State; everything in the world's axes.

    Attributes
    ----------
    rotation : ndarray, (3, 3)
        R, from the link's axes to the world's.
    position : ndarray, (3,)
        p (m).
    jacobian : ndarray, (6, n)
        ∂(ṗ, ω)/∂q̇: linear rows first.
    velocity : ndarray, (6,)
        (ṗ, ω) (m/s, rad/s).
    drift : ndarray, (6,)
        J̇ q̇, the acceleration (p̈, ω̇) at q̈ = 0.
    """

    rotation: np.ndarray
    position: np.ndarray
    jacobian: np.ndarray
    velocity: np.ndarray
    drift: np.ndarray


class BodyKinematics(NamedTuple):
    """Kinematics of all bodies of a tree at a State, in arrays of their own."""

    S: np.ndarray  # (n, 6)
    rotations: np.ndarray  # (bodies, 3, 3)
    translations: np.ndarray  # (bodies, 3)
    twists: np.ndarray  # (bodies, 6)
    accelerations: np.ndarray  # (bodies, 6)


class FramePlace(NamedTuple):
    """A frame of a link in the moving body that carries it."""

    body: int
    moves: np.ndarray  # (n,) of bool: the degrees of freedom that move it
    rotation: np.ndarray  # (3, 3)
    offset: np.ndarray  # (3,)


class LinkKinematics:
    """Motions of the links of one model.

    Parameters
    ----------
    model : SoftModel
        The robot.

    Attributes
    ----------
    S : ndarray, (nt, n), or None
        The projection of a reduced model onto its tree's nt degrees of freedom.
    columns : ndarray of int, (nt, 2)
        See `softdyn.dynamics.engine.joint_tree`.
    count : int
        Number of bodies, the world included.
    """

    def __init__(self, model: SoftModel) -> None:
        self._model = model
        self._tree, self.S = underlying_tree(model)
        self._moves = moved_bodies(self._tree.pin_model)
        self.columns = joint_tree(self._tree.pin_model)
        self.count = self._moves.shape[1]
        self._places: dict[tuple[str, tuple[float, ...]], FramePlace] = {}
        self._last = threading.local()

    def __reduce__(self) -> tuple[Any, ...]:
        return LinkKinematics, (self._model,)

    @staticmethod
    def of(model: SoftModel) -> LinkKinematics:
        """The kinematics of `model`, made at the first call."""
        known = vars(model)
        if "_link_kinematics" not in known:
            known["_link_kinematics"] = LinkKinematics(model)
        found: LinkKinematics = known["_link_kinematics"]
        return found

    def __call__(
        self, state: State, link: str, point: tuple[float, ...] = (0.0, 0.0, 0.0)
    ) -> LinkMotion:
        """The motion of a link's frame, moved to `point` (m) of the link.

        Raises
        ------
        InputError
            For a link that the robot does not have.
        """
        place = self.place(link, point)
        bodies = self.bodies(state)
        rotation, position, six = np.empty((3, 3)), np.empty(3), np.empty((6, len(self._moves)))
        rates = np.empty((2, 6))
        frame_motion(*bodies, *place, rotation, position, six, rates)
        if self._tree.chart.floating:
            position += self.base(state)
        if self.S is not None:
            six = six @ self.S
        return LinkMotion(rotation, position, six, rates[0], rates[1])

    def place(self, link: str, point: tuple[float, ...]) -> FramePlace:
        """The place of a link's frame, moved to `point` (m) of it, in the body that carries it.

        Raises
        ------
        InputError
            For a link that the robot does not have.
        """
        return self._places.get((link, point)) or self._find(link, point)

    def bodies(self, state: State) -> BodyKinematics:
        """The kinematics of all bodies; another State's overwrite them."""
        last = self._last
        if getattr(last, "state", None) is not state:
            # the arrays of the State before are used again; the world's rows in them stay zero
            last.bodies = self._bodies(state, getattr(last, "bodies", None))
            last.state = state
        found: BodyKinematics = last.bodies
        return found

    def engine(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Its tree's Jacobian columns, rotations and translations, views of the engine; then v."""
        v = state.v if self.S is None else self.S @ state.v
        S, rotations, translations = self._tree.kinematics(self._configuration(state))
        return S, rotations, translations, v

    def base(self, state: State) -> np.ndarray:
        """The place (3,) of a floating base, which `bodies` leave out; else zero."""
        if not self._tree.chart.floating:
            return ZERO
        return self._configuration(state)[:3]

    def _configuration(self, state: State) -> np.ndarray:
        """That of the tree."""
        if self.S is None:
            return state.q
        model: Any = state.model
        found: np.ndarray = model.expand(state.q)
        return found

    def _bodies(self, state: State, bodies: BodyKinematics | None) -> BodyKinematics:
        S, rotations, translations, v = self.engine(state)
        if bodies is None:
            count = self.count
            bodies = BodyKinematics(
                np.empty((len(v), 6)), np.empty((count, 3, 3)), np.empty((count, 3)),
                np.zeros((count, 6)), np.zeros((count, 6)),
            )  # fmt: skip
        _kinematics(S, rotations, translations, self.columns, v, *bodies)
        return bodies

    def _find(self, link: str, point: tuple[float, ...]) -> FramePlace:
        names = [each.name for each in self._tree.robot.links]
        if link not in names:
            raise InputError("link", f"a link of {self._tree.name!r}", did_you_mean(link, names))
        model: Any = self._tree.pin_model
        frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
        body, placement = frame.parentJoint, frame.placement
        place = FramePlace(
            body,
            np.ascontiguousarray(self._moves[:, body]),
            np.array(placement.rotation, order="C"),
            np.array(placement.act(np.array(point, float))),
        )
        self._places[link, point] = place
        return place


@compiled
def _kinematics(
    columns, rotations_in, translations_in, tree, v,
    S, rotations, translations, twists, accelerations,
):  # fmt: skip
    """Copy the engine's results; add the twists, and the accelerations at q̈ = 0."""
    for b in range(len(translations)):
        for i in range(3):
            translations[b, i] = translations_in[b, i]
            for j in range(3):
                rotations[b, i, j] = rotations_in[b, i, j]
    for k in range(len(v)):
        for x in range(6):
            S[k, x] = columns[k, x]
    body_rates(S, tree, v, twists, accelerations)


@compiled
def body_rates(S, tree, v, twists, accelerations):
    """Write the twists and the accelerations at q̈ = 0, both (bodies, 6); the world's are zero."""
    n = len(v)
    for k in range(n):
        for x in range(6):
            twists[tree[k, 0], x] = twists[tree[k, 1], x] + S[k, x] * v[k]
    for k in range(n):
        twist, rate = twists[tree[k, 0]], v[k]
        vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
        a, b, c, d, e, f = S[k, 0], S[k, 1], S[k, 2], S[k, 3], S[k, 4], S[k, 5]
        own, before = accelerations[tree[k, 0]], accelerations[tree[k, 1]]
        own[0] = before[0] + rate * (wy * c - wz * b + vy * f - vz * e)
        own[1] = before[1] + rate * (wz * a - wx * c + vz * d - vx * f)
        own[2] = before[2] + rate * (wx * b - wy * a + vx * e - vy * d)
        own[3] = before[3] + rate * (wy * f - wz * e)
        own[4] = before[4] + rate * (wz * d - wx * f)
        own[5] = before[5] + rate * (wx * e - wy * d)


@compiled
def frame_motion(
    S, rotations, translations, twists, accelerations, body, moves, own, offset,
    rotation, position, jacobian, rates,
):  # fmt: skip
    """Write the motion of a frame, its pose in its body given by `own` and `offset`."""
    R, p = rotations[body], np.empty(3)
    for i in range(3):
        p[i] = translations[body, i]
        for j in range(3):
            p[i] += R[i, j] * offset[j]
            rotation[i, j] = R[i, 0] * own[0, j] + R[i, 1] * own[1, j] + R[i, 2] * own[2, j]
        position[i] = p[i]
    for k in range(len(S)):
        if moves[k]:
            d, e, f = S[k, 3], S[k, 4], S[k, 5]
            jacobian[0, k] = S[k, 0] + e * p[2] - f * p[1]
            jacobian[1, k] = S[k, 1] + f * p[0] - d * p[2]
            jacobian[2, k] = S[k, 2] + d * p[1] - e * p[0]
            jacobian[3, k], jacobian[4, k], jacobian[5, k] = d, e, f
        else:
            for i in range(6):
                jacobian[i, k] = 0.0
    V, A = twists[body], accelerations[body]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rates[0, i] = V[i] + V[3 + j] * p[k] - V[3 + k] * p[j]
        rates[0, 3 + i], rates[1, 3 + i] = V[3 + i], A[3 + i]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rates[1, i] = A[i] + A[3 + j] * p[k] - A[3 + k] * p[j]
        rates[1, i] += V[3 + j] * rates[0, k] - V[3 + k] * rates[0, j]
