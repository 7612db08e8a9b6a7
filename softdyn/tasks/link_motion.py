"""Motion of points and frames of any link at a State: pose, Jacobian, velocity and J̇ q̇.

Pinocchio gives the joint Jacobian columns S_k = (v_k; ω_k) about the world's origin, and the places
of the bodies. A body has the twist (V; W) = Σ S_k q̇_k over the joints that move it. At q̈ = 0 its
acceleration is (a; α) = Σ (twist before joint k) × S_k q̇_k. For a point p of the body follows

    ṗ = V + W × p,    J̇ q̇ = a + α × p + W × ṗ.

They come from one kernel for all frames, because barriers need those of all links in a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.checks import did_you_mean
from softdyn.compiled import compiled
from softdyn.dynamics.engine import BASE, moved_bodies
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


class FramePlace(NamedTuple):
    """A frame of a link in the moving body that carries it."""

    body: int
    moves: np.ndarray  # (n,) of bool: the degrees of freedom that move it
    rotation: np.ndarray  # (3, 3)
    offset: np.ndarray  # (3,)


class FramePlaces(NamedTuple):
    """The places of k frames."""

    bodies: np.ndarray  # (k,) of int
    moves: np.ndarray  # (k, n) of bool
    rotations: np.ndarray  # (k, 3, 3)
    offsets: np.ndarray  # (k, 3)


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
    """

    def __init__(self, model: SoftModel) -> None:
        self._model: Any = model
        self._tree, self.S = underlying_tree(model)
        self._moves = moved_bodies(self._tree.engine)
        self._places: dict[tuple[str, tuple[float, ...]], FramePlace] = {}

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
        return LinkMotion(*(each[0] for each in self.motions(state, self.places([(link, point)]))))

    def motions(self, state: State, places: FramePlaces) -> LinkMotion:
        """The motions of several frames: every array has one more axis, the first."""
        k, n = places.moves.shape
        rotations, positions, six = np.empty((k, 3, 3)), np.empty((k, 3)), np.empty((k, 6, n))
        velocities, drifts = np.empty((k, 6)), np.empty((k, 6))
        arguments: Any = (
            *self.engine(state), *places, rotations, positions, six, velocities, drifts,
        )  # fmt: skip
        frame_motions(*arguments)
        six = six if self.S is None else six @ self.S
        return LinkMotion(rotations, positions, six, velocities, drifts)

    def places(self, frames: Sequence[tuple[str, tuple[float, ...]]]) -> FramePlaces:
        """The places of several frames, each a link's frame moved to a point (m) of the link.

        Raises
        ------
        InputError
            For a link that the robot does not have.
        """
        found = zip(*(self.place(*frame) for frame in frames), strict=True)
        return FramePlaces(*(np.array(same) for same in found))

    def place(self, link: str, point: tuple[float, ...]) -> FramePlace:
        """The place of a link's frame, moved to `point` (m) of it, in the body that carries it.

        Raises
        ------
        InputError
            For a link that the robot does not have.
        """
        return self._places.get((link, point)) or self._find(link, point)

    def engine(self, state: State) -> tuple[Any, ...]:
        """Arguments of `frame_motions`, views of the engine among them: use them at once.

        They are the tree's Jacobian columns (nt, 6), the bodies' rotations and translations, the
        tree's velocity (nt,), and the place (3,) and number of degrees of freedom of a floating
        base, which the others leave out.
        """
        q, v = state.q, state.v
        if self.S is not None:
            q, v = self._model.expand(q), self.S @ v
            q.flags.writeable = v.flags.writeable = False  # like those of a State
        base, free = (q[:3], len(BASE)) if self._tree.chart.floating else (ZERO, 0)
        return (*self._tree.kinematics(q), v, base, free)

    def _find(self, link: str, point: tuple[float, ...]) -> FramePlace:
        names = [each.name for each in self._tree.robot.links]
        if link not in names:
            raise InputError("link", f"a link of {self._tree.name!r}", did_you_mean(link, names))
        model: Any = self._tree.engine
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
def frame_motions(
    S, rotations, translations, v, base, free, bodies, moves, own, offsets,
    rotation, position, jacobian, velocity, drift,
):  # fmt: skip
    """Write the motions of k frames, their poses in their bodies given by `own` and `offsets`."""
    p, twist, rate = np.empty(3), np.empty(6), np.empty(6)
    for f in range(len(bodies)):
        body = bodies[f]
        for x in range(6):
            twist[x] = rate[x] = velocity[f, x] = 0.0
        for i in range(3):
            p[i] = translations[body, i]
            for j in range(3):
                p[i] += rotations[body, i, j] * offsets[f, j]
                rotation[f, i, j] = 0.0
                for k in range(3):
                    rotation[f, i, j] += rotations[body, i, k] * own[f, k, j]
            position[f, i] = base[i] + p[i]
        for k in range(len(v)):
            if not moves[f, k]:
                for x in range(6):
                    jacobian[f, x, k] = 0.0
                continue
            for i in range(3):
                j, m = (i + 1) % 3, (i + 2) % 3
                if k >= free:  # before a floating base nothing moves
                    turned = twist[3 + j] * S[k, m] - twist[3 + m] * S[k, j]
                    turned += twist[j] * S[k, 3 + m] - twist[m] * S[k, 3 + j]
                    rate[i] += turned * v[k]
                    turned = twist[3 + j] * S[k, 3 + m] - twist[3 + m] * S[k, 3 + j]
                    rate[3 + i] += turned * v[k]
                jacobian[f, i, k] = S[k, i] + S[k, 3 + j] * p[m] - S[k, 3 + m] * p[j]
                jacobian[f, 3 + i, k] = S[k, 3 + i]
            for x in range(6):
                twist[x] += S[k, x] * v[k]
                velocity[f, x] += jacobian[f, x, k] * v[k]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            drift[f, 3 + i] = rate[3 + i]
            drift[f, i] = rate[i] + rate[3 + j] * p[k] - rate[3 + k] * p[j]
            drift[f, i] += velocity[f, 3 + j] * velocity[f, k] - velocity[f, 3 + k] * velocity[f, j]
