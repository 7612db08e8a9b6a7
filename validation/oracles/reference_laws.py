"""The paper's laws written out as the reference implementation has them: nothing condensed.

They differ from `controllers` in what is asked for only: `angular` regulates the tip's angular
velocity to zero beside its position (six task rows instead of three), `scs` solves the programme
with SCS through cvxpy at cvxpy's default tolerances, a failed solve giving zero input, and `clf`
is the reference's CLF-QP, whose objective has V̇² and ‖u‖₁² beside the published terms.
cvxpy, scs and quadprog are no dependencies of this project: ``pip install cvxpy scs quadprog``.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from softdyn import InputError, Reference, SoftModel, State
from softdyn.controllers import Command, Gains, InputGuard, Status
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin

RANK_TOLERANCE = 1e-6
REFERENCE_INPUT_WEIGHT = 0.5  # on ‖u‖₁² in the reference's CLF-QP, finger and SpiRob
RIDGE = 1e-8  # the least-norm choice of `softdyn.controllers.clf_qp`


def make_law(name: str, model: SoftModel, gains: Gains, options: Iterable[str]) -> Any:
    """The law `name` with options out of exact, angular, scs and clf.

    Raises
    ------
    InputError
        A law that the reference implementation does not have, or cvxpy is missing.
    """
    options = set(options)
    task = AngularTask(model) if "angular" in options else Task()
    if name in ("ic", "uic"):
        return ClosedForm(model, gains, task, project=name == "uic")
    if name not in ("clf-qp", "soft-id-clf-qp", "ic-qp"):
        raise InputError("controller", "a law of the paper's table", repr(name))
    solver = Scs() if options & {"scs", "clf"} else GoldfarbIdnani()
    law = InverseDynamics(gains, decrease=name != "ic-qp")
    if name == "clf-qp":
        return Qp(model, gains, task, Linearisation(gains, reference="clf" in options), solver)
    return Qp(model, gains, task, law, solver)


# -- the task --------------------------------------------------------------------------------------


class Task:
    """Position of the tip: J, J̇ (r, n), error e (r,), ẏ_ref and ÿ_ref (r,), with r = 3."""

    def rows(self, state: State, reference: Reference) -> tuple[np.ndarray, ...]:
        """(J, J̇, e, ẏ_ref, ÿ_ref)."""
        e = state.y - reference.y
        return state.J, state.Jdot, e, np.asarray(reference.ydot), np.asarray(reference.yddot)


class AngularTask(Task):
    """The same with the tip's angular velocity below: r = 6, its error and references zero."""

    def __init__(self, model: SoftModel) -> None:
        self._twin = Twin(model.robot)
        self._states = StateMap(model, self._twin)

    def rows(self, state: State, reference: Reference) -> tuple[np.ndarray, ...]:
        """(J, J̇, e, ẏ_ref, ÿ_ref); the angular rows are MuJoCo's."""
        twin, data = self._twin, self._twin.data
        data.qpos[:], data.qvel[:] = self._states.to_twin(state.q, state.v)
        mujoco.mj_fwdPosition(twin.model, data)
        mujoco.mj_comVel(twin.model, data)
        turning, rate = np.zeros((3, twin.model.nv)), np.zeros((3, twin.model.nv))
        mujoco.mj_jacSite(twin.model, data, None, turning, twin.task_site)
        body = twin.model.site_bodyid[twin.task_site]
        mujoco.mj_jacDot(twin.model, data, None, rate, data.site_xpos[twin.task_site], body)
        J, Jdot, *vectors = super().rows(state, reference)
        dofs, none = self._states.dofs, np.zeros(3)
        return (
            np.vstack((J, turning[:, dofs])),
            np.vstack((Jdot, rate[:, dofs])),
            *(np.concatenate((vector, none)) for vector in vectors),
        )


# -- closed forms ----------------------------------------------------------------------------------


class ClosedForm:
    """IC and UIC, paper eqs. (IC) and (UIC), as they are printed."""

    def __init__(self, model: SoftModel, gains: Gains, task: Task, *, project: bool) -> None:
        self.gains, self._task, self._project = gains, task, project
        self.guard = InputGuard(model.u_min, model.u_max)

    def __call__(self, state: State, reference: Reference) -> Command:
        """The input at this state."""
        J, Jdot, e, ydot, yddot = self._task.rows(state, reference)
        v, g = state.v, self.gains
        mobility = J @ np.linalg.solve(state.M, J.T)
        small = abs(np.linalg.det(mobility)) < 1e-2
        inertia = np.linalg.pinv(mobility, rcond=1e-2) if small else np.linalg.inv(mobility)
        ahead = yddot - g.Kp * e - g.Kd * (J @ v - ydot) - Jdot @ v
        J_plus = np.linalg.pinv(J, rcond=RANK_TOLERANCE)
        torque = J.T @ (inertia @ ahead + J_plus.T @ (state.bias - state.g))
        B_plus = np.linalg.pinv(state.B, rcond=RANK_TOLERANCE)
        if self._project:
            N, unreached = np.eye(len(v)) - J_plus @ J, np.eye(len(v)) - state.B @ B_plus
            torque -= N @ np.linalg.pinv(unreached @ N, rcond=1e-8) @ (unreached @ torque)
        u = B_plus @ (torque + state.D @ v + state.K + state.g)
        return self.guard.accept(u, np.nan, np.nan, clamped=True)


# -- programmes ------------------------------------------------------------------------------------


class Programme:
    """Σ wᵢ ‖Aᵢ x - bᵢ‖² + Σ wⱼ ‖Aⱼ x‖₁² s.t. E x = e, a·x ≤ b, lower ≤ x[u] ≤ upper."""

    def __init__(self, size: int, inputs: slice) -> None:
        self.size, self.inputs = size, inputs
        self.squares: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.sums: list[tuple[float, np.ndarray]] = []
        self.E, self.e = np.zeros((0, size)), np.zeros(0)
        self.row: tuple[np.ndarray, float] | None = None


class InverseDynamics:
    """Soft ID-CLF-QP and, without the decrease row, IC-QP: x = (q̈, u, δ)."""

    def __init__(self, gains: Gains, *, decrease: bool) -> None:
        self.gains, self.decrease = gains, decrease

    def write(self, state: State, task: tuple[np.ndarray, ...], mu_ref: np.ndarray) -> Programme:
        """The programme at this state."""
        J, Jdot, e, ydot, yddot = task
        n, m = state.B.shape
        eye = np.eye(n + m + 1)
        q̈, u, δ = eye[:n], eye[n : n + m], eye[-1:]
        p, w = Programme(n + m + 1, slice(n, n + m)), self.gains
        drift = Jdot @ state.v - yddot
        N = np.eye(n) - np.linalg.pinv(J, rcond=RANK_TOLERANCE) @ J
        p.squares = [
            (w.w1, J @ q̈, mu_ref - drift),
            (w.w2, q̈, np.zeros(n)),
            (w.w3, u, np.zeros(m)),
            (w.w4, N @ q̈, -w.null_damping * N @ state.v),
            (w.rho, δ, np.zeros(1)),
        ]
        left, values, _ = np.linalg.svd(state.B, full_matrices=False)
        span = left[:, values > RANK_TOLERANCE * values[0]].T  # range(B): the actuated rows
        p.E, p.e = span @ (state.M @ q̈ - state.B @ u), -span @ state.h
        if self.decrease:
            slope, bound = decrease_row(e, J @ state.v - ydot, w.eps, 1.0)
            p.row = slope @ (J @ q̈) - δ[0], bound - slope @ drift
        return p


class Linearisation:
    """CLF-QP: x = (u, δ), μ = L_g L_f y u + L_f² y - ÿ_ref substituted."""

    def __init__(self, gains: Gains, *, reference: bool) -> None:
        self.gains, self._reference = gains, reference

    def write(self, state: State, task: tuple[np.ndarray, ...], mu_ref: np.ndarray) -> Programme:
        """The programme at this state."""
        J, Jdot, e, ydot, yddot = task
        m, w = state.B.shape[1], self.gains
        eye = np.eye(m + 1)
        u, δ = eye[:m], eye[-1:]
        p = Programme(m + 1, slice(0, m))
        steer = J @ np.linalg.solve(state.M, state.B) @ u
        drift = Jdot @ state.v - J @ np.linalg.solve(state.M, state.h) - yddot
        p.squares = [(w.w1, steer, mu_ref - drift), (w.rho, δ, np.zeros(1))]
        slope, bound = decrease_row(e, J @ state.v - ydot, w.eps, 1.0)
        if self._reference:
            # V̇ of the reference leaves ÿ_ref out, and its square is a part of the cost
            constant = -decrease_row(e, J @ state.v - ydot, w.eps, 0.0)[1]
            drift = drift + yddot
            rate_row = (slope @ steer)[None]
            p.squares.append((1.0, rate_row, -np.array([constant + slope @ drift])))
            p.sums = [(REFERENCE_INPUT_WEIGHT, u)]
        else:
            p.squares.append((RIDGE * float((steer**2).sum()), u, np.zeros(m)))
        p.row = slope @ steer - δ[0], bound - slope @ drift
        return p


def decrease_row(
    e: np.ndarray, edot: np.ndarray, eps: float, rate: float
) -> tuple[np.ndarray, float]:
    """a (r,) and b with V̇ ≤ -rate · V/ε + δ meaning a·μ - δ ≤ b; Q = R = I."""
    r = len(e)
    root, one = np.sqrt(3.0) * np.eye(r), np.eye(r)
    P = np.block([[root / eps**2, one / eps], [one / eps, root]])
    eta = np.concatenate((e, edot))
    gradient = 2 * P @ eta
    V = eta @ P @ eta
    return gradient[r:], -rate * V / eps - gradient[:r] @ edot


class Qp:
    """A law that solves a programme; where its solver has no answer the input is zero, counted."""

    def __init__(self, model: SoftModel, gains: Gains, task: Task, law: Any, solver: Any) -> None:
        self.gains, self._task, self._law, self._solver = gains, task, law, solver
        self.guard = InputGuard(model.u_min, model.u_max)

    def __call__(self, state: State, reference: Reference) -> Command:
        """The input at this state."""
        rows = self._task.rows(state, reference)
        J, _, e, ydot, _ = rows
        mu_ref = -self.gains.Kp * e - self.gains.Kd * (J @ state.v - ydot)
        programme = self._law.write(state, rows, mu_ref)
        x = self._solver(programme, self.guard.u_min, self.guard.u_max)
        if x is None:
            self.guard.fallbacks += 1
            self.guard.not_solved += 1
            zero = np.clip(np.zeros_like(self.guard.u_min), self.guard.u_min, self.guard.u_max)
            return Command(zero, status=Status.NOT_SOLVED)
        return self.guard.accept(x[programme.inputs], np.nan, float(x[-1]), clamped=True)


class GoldfarbIdnani:
    """The exact dual active-set method (quadprog); variables and rows scaled to unit size."""

    def __init__(self) -> None:
        self._quadprog = optional("quadprog", "quadprog")

    def __call__(self, p: Programme, lower: np.ndarray, upper: np.ndarray) -> np.ndarray | None:
        """x, or None."""
        H = 2 * sum(w * A.T @ A for w, A, _ in p.squares)
        g = -2 * sum(w * A.T @ b for w, A, b in p.squares)
        u = np.eye(p.size)[p.inputs]
        rows, bounds = [-p.E, u, -u], [-p.e, lower, -upper]
        if p.row is not None:
            rows.append(-p.row[0][None])
            bounds.append(np.array([-p.row[1]]))
        A, b = np.vstack(rows), np.concatenate(bounds)
        scale = 1 / np.sqrt(np.diag(H) + 1e-300)
        A = A * scale
        norms = np.linalg.norm(A, axis=1)
        norms[norms == 0] = 1.0
        A, b = A / norms[:, None], b / norms
        size = max(1.0, np.abs(b).max(), np.abs(g * scale).max())
        try:
            x = self._quadprog.solve_qp(
                H * np.outer(scale, scale), -g * scale / size, A.T, b / size, len(p.e)
            )[0]
        except ValueError:
            return None
        return x * scale * size


class Scs:
    """SCS through cvxpy at its default tolerances, each norm squared as the reference has it."""

    def __init__(self) -> None:
        self._cp = optional("cvxpy", "cvxpy scs")

    def __call__(self, p: Programme, lower: np.ndarray, upper: np.ndarray) -> np.ndarray | None:
        """x, or None."""
        cp = self._cp
        x = cp.Variable(p.size)
        cost = sum(w * cp.square(cp.norm(A @ x - b)) for w, A, b in p.squares if w)
        cost += sum(w * cp.square(cp.norm(A @ x, 1)) for w, A in p.sums)
        limits = [x[p.inputs] >= lower, x[p.inputs] <= upper]
        if len(p.e):
            limits.append(p.E @ x == p.e)
        if p.row is not None:
            limits.append(p.row[0] @ x <= p.row[1])
        try:
            cp.Problem(cp.Minimize(cost), limits).solve(solver=cp.SCS)
        except (cp.error.SolverError, ValueError):
            return None
        return None if x.value is None else np.array(x.value)


def optional(module: str, packages: str) -> Any:
    """A module that is not a dependency of this project.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(module, f"it installed (pip install {packages})", error) from None
