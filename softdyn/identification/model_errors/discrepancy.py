"""A small smooth model of the joint forces that the fitted model lacks, for static data.

The missing force on the joints is τ = Ψ W φ. The columns of Ψ are polynomials along the arm of
degree 2 at most, for the joints about each axis. φ are the inputs, their products, and the strains
Ψᵀq of the fitted model's equilibrium, each over its size in the data. W minimises

    Σ ‖measured - simulated‖² / noise² + λ Σ (s W)²,

where s is the rms effect of a weight on the outputs. Leaving out each row in turn chooses λ. The
gain is measured on rows that neither the physics nor W nor λ has seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import underlying_tree
from softdyn.exceptions import InputError
from softdyn.identification.data import Measurements
from softdyn.identification.output_error import fit
from softdyn.identification.parameters import Parameter, with_values
from softdyn.identification.problem import Fit, FitProblem
from softdyn.identification.rests import rests
from softdyn.identification.result import distance
from softdyn.identification.unknowns.kinds import Around, Kind
from softdyn.statics.equilibrium import StaticsError

DEGREE = 2  # of the polynomials along the arm
RIDGES = 10.0 ** np.arange(-3, 4.5, 0.5)
ROUNDS, HALVINGS = 12, 6  # of the search for the weights, and of its steps
DONE = 1e-3  # it ends where a step reduces the cost by a smaller share
FEWEST = 3  # rows of a fit
FOLDS = 11  # largest number of parts of the data in the test of the gain

JOINT_FORCE = Kind(
    "joint_force", "N m, N", lambda model: model.joint_names, lambda model: np.zeros(model.nv),
    lambda sample: -np.eye(len(sample.a)), lambda robot, values: robot, -np.inf, "force.",
    about_zero=True,
)  # fmt: skip
"""A constant force on each joint; only its effect on the outputs is used."""


def products(u: np.ndarray, strains: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """φ (N, f): 1, inputs, their products, strains."""
    m = u.shape[1]
    v, e = u / sizes[:m], strains / sizes[m:]
    products = [v[:, i] * v[:, j] for i, j in combinations_with_replacement(range(m), 2)]
    return np.column_stack([np.ones(len(u)), v, *products, e])


def cubes(u: np.ndarray, strains: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """φ (N, b): the cubes of the strains, as of springs that stiffen."""
    result: np.ndarray = (strains / sizes[u.shape[1] :]) ** 3
    return result


Features = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Joint forces as a function of inputs and strains.

    Attributes
    ----------
    shapes : ndarray, (n, b)
        Ψ, orthonormal columns.
    weights : ndarray, (b, f)
        W (N m, N).
    sizes : ndarray, (m + b,)
        Sizes of inputs and strains.
    ridge : float
        λ.
    features : callable
        (u, strains, sizes) → φ (N, f).
    """

    shapes: np.ndarray
    weights: np.ndarray
    sizes: np.ndarray
    ridge: float
    features: Features

    def forces(self, u: np.ndarray, path: np.ndarray) -> np.ndarray:
        """Joint forces (N, n) at inputs (N, m) and equilibria (N, n) of the fitted model."""
        result: np.ndarray = self.features(u, path @ self.shapes, self.sizes) @ self.weights.T
        return result @ self.shapes.T

    def report(self) -> dict[str, Any]:
        """The model as plain data."""
        names = ("shapes", "weights", "sizes")
        return {name: getattr(self, name).tolist() for name in names} | {"ridge": self.ridge}


@dataclass(frozen=True)
class Gain:
    """Rms residuals (m, or the outputs' units), without and with the discrepancy model.

    Attributes
    ----------
    fitted : tuple of float
        On the rows that were fitted.
    unseen : tuple of float
        On rows that were left out, in turn, from the whole fit.
    folds : int
    """

    fitted: tuple[float, float]
    unseen: tuple[float, float]
    folds: int

    def __str__(self) -> str:
        (before, after), (plain, better) = (
            [f"{1e3 * x:.3g}" for x in pair] for pair in (self.fitted, self.unseen)
        )
        return (
            f"discrepancy model, rms x 1000: {before} -> {after} in the fit; on rows left out,"
            f" in {self.folds} parts: {plain} -> {better}"
        )


def shapes_of(model: SoftModel) -> np.ndarray:
    """Ψ (n, b): polynomials along the joints about each axis, orthonormal."""
    tree, _ = underlying_tree(model)
    columns = tree.joint_jacobian(model.q0)
    axes = np.where(np.abs(columns[3:]).max(0) > 0, columns[3:], 10 * columns[:3]).T
    keys = [tuple(np.round(np.abs(axis), 3).tolist()) for axis in axes]
    found = []
    for key in dict.fromkeys(keys):
        own = np.array([one == key for one in keys])
        count = int(own.sum())
        rows = np.zeros((model.nv, min(DEGREE, count - 1) + 1))
        signs = np.sign(axes[own] @ axes[own][0])
        rows[own] = np.polynomial.legendre.legvander(np.linspace(-1, 1, count), rows.shape[1] - 1)
        rows[own] *= signs[:, None]
        found.append(np.linalg.qr(rows)[0])
    return np.hstack(found)


def fit_discrepancy(found: Fit, features: Features = products) -> Discrepancy:
    """The discrepancy model of a fit of static rows.

    Raises
    ------
    InputError
        For data over time.
    """
    problem, theta = found.problem, found.theta
    if not problem.taken.static:
        raise InputError("discrepancy", "static rows", "data over time")
    model = with_values(problem.base, problem.unknowns, theta)
    shapes, data = shapes_of(model), problem.data
    path = _path(problem, theta)
    sizes = np.maximum(np.abs(np.hstack((data.u, path @ shapes))).max(0), 1e-9)
    phi = features(data.u, path @ shapes, sizes)
    known = np.isfinite(data.outputs)
    left, A = _linear(found, problem, shapes, phi)
    scale = np.sqrt((A[known] ** 2).mean(0))
    scale = np.maximum(scale, 1e-9 * scale.max())
    ridge = min(RIDGES, key=lambda one: _left_out(A / scale, left, known, one))
    w = np.zeros(A.shape[2])

    def there(w: np.ndarray) -> tuple[Discrepancy, FitProblem]:
        weights = (w / scale).reshape(shapes.shape[1], -1)
        made = Discrepancy(shapes, weights, sizes, float(ridge), features)
        force = made.forces(data.u, path)
        return made, replace(problem, taken=replace(problem.taken, force=force))

    def cost(left: np.ndarray, w: np.ndarray) -> float:
        return float((left[known] ** 2).sum() + ridge * w @ w)

    for _ in range(ROUNDS):
        B, now = A[known] / scale, cost(left, w)
        target = left[known] + B @ w
        step = np.linalg.solve(B.T @ B + ridge * np.eye(len(w)), B.T @ target) - w
        for _ in range(HALVINGS):
            try:
                found_there = _linear(found, there(w + step)[1], shapes, phi)
            except StaticsError:
                found_there = None
            if found_there is not None and cost(found_there[0], w + step) < now:
                break
            step /= 2
        else:
            break
        w, (left, A) = w + step, found_there
        if cost(left, w) > (1 - DONE) * now:
            break
    return there(w)[0]


def _linear(
    found: Fit, problem: FitProblem, shapes: np.ndarray, phi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals over the noise (N, outputs), and their derivatives by the weights, but the sign."""
    names = problem.base.joint_names
    force = tuple(
        Parameter(JOINT_FORCE, f"joint_force {name}", row, 0.0)
        for name, row in zip(names, np.eye(len(names)), strict=True)
    )
    model = with_values(problem.base, problem.unknowns, found.theta)
    own = [k for k, one in enumerate(problem.unknowns) if one.kind.measures]  # not the model's
    unknowns = tuple(problem.unknowns[k] for k in own) + force
    wide = replace(problem, base=model, unknowns=unknowns)
    theta = np.append(found.theta[own], np.zeros(len(names)))
    (run,) = wide.simulated(theta, problem.firsts())
    effect = run.by_theta[:, :, len(own) :] @ shapes / found.noise[:, None]
    A = np.einsum("nkb,nf->nkbf", effect, phi).reshape(*effect.shape[:2], -1)
    return (problem.data.outputs - run.out) / found.noise, A


def predicted(problem: FitProblem, theta: np.ndarray, model: Discrepancy) -> np.ndarray:
    """Outputs (N, outputs) of static rows with the missing forces."""
    force = model.forces(problem.data.u, _path(problem, theta))
    there = replace(problem, taken=replace(problem.taken, force=force))
    return there.outputs(theta, there.firsts())[0]


def gain_of(found: Fit, model: Discrepancy) -> Gain:
    """The gain on the fitted rows, and on rows that the whole fit has not seen."""
    data, names = found.problem.data, found.problem.data.names
    folds = min(FOLDS, len(data.t) // 3)
    after = data.outputs - predicted(found.problem, found.theta, model)
    before = found.problem.residuals(found.simulated)
    plain, better = left_out(found, folds), left_out(found, folds, products)
    return Gain(
        (distance(names, before), distance(names, after)),
        (distance(names, plain), distance(names, better)),
        folds,
    )


def left_out(found: Fit, folds: int, features: Features | None = None) -> np.ndarray:
    """Residuals (N, outputs) of static rows that are left out of the fit, in parts.

    Each fit of the others starts from the values found.

    Parameters
    ----------
    found : Fit
    folds : int
        Number of parts; 3 rows or more are left in.
    features : callable, optional
        Features of the discrepancy model that each fit then has.

    Raises
    ------
    InputError
        For data over time, and another number of parts.
    """
    begin = [
        replace(one, nominal=float(value))
        for one, value in zip(found.problem.unknowns, found.theta, strict=True)
    ]
    problem = replace(found.problem, unknowns=tuple(begin))
    data, rows = problem.data, np.arange(len(problem.data.t))
    if not (problem.taken.static and 2 <= folds <= len(rows) and len(rows) > FEWEST):
        expected = f"2 to {len(rows)} parts of static rows, {FEWEST + 1} or more"
        raise InputError("folds", expected, folds if problem.taken.static else "data over time")
    residuals = np.full(data.outputs.shape, np.nan)
    for k in range(folds):
        held = rows % folds == k
        own = fit(_on(problem, data.rows(rows[~held])))
        there = _on(own.problem, data)
        if features is not None:
            out = predicted(there, own.theta, fit_discrepancy(own, features))
        else:
            out = there.outputs(own.theta, there.firsts())[0]
        residuals[held] = (data.outputs - out)[held]
    return residuals


def _on(problem: FitProblem, data: Measurements) -> FitProblem:
    return replace(problem, data=data, runs=((0, len(data.t)),))


def _path(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Equilibria (N, n) of the fitted model."""
    model = with_values(problem.base, problem.unknowns, theta)
    inputs = problem.inputs(theta, (0, len(problem.data.t)))
    return rests(model, (), inputs, Around(problem.base))[0]


def _left_out(A: np.ndarray, left: np.ndarray, known: np.ndarray, ridge: float) -> float:
    """Sum of squares of each row's residuals when the others are fitted, to first order."""
    B = A[known]
    inverse = np.linalg.inv(B.T @ B + ridge * np.eye(B.shape[1]))
    w, total = inverse @ (B.T @ left[known]), 0.0
    for row, values, good in zip(A, left, known, strict=True):
        part = row[good]
        hat = part @ inverse @ part.T
        total += float(
            (np.linalg.solve(np.eye(len(hat)) - hat, values[good] - part @ w) ** 2).sum()
        )
    return total
