"""Directions without an input: rank of B, stiffness in them, poles of the zero dynamics.

Paper, section "ID-CLF-QP": the zero dynamics are stable if the stiffness in the unactuated
coordinates dominates gravity, ∂K/∂q_u > -∂g/∂q_u. Here the rows of U are an orthonormal basis of
null(Bᵀ), the directions that no input moves. The test is that the smallest eigenvalue of
U (∂K/∂q + ∂g/∂q) Uᵀ is positive.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from softdyn.checks import whole
from softdyn.dynamics.derivatives import gravity_stiffness, stiffness, tangent_dynamics
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.statics.equilibrium import locked_inputs

RANK_TOLERANCE = 1e-6  # singular values of B below this share of the largest count as zero
UNLIMITED = math.pi  # range in which joints without limits are sampled


@dataclass(frozen=True, eq=False)
class Pose:
    """The robot at one configuration.

    Attributes
    ----------
    name : str
        Name of the pose.
    coordinates : ndarray, (nv,)
        Joint coordinates (rad, m).
    rank : int
        Rank of B.
    unactuated : ndarray, (nv - rank, nv)
        Orthonormal rows that span null(Bᵀ).
    stiffness : ndarray, (nv - rank,)
        Ascending eigenvalues of U (∂K/∂q + ∂g/∂q) Uᵀ (N m/rad, if all joints turn).
    gravity : ndarray, (nv - rank,)
        Descending eigenvalues of -U ∂g/∂q Uᵀ, the stiffness that gravity takes away.
    softest : ndarray, (nv,)
        Unit vector along the smallest stiffness.
    """

    name: str
    coordinates: np.ndarray
    rank: int
    unactuated: np.ndarray
    stiffness: np.ndarray
    gravity: np.ndarray
    softest: np.ndarray

    @property
    def dominates(self) -> bool:
        """Whether stiffness dominates gravity in all directions without an input."""
        return self.least > 0

    @property
    def least(self) -> float:
        """The smallest stiffness in directions without an input; infinite if there are none."""
        return float(self.stiffness.min(initial=math.inf))


def examine(model: SoftModel, coordinates: np.ndarray, name: str = "") -> Pose:
    """Rank of B and stiffness of the unactuated directions at joint coordinates (nv,).

    An input whose bounds leave it one value moves nothing: it is a constant force.
    """
    q = model.configuration(coordinates)
    B, locked = model.state(q, np.zeros(model.nv)).B, locked_inputs(model)
    left, values, _ = np.linalg.svd(_free(B, locked), full_matrices=True)
    rank = int((values > RANK_TOLERANCE * values.max(initial=0.0)).sum())
    U = left[:, rank:].T
    falling, firm = gravity_stiffness(model, q), model.tangent_stiffness(q)
    if locked.any() or model.forced:  # a constant pull adds to the stiffness, as one's own forces
        pull = np.where(locked, model.u_min, 0.0)
        firm = stiffness(model, q, pull) - falling
        firm = (firm + firm.T) / 2  # a force without a potential has a skew part, without work
    total, directions = np.linalg.eigh(U @ (firm + falling) @ U.T)
    softest = directions[:, 0] @ U if len(total) else np.zeros(model.nv)
    if softest[np.abs(softest).argmax()] < 0:
        softest = -softest
    gravity = np.linalg.eigvalsh(-U @ falling @ U.T)[::-1]
    return Pose(name, np.array(coordinates, float), rank, U, total, gravity, softest)


def sample_poses(model: SoftModel, samples: int, seed: int = 0) -> Iterator[Pose]:
    """q = 0, both ends of all joints at once, and `samples` random poses inside the limits."""
    lower = np.where(np.isfinite(model.lower), model.lower, -UNLIMITED)
    upper = np.where(np.isfinite(model.upper), model.upper, UNLIMITED)
    rng = np.random.default_rng(whole("seed", seed))
    yield examine(model, np.zeros(model.nv), "q = 0")
    yield examine(model, lower, "all joints at their lower limits")
    yield examine(model, upper, "all joints at their upper limits")
    for k in range(whole("samples", samples)):
        yield examine(model, rng.uniform(lower, upper), f"random pose {k}")


def find_boundary(
    model: SoftModel, weak: Pose, resolution: float = 1e-3
) -> tuple[float, Pose] | None:
    """The pose between q = 0 and `weak` at which stiffness stops dominating gravity.

    Returns the share of the way, by bisection to `resolution`, and the pose there with the name of
    `weak`. Returns None unless stiffness dominates at q = 0 and does not at `weak`.
    """
    if weak.dominates or not examine(model, np.zeros(model.nv)).dominates:
        return None
    holds, fails, there = 0.0, 1.0, weak
    while fails - holds > resolution:
        middle = (holds + fails) / 2
        pose = examine(model, middle * weak.coordinates, weak.name)
        if pose.dominates:
            holds = middle
        else:
            fails, there = middle, pose
    return fails, there


def zero_spectrum(model: SoftModel, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Poles (2(n - r),) (1/s) of the zero dynamics y ≡ y_d, the largest real part first.

    The dynamics are linearised at zero velocity: M δq̈ + D δq̇ + K_t δq = B δu with
    K_t = ∂(h - B u)/∂q. The inputs can hold the tip in r = rank(J M⁻¹ B) directions, the columns of
    P (3, r). If there are more than r inputs, the δu of least norm is taken, which lies in the row
    space of J M⁻¹ B; B maps this space to the columns of B' (n, r). With N spanning null(Pᵀ J) and
    W B' = 0, the poles solve det(s² W M N + s W D N + W K_t N) = 0. For r inputs they are the
    invariant zeros. They are exact at an equilibrium; at another pose they belong to the dynamics
    frozen there.

    Parameters
    ----------
    model : SoftModel
        A model without mimic joints.
    q : array_like, (nq,)
        Configuration.
    u : array_like, (nu,)
        Input.

    Raises
    ------
    InputError
        For a wrong shape, a number that is not finite, or a robot with mimic joints.
    """
    still = np.zeros(check_model(model).nv)
    state = model.state(q, still)
    B = _free(state.B, locked_inputs(model))
    left, values, right = np.linalg.svd(state.J @ np.linalg.solve(state.M, B))
    r = int((values > RANK_TOLERANCE * values.max(initial=0.0)).sum())
    K, D = tangent_dynamics(model, q, still, u)
    N = np.linalg.svd(left[:, :r].T @ state.J)[2][r:].T
    W = np.linalg.svd(B @ right[:r].T)[0][:, r:].T
    size = model.nv - r
    answers = np.linalg.solve(W @ state.M @ N, -np.hstack((W @ K @ N, W @ D @ N)))
    motion = np.vstack((np.eye(size, 2 * size, size), answers))
    poles = np.linalg.eigvals(motion)
    return poles[np.lexsort((poles.imag, -poles.real))]


def _free(B: np.ndarray, locked: np.ndarray) -> np.ndarray:
    """The columns of B (nv, nu) of inputs that can change."""
    return B[:, ~locked] if locked.any() else B
