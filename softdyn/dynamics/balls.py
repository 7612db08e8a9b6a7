"""Springs and dampers of ball joints, each on three hinges in one point: MuJoCo's law.

The hinges have the axes a_1, a_2, a_3 at q = 0, and turn a body by R = R_1 R_2 R_3. Its angular
velocity, in its own axes, is ω = E q̇ with the columns

    e_1 = R_3ᵀ R_2ᵀ a_1,    e_2 = R_3ᵀ a_2,    e_3 = a_3.

The rotation vector φ = log R has the length of the angle θ ≤ π. The ball's joint force is

    F = -Eᵀ (s(θ) φ + d ω),    s(θ) = k_0 + k_1 θ + k_2 θ²

(MuJoCo's passive force of a ball joint). Three springs of the hinges' angles would be another law
from the second order on. With ∂e_i/∂q_j = -e_j × e_i for j > i, and φ̇ = A(φ) ω where

    A(φ) = 1 + [φ]/2 + c(θ) [φ]²,    c(θ) = 1/θ² - (1 + cos θ)/(2 θ sin θ)

(the inverse right Jacobian of SO(3): Barfoot, State Estimation for Robotics, section 7.1.5), the
derivatives are exact. E is singular where the middle hinge is at ±90°.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from softdyn.checks import read_only
from softdyn.description.robot import Robot

SMALL = 1e-2  # rad: below it c(θ) is its series, whose next term is θ⁶ / 1.2e6
FORTH, BACK = np.array([1, 2, 0]), np.array([2, 0, 1])


class BallSprings:
    """The springs and dampers of all balls as one force of the model.

    It meets the contract of `softdyn.dynamics.forces.Force`.

    Parameters
    ----------
    robot : Robot
        The description, with its balls.
    joint_names : tuple of str, (n,)
        The model's degrees of freedom in the order of q̇.
    """

    name = "balls"

    def __init__(self, robot: Robot, joint_names: tuple[str, ...]) -> None:
        balls, joints = robot.balls, {joint.name: joint for joint in robot.joints}
        self._dofs = np.array([[joint_names.index(name) for name in ball.joints] for ball in balls])
        self._axes = read_only([[joints[name].axis for name in ball.joints] for ball in balls])
        self._springs = read_only([(ball.stiffness, *ball.stiffness_poly) for ball in balls])
        self._damping = read_only([ball.damping for ball in balls])

    def __call__(self, model: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """F (n,) in the order of v (N m)."""
        phi, theta, E = self._rotations(model.chart.of(q))
        torque = self._secant(theta)[:, None] * phi
        torque += self._damping[:, None] * np.einsum("bik,bi->bk", E, v[self._dofs])
        found = np.zeros(len(v))
        found[self._dofs] = -np.einsum("bik,bk->bi", E, torque)
        return found

    def derivatives(
        self, model: Any, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n)."""
        phi, theta, E = self._rotations(model.chart.of(q))
        n, d, rates = len(v), self._damping[:, None, None], v[self._dofs]
        secant = self._secant(theta)
        torque = secant[:, None] * phi
        torque += d[..., 0] * np.einsum("bik,bi->bk", E, rates)
        # turned[b, i, j] = ∂e_i/∂q_j
        turned = -_cross(E[:, None], E[:, :, None]) * np.tri(3, k=-1).T[None, :, :, None]
        # the spring's torque by the rotation: s A + (s'/θ) φ φᵀ, because φᵀ A = φᵀ
        _, k1, k2 = self._springs.T
        slope = np.divide(k1, theta, out=np.zeros_like(theta), where=theta > 0) + 2 * k2
        by_turn = secant[:, None, None] * _inverse_jacobian(phi, theta)
        by_turn += slope[:, None, None] * phi[:, :, None] * phi[:, None, :]
        moved = E @ by_turn.swapaxes(1, 2)  # row j: ∂(torque)/∂q_j
        moved += d * np.einsum("bijk,bi->bjk", turned, rates)
        blocks = -np.einsum("bijk,bk->bij", turned, torque) - E @ moved.swapaxes(1, 2)
        by_q, by_v = np.zeros((n, n)), np.zeros((n, n))
        rows, columns = self._dofs[:, :, None], self._dofs[:, None, :]
        by_q[rows, columns] = blocks
        by_v[rows, columns] = -d * (E @ E.swapaxes(1, 2))
        return by_q, by_v

    def energy(self, model: Any, q: np.ndarray) -> float:
        """Energy of the springs (J)."""
        _, theta, _ = self._rotations(model.chart.of(q))
        k0, k1, k2 = self._springs.T
        return float((theta**2 * (k0 / 2 + theta * (k1 / 3 + theta * k2 / 4))).sum())

    def _secant(self, theta: np.ndarray) -> np.ndarray:
        """s(θ) of each ball."""
        k0, k1, k2 = self._springs.T
        found: np.ndarray = k0 + theta * (k1 + theta * k2)
        return found

    def _rotations(self, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """φ (balls, 3), θ (balls,), and E with the column e_i as the row i (balls, 3, 3)."""
        half = coordinates[self._dofs] / 2
        turns = np.concatenate(
            (np.cos(half)[..., None], np.sin(half)[..., None] * self._axes), axis=-1
        )
        back = turns * (1.0, -1.0, -1.0, -1.0)
        a = self._axes
        E = np.stack(
            (_rotated(back[:, 2], _rotated(back[:, 1], a[:, 0])), _rotated(back[:, 2], a[:, 1]),
             a[:, 2]), axis=1,
        )  # fmt: skip
        whole = _product(_product(turns[:, 0], turns[:, 1]), turns[:, 2])
        whole = whole * np.where(whole[:, :1] < 0, -1.0, 1.0)
        sine = np.linalg.norm(whole[:, 1:], axis=1)
        theta = 2 * np.arctan2(sine, whole[:, 0])
        ratio = np.divide(theta, sine, out=np.full_like(theta, 2.0), where=sine > 0)
        return ratio[:, None] * whole[:, 1:], theta, E


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of vectors (…, 3); a third of the time of NumPy's on small arrays."""
    found: np.ndarray = a[..., FORTH] * b[..., BACK] - a[..., BACK] * b[..., FORTH]
    return found


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of quaternions (balls, 4), the real part first."""
    real = a[:, :1] * b[:, :1] - np.sum(a[:, 1:] * b[:, 1:], axis=1, keepdims=True)
    rest = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + _cross(a[:, 1:], b[:, 1:])
    return np.hstack((real, rest))


def _rotated(turn: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (balls, 3) turned by quaternions (balls, 4)."""
    across = 2 * _cross(turn[:, 1:], vectors)
    found: np.ndarray = vectors + turn[:, :1] * across + _cross(turn[:, 1:], across)
    return found


def _inverse_jacobian(phi: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """A(φ) (balls, 3, 3)."""
    small = theta < SMALL
    safe = np.where(small, 1.0, theta)
    series = 1 / 12 + theta**2 / 720 + theta**4 / 30240
    # (1 + cos θ) / sin θ = 1 / tan(θ/2)
    c = np.where(small, series, 1 / safe**2 - 1 / (2 * safe * np.tan(safe / 2)))
    x, y, z = phi.T
    zero = np.zeros_like(x)
    cross = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)
    found: np.ndarray = np.eye(3) + cross / 2 + c[:, None, None] * (cross @ cross)
    return found
