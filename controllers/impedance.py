"""IC and UIC: the closed-form impedance laws, saturated by clamping."""

from __future__ import annotations

import numpy as np

from softdyn import SoftModel, State
from softdyn.compiled import compiled
from softdyn.controllers.controller import Command, InputGuard
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.law import TaskLaw
from softdyn.controllers.programmes.linear_algebra import (
    add,
    cholesky,
    dot,
    factor,
    inner,
    jacobi_svd,
    row_space,
    substitute,
)
from softdyn.controllers.programmes.qp import DenseQp
from softdyn.controllers.programmes.task import Task

# Of the reference implementation: Λ is an inverse, or a pseudo-inverse where the determinant of
# J M⁻¹ Jᵀ is small, and UIC's inner pseudo-inverse has a threshold of its own.
SMALL_DETERMINANT, TASK_INERTIA_RCOND, UIC_RCOND = 1e-2, 1e-2, 1e-8


@compiled
def task_inertia(M: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Λ = (J M⁻¹ Jᵀ)⁻¹ (3, 3), in kg."""
    half = cholesky(M, J)[1]
    mobility = inner(half, half)
    if abs(np.linalg.det(mobility)) >= SMALL_DETERMINANT:
        return np.ascontiguousarray(np.linalg.inv(mobility))
    values, vectors = np.linalg.eigh(mobility)
    inertia = np.zeros((3, 3))
    for i in range(3):
        if abs(values[i]) > TASK_INERTIA_RCOND * np.abs(values).max():
            for x in range(3):
                for y in range(3):
                    inertia[x, y] += vectors[x, i] * vectors[y, i] / values[i]
    return inertia


@compiled
def _law(
    M, h, bias, g, v, J, Jdot, mu_ref, yddot, span, triangle, rows, project
):  # fmt: skip
    """B⁺(Jᵀ f + D q̇ + K + g) before clamping; `project` removes what no input can give.

    f = Λ ÿ + J⁺ᵀ C q̇ - Λ J̇ q̇ with ÿ = ÿ_ref - K_d ė - K_p e: paper, (eq:impedance_acc) and
    (impedance_acc); Jᵀ J⁺ᵀ projects C q̇ onto range(Jᵀ), which the rows of `reach` span.
    """
    n = len(v)
    reach, inertia = row_space(J), task_inertia(M, J)
    acceleration, torque = np.empty(3), np.zeros(n)
    for x in range(3):
        acceleration[x] = yddot[x] + mu_ref[x] - dot(Jdot[x], v)
    for x in range(3):
        add(torque, dot(inertia[x], acceleration), J[x])
    coriolis = bias - g
    for x in range(len(reach)):
        add(torque, dot(reach[x], coriolis), reach[x])
    if project:
        actuated_torque(reach, span, torque)
    torque += h - coriolis
    u, along = np.zeros(rows.shape[1]), np.empty((len(span), 1))
    for i in range(len(span)):
        along[i, 0] = dot(span[i], torque)
    substitute(triangle, along)
    for i in range(len(span)):
        add(u, along[i, 0], rows[i])
    return u


class ImpedanceLaw:
    """u = clamp(B⁺ τ): what IC and UIC share, B⁺ kept while B does not change.

    `project` removes the torques that no input can give.
    """

    solvers: tuple[DenseQp, ...] = ()

    def __init__(self, *, project: bool) -> None:
        self._project = project
        self.reset()

    def reset(self) -> None:
        """Forget B⁺."""
        self._B: np.ndarray | None = None
        self._factors = (np.empty((0, 0)),) * 3

    def command(self, state: State, task: Task, guard: InputGuard) -> Command:
        """The input, clamped to its bounds."""
        if state.B is not self._B:
            self._factors, self._B = factor(state.B.T), state.B
        u = _law(
            state.M, state.h, state.bias, state.g, state.v, state.J, state.Jdot,
            task.mu_ref, task.yddot, *self._factors, self._project,
        )  # fmt: skip
        return guard.accept(u, task.V, np.nan, clamped=True)


class Impedance(TaskLaw):
    """Paper, "Impedance Control": u = clamp(B⁺(Jᵀ f + D q̇ + K + g)), eq. (IC).

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains, optional
        The paper's for a bundled robot by default; required for any other.

    Raises
    ------
    InputError
        No gains for this robot, or a robot without inputs.
    """

    name = "ic"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        super().__init__(model, resolve(model, self.name, gains), ImpedanceLaw(project=False))


class UnderactuatedImpedance(TaskLaw):
    """Paper, "Underactuated Impedance Control", after Mistry & Righetti 2012, eq. (UIC).

    τ = (I - N [(I - I_p) N]⁺) Jᵀ f + D q̇ + K + g with I_p = B B⁺ (n × n; the paper prints B⁺B).

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains, optional
        The paper's for a bundled robot by default; required for any other.

    Raises
    ------
    InputError
        No gains for this robot, or a robot without inputs.
    """

    name = "uic"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        super().__init__(model, resolve(model, self.name, gains), ImpedanceLaw(project=True))


@compiled
def actuated_torque(reach: np.ndarray, range_B: np.ndarray, torque: np.ndarray) -> None:
    """Add N τ_null = -N [(I - I_p) N]⁺ (I - I_p) Jᵀf to Jᵀf, paper (null_tau), in 3 dimensions.

    With principal vectors t_i of range(Jᵀ) and r_i of range(B), t_i·r_j = cos θ_i δ_ij, both
    projectors act in the planes of one pair each, where the sum is (Jᵀf·t_i) r_i / cos θ_i; where
    the pseudo-inverse drops cos θ_i it is (Jᵀf·t_i) t_i (`docs/derivations.md`, section 10).

    Parameters
    ----------
    reach : (r, n) orthonormal rows that span range(Jᵀ).
    range_B : (rank, n) orthonormal rows that span range(B).
    torque : (n,) in range(Jᵀ), changed in place.
    """
    (r, n), a = reach.shape, len(range_B)
    angles, turned = inner(reach, range_B), np.eye(r)
    jacobi_svd(angles, turned)
    cosines, largest = np.empty(r), 0.0
    for i in range(r):
        cosines[i] = np.sqrt(dot(angles[i], angles[i]))
        largest = max(largest, cosines[i])
    if n > r + a:  # outside both ranges every singular value is 1
        largest = 1.0
    parts = np.empty(r)
    for i in range(r):
        parts[i] = dot(reach[i], torque)
    torque[:] = 0.0
    for i in range(r):
        part = dot(turned[i], parts)
        if cosines[i] > UIC_RCOND * largest:
            for j in range(a):
                add(torque, part * angles[i, j] / (cosines[i] * cosines[i]), range_B[j])
        else:
            for j in range(r):
                add(torque, part * turned[i, j], reach[j])
