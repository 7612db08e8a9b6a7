"""The reference implementation's deviations from the paper, as controllers around the oracle's QPs.

They differ from the paper only by the chosen options. `angular` regulates the tip's angular
velocity to zero in addition to its position, with six task rows instead of three. `scs` solves the
QP with SCS through cvxpy at cvxpy's default tolerances; a failed solve gives zero input. `clf` is
the reference's CLF-QP, whose objective adds V̇² and ‖u‖₁² to the published terms. `thresholds`
gives IC and UIC the reference's thresholds: where a determinant is small, singular values of Λ
below 1e-2 count as zero, and in UIC's projection those below 1e-8. `mass` uses the other
coordinates of the actuated rows. cvxpy, scs and quadprog are no dependencies of this project: ``pip
install cvxpy scs quadprog``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from softdyn import InputError, Reference, SoftModel, State
from softdyn.controllers import Command, Controller, Gains, InputGuard, Status
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin
from tests.support import paper_qps, qp_solvers
from tests.support.paper_qps import TaskTerms, tip
from tests.support.qp_solvers import Quadprog, Solver, SymbolicQp, Term

INPUT_WEIGHT = 0.5  # weight on ‖u‖₁² in the reference's CLF-QP, finger and SpiRob
DIFFERENCE = 1e-6  # s, over which the reference differentiates J
RIDGE = 1e-7  # of the proximal iteration on CLF-QP's semidefinite QP
TermsOf = Callable[[State, Reference], TaskTerms]


def make_law(name: str, model: SoftModel, gains: Gains, options: Iterable[str]) -> Controller:
    """The controller `name` with any of exact, angular, difference, thresholds, mass, scs, clf.

    Raises
    ------
    InputError
        The reference implementation has no such controller, or a package is missing.
    """
    options = set(options)
    task: TermsOf = AngularTask(model) if "angular" in options else tip
    if "difference" in options:
        task = Differenced(task)
    if name in ("ic", "uic"):
        theirs = "thresholds" in options
        return ClosedForm(model, gains, task, project=name == "uic", theirs=theirs)
    if name not in ("clf-qp", "soft-id-clf-qp", "ic-qp"):
        raise InputError("controller", "a law of the paper's table", repr(name))
    write: Callable[..., SymbolicQp] = (
        reference_clf_qp if name == "clf-qp" and "clf" in options else paper_qps.PAPER_QPS[name]
    )
    if "mass" in options and name != "clf-qp":
        write = partial(paper_qps.mass_orthogonal, decrease=name == "soft-id-clf-qp")
    if options & {"scs", "clf"}:
        return Qp(model, gains, task, write, qp_solvers.Scs())
    exact = qp_solvers.LeastNorm(Quadprog(RIDGE)) if name == "clf-qp" else Quadprog()
    return Qp(model, gains, task, write, exact)


class AngularTask:
    """The tip's task with three rows for its angular velocity, whose reference is zero (r = 6)."""

    def __init__(self, model: SoftModel) -> None:
        self._twin = Twin(model.robot)
        self._states = StateMap(model, self._twin)

    def __call__(self, state: State, reference: Reference) -> TaskTerms:
        """The six rows; the angular ones are MuJoCo's."""
        twin, data = self._twin, self._twin.data
        data.qpos[:], data.qvel[:] = self._states.to_twin(state.q, state.v)
        mujoco.mj_fwdPosition(twin.model, data)
        mujoco.mj_comVel(twin.model, data)
        turning, rate = np.zeros((2, 3, twin.model.nv))
        mujoco.mj_jacSite(twin.model, data, None, turning, twin.task_site)
        body = twin.model.site_bodyid[twin.task_site]
        mujoco.mj_jacDot(twin.model, data, None, rate, data.site_xpos[twin.task_site], body)
        task, dofs, none = tip(state, reference), self._states.dofs, np.zeros(3)
        return TaskTerms(
            np.vstack((task.J, turning[:, dofs])),
            np.vstack((task.Jdot, rate[:, dofs])),
            np.concatenate((task.e, none)),
            np.concatenate((task.edot, turning[:, dofs] @ state.v)),
            np.concatenate((task.yddot, none)),
        )


@dataclass(frozen=True)
class Differenced:
    """A task whose J̇ is (J(q + q̇ h) - J(q)) / h, h = 1 µs."""

    task: TermsOf

    def __call__(self, state: State, reference: Reference) -> TaskTerms:
        """The task's rows with that J̇."""
        model, found = state.model, self.task(state, reference)
        ahead = model.state(model.integrate(state.q, DIFFERENCE * state.v), state.v)
        J = self.task(ahead, reference).J
        return replace(found, Jdot=(J - found.J) / DIFFERENCE)


def reference_inertia(mobility: np.ndarray) -> np.ndarray:
    """Λ from J M⁻¹ Jᵀ: the inverse, or a coarse pseudo-inverse if the determinant is small."""
    if abs(np.linalg.det(mobility)) < 1e-2:
        return np.linalg.pinv(mobility, rcond=1e-2)
    return np.linalg.inv(mobility)


pseudo_inverse = partial(np.linalg.pinv, rcond=1e-8)  # UIC's inner one


class ClosedForm:
    """IC, and with `project` UIC; `theirs` selects the reference implementation's thresholds."""

    def __init__(
        self, model: SoftModel, gains: Gains, task: TermsOf, *, project: bool, theirs: bool
    ) -> None:
        self.gains, self._task, self._project = gains, task, project
        self._mobility_inverse = reference_inertia if theirs else paper_qps.task_inertia
        self._pseudo_inverse = pseudo_inverse if theirs else paper_qps.inverse
        self.guard = InputGuard(model.u_min, model.u_max)

    def __call__(self, state: State, reference: Reference) -> Command:
        """The input at this state."""
        task = self._task(state, reference)
        torque = paper_qps.impedance(state, task, self.gains, self._mobility_inverse)
        if self._project:
            torque = paper_qps.underactuated(state, task, torque, self._pseudo_inverse)
        return self.guard.accept(paper_qps.inputs(state, torque), np.nan, np.nan, clamped=True)


class Qp:
    """A controller that solves a QP; without a solution its input is zero, and this is counted."""

    def __init__(
        self,
        model: SoftModel,
        gains: Gains,
        task: TermsOf,
        write: Callable[..., SymbolicQp],
        solver: Solver,
    ) -> None:
        self.gains, self._task, self._write, self._solver = gains, task, write, solver
        self.guard = InputGuard(model.u_min, model.u_max)

    def __call__(self, state: State, reference: Reference) -> Command:
        """The input at this state."""
        task = self._task(state, reference)
        qp = self._write(self._solver.variables, state, task, self.gains)
        # the reference's δ may have either sign
        below = {name: rows for name, rows in qp.below.items() if name != "slack"}
        try:
            found = self._solver.solve(replace(qp, below=below))
        except qp_solvers.Unsolved:
            self.guard.fallbacks += 1
            self.guard.not_solved += 1
            zero = np.clip(np.zeros_like(self.guard.u_min), self.guard.u_min, self.guard.u_max)
            return Command(zero, status=Status.NOT_SOLVED)
        delta = float(found.values.get("delta", np.zeros(1))[0])
        return self.guard.accept(found["u"], np.nan, delta, clamped=True)


def reference_clf_qp(variables: Any, state: State, task: TaskTerms, gains: Gains) -> SymbolicQp:
    """The reference's CLF-QP: V̇² and ‖u‖₁² in the cost, and V̇ without ÿ_ref."""
    qp = paper_qps.clf_qp(variables, state, task, gains)
    u, mu, delta = qp.variables.values()
    V, drift, slope = paper_qps.lyapunov(task, gains.eps)
    rate = slope[None] @ mu + (drift + slope @ task.yddot)
    return replace(
        qp,
        cost=qp.cost | {"rate": Term(1.0, rate), "size": Term(INPUT_WEIGHT, u, order=1)},
        below=qp.below | {"decrease": rate - delta + V / gains.eps},
    )
