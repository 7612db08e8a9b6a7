"""IC and UIC: the impedance controllers in closed form, with clamped inputs."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.compiled import compiled
from softdyn.controllers.controller import Command, InputGuard
from softdyn.controllers.gains import Gains
from softdyn.controllers.law import InputRule, TaskLaw
from softdyn.controllers.qps.linear_algebra import (
    RANK_TOLERANCE,
    add,
    cholesky,
    dot,
    factor,
    inner,
    jacobi_svd,
    lq,
    lu_solve,
    row_space,
)
from softdyn.controllers.qps.qp import DenseQp
from softdyn.controllers.qps.stacked_error import TaskRows, several_levels


@compiled
def task_force(
    M: np.ndarray, J: np.ndarray, row_basis: np.ndarray, ahead: np.ndarray
) -> np.ndarray:
    """Λ a with Λ = (J M⁻¹ Jᵀ)⁺, as Jᵀ Λ a = Rᵀ x; `docs/derivations.md`, section 10.

    Parameters
    ----------
    M : ndarray, (n, n)
    J : ndarray, (k, n)
    row_basis : ndarray, (r, n)
        R, orthonormal rows that span those of J, without its singular directions.
    ahead : ndarray, (k,)
        a, an acceleration of the tasks; k is 3 for the tip.

    Returns
    -------
    x : ndarray, (r,)
        (R M⁻¹ Rᵀ)⁻¹ (J Rᵀ)⁺ a; NaN if M is singular.
    """
    r = len(row_basis)
    half = cholesky(M, row_basis)[1]
    basis, triangle, x = np.empty((r, len(J))), np.empty((r, r)), np.empty(r)
    lq(inner(row_basis, J), basis, triangle)
    for i in range(r):
        x[i] = dot(basis[i], ahead)
    solved = lu_solve(triangle.T.copy(), x)
    if not (lu_solve(inner(half, half), x) and solved):
        x[:] = np.nan
    return x


@compiled
def _law(
    M, h, bias, g, v, J, Jdot, mu_ref, yddot, span, triangle, rows, project
):  # fmt: skip
    """B⁺(Jᵀ f + D q̇ + K + g) before clamping; `project` removes torques that no input can give.

    f = Λ ÿ + J⁺ᵀ C q̇ - Λ J̇ q̇ with ÿ = ÿ_ref - K_d ė - K_p e: paper, (eq:impedance_acc) and
    (impedance_acc). Jᵀ J⁺ᵀ projects C q̇ onto range(Jᵀ); the rows of `row_basis` span that range.
    """
    row_basis, ahead = row_space(J, RANK_TOLERANCE), np.empty(len(J))
    n, coriolis, torque = len(v), np.empty(len(v)), np.empty(len(v))
    for i in range(n):
        coriolis[i] = bias[i] - g[i]
        torque[i] = h[i] - coriolis[i]
    for x in range(len(J)):
        ahead[x] = yddot[x] + mu_ref[x] - dot(Jdot[x], v)
    force = task_force(M, J, row_basis, ahead)
    for x in range(len(row_basis)):
        force[x] += dot(row_basis[x], coriolis)
    if project:
        add_actuated(row_basis, span, force, torque)
    else:
        for x in range(len(row_basis)):
            add(torque, force[x], row_basis[x])
    u, along = np.zeros(rows.shape[1]), np.empty(len(span))
    for i in range(len(span)):  # triangle along = span torque
        along[i] = dot(span[i], torque)
        for j in range(i):
            along[i] -= triangle[i, j] * along[j]
        along[i] /= triangle[i, i]
        add(u, along[i], rows[i])
    return u


class ImpedanceLaw:
    """u = clamp(B⁺ τ), the common part of IC and UIC; B⁺ is kept while B does not change.

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

    def command(self, state: State, tip: TaskRows, guard: InputGuard) -> Command:
        """The input, clamped to its bounds."""
        if state.B is not self._B:
            self._factors, self._B = factor(state.B.T), state.B
        u = _law(
            state.M, state.h, state.bias, state.g, state.v, tip.J, tip.Jdot,
            tip.mu_ref, tip.yddot, *self._factors, self._project,
        )  # fmt: skip
        return guard.accept(u, tip.V, np.nan, clamped=True)


class Impedance(TaskLaw):
    """Paper, "Impedance Control": u = clamp(B⁺(Jᵀ f + D q̇ + K + g)), eq. (IC).

    Its arguments and errors are those of `TaskLaw`; tasks must have one level.
    """

    name = "ic"
    label = "IC"
    order = 4
    published = MappingProxyType(
        {
            "finger": Gains(500, 0.03),
            "helix": Gains(2000, 0.05),
            "spirob": Gains(500, 0.01),
            "spirob48": Gains(500, 0.01),
        }
    )
    project = False  # onto range(B)

    def _make_rule(self, model: SoftModel, gains: Gains, error: TaskRows) -> InputRule:
        """The clamped law.

        Raises
        ------
        InputError
            For tasks of several levels, because a clamped input keeps none of them.
        """
        if several_levels(error):
            raise InputError("tasks", "one level, in a closed form; ic-qp keeps levels", "several")
        return ImpedanceLaw(project=self.project)


class UnderactuatedImpedance(Impedance):
    """Paper, "Underactuated Impedance Control", after Mistry & Righetti 2012, eq. (UIC).

    τ = (I - N [(I - I_p) N]⁺) Jᵀ f + D q̇ + K + g with I_p = B B⁺ (n × n; the paper prints B⁺B). Its
    arguments are those of `Impedance`.
    """

    name = "uic"
    label = "UIC"
    order = 5
    published = MappingProxyType(
        {
            "finger": Gains(500, 0.03),
            "helix": Gains(1000, 0.05),
            "spirob": Gains(500, 0.01),
            "spirob48": Gains(500, 0.01),
        }
    )
    project = True


@compiled
def add_actuated(
    row_basis: np.ndarray, range_B: np.ndarray, force: np.ndarray, torque: np.ndarray
) -> None:
    """Add (I - N [(I - I_p) N]⁺) t to `torque`, paper (UIC), in at most 3 dimensions.

    Let t_i and r_i be the principal vectors of range(Jᵀ) and range(B), with t_i·r_j = cos θ_i δ_ij.
    Both projectors act within the plane of each pair. The sum there is (t·t_i) r_i / cos θ_i, or
    (t·t_i) t_i if cos θ_i counts as zero (`docs/derivations.md`, section 10).

    Parameters
    ----------
    row_basis : (r, n) orthonormal rows that span range(Jᵀ).
    range_B : (rank, n) orthonormal rows that span range(B).
    force : (r,) t in the rows of `row_basis`.
    torque : (n,) changed in place.
    """
    (r, n), a = row_basis.shape, len(range_B)
    angles, turned = inner(row_basis, range_B), np.eye(r)
    jacobi_svd(angles, turned)
    cosines, largest = np.empty(r), 0.0
    for i in range(r):
        cosines[i] = np.sqrt(dot(angles[i], angles[i]))
        largest = max(largest, cosines[i])
    if n > r + a:  # outside both ranges every singular value is 1
        largest = 1.0
    for i in range(r):
        part = dot(turned[i], force)
        if cosines[i] > RANK_TOLERANCE * largest:
            for j in range(a):
                add(torque, part * angles[i, j] / (cosines[i] * cosines[i]), range_B[j])
        else:
            for j in range(r):
                add(torque, part * turned[i, j], row_basis[j])
