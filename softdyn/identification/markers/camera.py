"""The camera: a rigid transform from the robot's base to the frame of the measured markers.

A point p of the robot is seen at R p + t, where R = exp(r). Six numbers describe it: t (m) and the
rotation vector r (rad).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from softdyn.checks import array

CAMERA = ("x", "y", "z", "rx", "ry", "rz")
FEWEST_POINTS = 3  # that determine a rigid transform


def kabsch(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The camera (6,) with the least sum of squared distances (Kabsch 1976).

    Parameters
    ----------
    points, seen : ndarray, (k, 3)
        Points of the robot, and where they were seen. Rows with NaN do not count.
    """
    known = np.isfinite(points).all(1) & np.isfinite(seen).all(1)
    points, seen = points[known], seen[known]
    middle, centre = points.mean(0), seen.mean(0)
    left, _, right = np.linalg.svd((seen - centre).T @ (points - middle))
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0]) @ right
    return np.concatenate((centre - turn @ middle, pin.log3(turn)))


def seen_at(camera: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) of the robot in the camera's frame."""
    result: np.ndarray = points @ pin.exp3(camera[3:]).T + camera[:3]
    return result


@dataclass(frozen=True, eq=False)
class MarkerView:
    """How the outputs were seen: the markers among them, and the camera.

    Attributes
    ----------
    positions : tuple of int
        The first of the three outputs of each position: a point, a pose or the tip.
    rotations : tuple of int
        The first of the three outputs of each rotation vector.
    camera : ndarray, (6,)
        The camera's numbers, a first guess if they are fitted.
    """

    positions: tuple[int, ...]
    rotations: tuple[int, ...]
    camera: np.ndarray

    @staticmethod
    def of(names: Sequence[str], camera: Sequence[float] | np.ndarray | None = None) -> MarkerView:
        """The view of outputs of these names; the world's frame by default."""
        triples = [
            [
                k
                for k in range(len(names) - 2)
                if tuple(names[k : k + 3]) == _components(names[k], axes)
            ]
            for axes in (CAMERA[:3], CAMERA[3:])
        ]
        given = np.zeros(6) if camera is None else camera
        return MarkerView(tuple(triples[0]), tuple(triples[1]), array("camera", given, (6,)))

    def points(self, outputs: np.ndarray) -> np.ndarray:
        """The positions (N, positions, 3) among outputs (N, outputs)."""
        columns = np.array(self.positions, int)[:, None] + np.arange(3)
        result: np.ndarray = outputs[:, columns]
        return result

    def seen(self, out: np.ndarray, slope: np.ndarray, data: np.ndarray) -> np.ndarray:
        """Move outputs (N, k) and their derivatives (N, k, P) into the camera's frame, in place.

        A rotation's derivatives are by a turn in the marker's own axes. Its output becomes the
        measured rotation vector plus the turn from the measured to the simulated orientation.

        Returns
        -------
        ndarray, (N, k, 6)
            Derivatives by the camera's numbers.
        """
        by = np.zeros((*out.shape, 6))
        camera = self.camera
        turn, jacobian = pin.exp3(camera[3:]), pin.Jexp3(camera[3:])
        for k in self.positions:
            part = slice(k, k + 3)
            for i, point in enumerate(out[:, part]):
                by[i, part, 3:] = -turn @ pin.skew(point) @ jacobian
            by[:, part, :3] = np.eye(3)
            out[:, part] = out[:, part] @ turn.T + camera[:3]
            slope[:, part] = np.einsum("ab,nbp->nap", turn, slope[:, part])
        for k in self.rotations:
            part = slice(k, k + 3)
            for i in range(len(out)):
                own = pin.exp3(out[i, part])
                by[i, part, 3:] = own.T @ jacobian
                if not np.isfinite(data[i, part]).all():
                    continue
                apart = pin.exp3(data[i, part]).T @ turn @ own
                out[i, part] = data[i, part] + pin.log3(apart)
                both = pin.Jlog3(apart)
                by[i, part], slope[i, part] = both @ by[i, part], both @ slope[i, part]
        return by


def _components(name: str, axes: Sequence[str]) -> tuple[str, ...]:
    stem = name.rpartition(".")[0]
    return tuple(f"{stem}.{axis}" for axis in axes)
