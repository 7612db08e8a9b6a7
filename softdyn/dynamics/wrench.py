"""A constant force and torque at a point of a link, as a force of the model: `Wrench`.

With the point's Jacobian J and the link's angular Jacobian J_ω, the joint force is Jᵀ f + J_ωᵀ τ.
Its derivative by q has the curvature of both (`softdyn.dynamics.points`). In the link's axes f and
τ turn with the link, so that J_ω gives them ∂f/∂q_j = ω_j × f.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softdyn.checks import array, instance
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.points import BodyPoint, PointMotion
from softdyn.dynamics.projection import Projection, project, underlying_tree
from softdyn.exceptions import InputError

AXES = ("world", "link")


@dataclass(frozen=True)
class Wrench:
    """A constant force and torque at a point of a link, for `SoftModel.with_forces`.

    Attributes
    ----------
    link : str
        The link.
    force, torque : tuple of float, (3,)
        Force (N) and torque (N m).
    point : tuple of float, (3,)
        The point of the link, in its frame (m).
    axes : str
        The axes of force and torque: ``world``, or ``link``, which turns with the link.
    name : str
        Its name, ``wrench_LINK`` by default.

    Raises
    ------
    InputError
        For other axes, and for anything but three finite numbers in force, torque and point.
    """

    link: str
    force: Sequence[float] = (0.0, 0.0, 0.0)
    torque: Sequence[float] = (0.0, 0.0, 0.0)
    point: Sequence[float] = (0.0, 0.0, 0.0)
    axes: str = "world"
    name: str = ""

    def __post_init__(self) -> None:
        instance("wrench.link", self.link, str, "a link's name")
        for field in ("force", "torque", "point"):
            value = array(f"wrench.{field}", getattr(self, field), (3,))
            object.__setattr__(self, field, tuple(value.tolist()))
        if self.axes not in AXES:
            raise InputError("wrench.axes", " or ".join(AXES), repr(self.axes))
        if not self.name:
            object.__setattr__(self, "name", f"wrench_{self.link}")

    def __call__(self, model: SoftModel, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The joint force (n,)."""
        S = underlying_tree(model)[1]
        _, motion, force, torque = self._at(model, q)
        found: np.ndarray = force @ motion.J + torque @ motion.turning
        return found if S is None else S.T @ found

    def derivatives(
        self, model: SoftModel, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n); the second is zero."""
        S = underlying_tree(model)[1]
        point, motion, force, torque = self._at(model, q)
        by_q = point.curvature(motion, force) + point.turning_curvature(motion, torque)
        if self.axes == "link":
            turning = motion.turning.T
            by_q += motion.J.T @ np.cross(turning, force).T
            by_q += motion.turning.T @ np.cross(turning, torque).T
        return project(S, by_q), np.zeros((model.nv, model.nv))

    def energy(self, model: SoftModel, q: np.ndarray) -> float | None:
        """-f · y (J) of a force in the world's axes at the point y; None for any other wrench."""
        if self.axes != "world" or any(self.torque):
            return None
        tree, _ = underlying_tree(model)
        _, motion, force, _ = self._at(model, q)
        base = q[:3] if tree.chart.floating else np.zeros(3)
        return -float(force @ (motion.y + base))

    def _at(
        self, model: SoftModel, q: np.ndarray
    ) -> tuple[BodyPoint, PointMotion, np.ndarray, np.ndarray]:
        """The point and its motion at q (nq,), force and torque in the world's axes."""
        tree, _ = underlying_tree(model)
        point = tree.link_point(self.link, self.point)
        S, rotations, translations = tree.kinematics_of(
            model.expand(q) if isinstance(model, Projection) else q
        )
        force, torque = np.array(self.force), np.array(self.torque)
        if self.axes == "link":
            origin = tree.anchor(self.link, np.zeros(3))[1]
            turn = rotations[point.body] @ np.stack(
                [tree.anchor(self.link, axis)[1] - origin for axis in np.eye(3)], axis=1
            )
            force, torque = turn @ force, turn @ torque
        return point, point.at(S, rotations, translations), force, torque
