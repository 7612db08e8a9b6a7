"""A QP written in expressions, and the solvers for it.

A solver creates variables, the QP is written in them with NumPy's operators, and the solver solves
it. quadprog and DAQP are exact. Their variables are rows with known coefficients (`Affine`). The
paper used SCS, whose variables are cvxpy's own. quadprog and SCS are extras (``test``, ``bench``),
imported when a solver is made.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from softdyn import InputError

SAME = 1e-9  # rows of unit size closer than this to linear dependence count as dependent


class Unsolved(ArithmeticError):
    """The solver has no answer."""


class Affine:
    """Rows matrix @ x + constant in all unknowns x of a QP.

    Parameters
    ----------
    matrix : array, (r, size)
    constant : array, (r,)
    """

    __array_ufunc__ = None  # so that NumPy leaves `array @ affine` to `__rmatmul__`

    def __init__(self, matrix: np.ndarray, constant: np.ndarray) -> None:
        self.matrix, self.constant = matrix, constant

    def at(self, x: np.ndarray) -> np.ndarray:
        """The rows' values (r,) at x (size,)."""
        return self.matrix @ x + self.constant

    def __rmatmul__(self, factor: np.ndarray) -> Affine:
        return Affine(factor @ self.matrix, factor @ self.constant)

    def __add__(self, other: Any) -> Affine:
        if isinstance(other, Affine):
            return Affine(self.matrix + other.matrix, self.constant + other.constant)
        return Affine(self.matrix, self.constant + other)

    def __neg__(self) -> Affine:
        return Affine(-self.matrix, -self.constant)

    def __sub__(self, other: Any) -> Affine:
        return self + (-other)

    def __rsub__(self, other: Any) -> Affine:
        return -self + other


class Term(NamedTuple):
    """weight · ‖of‖², in the norm of this order: 2, or 1 (which only cvxpy takes)."""

    weight: float
    of: Any
    order: int = 2


@dataclass(frozen=True, eq=False)
class SymbolicQp:
    """min Σ weight ‖of‖² s.t. equal = 0, below ≤ 0, with a name for each part.

    Attributes
    ----------
    variables : dict of expressions
        All unknowns, in the order in which the solver created them.
    cost : dict of Term
    equal, below : dict of expressions
    """

    variables: dict[str, Any]
    cost: dict[str, Term]
    equal: dict[str, Any]
    below: dict[str, Any]


@dataclass(frozen=True, eq=False)
class SolverAnswer:
    """The answer of a solver to a QP; ``answer["u"]`` is the value of the variable u.

    Attributes
    ----------
    values : dict of array
    cost : float
        The QP's cost there.
    residual : float
        Largest violation of the optimality conditions; NaN if the solver does not report it.
    """

    values: dict[str, np.ndarray]
    cost: float
    residual: float = math.nan

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]


class Solver(Protocol):
    """A solver for which a QP can be written."""

    def variables(self, *sizes: int) -> Sequence[Any]:
        """One variable of each size, the unknowns of one QP."""
        ...

    def solve(self, qp: SymbolicQp) -> SolverAnswer:
        """The minimiser, or one of them.

        Raises
        ------
        Unsolved
            The solver has no answer.
        """
        ...


def unknowns(*sizes: int) -> Sequence[Affine]:
    """Variables for the exact solvers: slices of the identity."""
    identity, ends = np.eye(sum(sizes)), np.cumsum(sizes)
    blocks = (identity[end - size : end] for end, size in zip(ends, sizes, strict=True))
    return [Affine(block, np.zeros(len(block))) for block in blocks]


# -- exact solvers ---------------------------------------------------------------------------------


class Matrices(NamedTuple):
    """min ½ xᵀHx + gᵀx s.t. E x = e, A x ≤ b."""

    H: np.ndarray
    g: np.ndarray
    E: np.ndarray
    e: np.ndarray
    A: np.ndarray
    b: np.ndarray


class Quadprog:
    """Goldfarb and Idnani's dual active-set method.

    It needs a positive definite Hessian. For a semidefinite Hessian it runs the proximal-point
    iteration x ← argmin f + ½ ridge ‖x - x_previous‖², whose fixed points are the minimisers of f.
    The residual is always that of f.

    Parameters
    ----------
    ridge : float
        0 for a positive definite Hessian.
    steps : int
        Largest number of iterations.
    """

    variables = staticmethod(unknowns)

    def __init__(self, ridge: float = 0.0, steps: int = 60) -> None:
        self._solve = optional("quadprog", "quadprog").solve_qp
        self._ridge, self._steps = ridge, steps if ridge else 1

    def solve(self, qp: SymbolicQp) -> SolverAnswer:
        """See `Solver`."""
        p, unit = scaled(matrices(qp))
        rows, limits = np.vstack((-p.E, -p.A)).T, np.concatenate((-p.e, -p.b))
        H, x = p.H + self._ridge * np.eye(len(p.g)), np.zeros(len(p.g))
        best, residual = x, math.inf
        for _ in range(self._steps):
            try:
                x, *_, multipliers, _ = self._solve(
                    H, self._ridge * x - p.g, rows, limits, len(p.e)
                )
            except ValueError as error:
                raise Unsolved(f"quadprog: {error}") from None
            z = multipliers[len(p.e) :]
            # quadprog reports |y| of an equality; stationarity gives the sign
            y = np.linalg.lstsq(p.E.T, -(p.H @ x + p.g + p.A.T @ z))[0] if len(p.e) else p.e
            found = kkt_residual(p, x, y, z)
            if found < residual:
                best, residual = x, found
            if found < 1e-12:
                break
        return answer(qp, best * unit, residual)


class Daqp:
    """Arnström's dual active-set method."""

    variables = staticmethod(unknowns)

    def __init__(self) -> None:
        self._solve = optional("daqp", "daqp").solve

    def solve(self, qp: SymbolicQp) -> SolverAnswer:
        """See `Solver`."""
        p, unit = scaled(matrices(qp))
        equal, below = len(p.e), len(p.b)
        upper = np.concatenate((p.e, p.b))
        lower = np.concatenate((p.e, np.full(below, -1e30)))
        sense = np.array([5] * equal + [0] * below, np.int32)
        x, _, flag, info = self._solve(
            np.ascontiguousarray(p.H), p.g.copy(), np.vstack((p.E, p.A)), upper, lower, sense,
            primal_tol=1e-12, dual_tol=1e-12, iter_limit=10_000,
        )  # fmt: skip
        if flag < 1:
            raise Unsolved(f"DAQP: exit flag {flag}")
        x, lam = np.asarray(x), np.asarray(info["lam"])
        residual = kkt_residual(p, x, lam[:equal], lam[equal:])
        return answer(qp, x * unit, residual)


class LeastNorm:
    """The minimiser of least ‖x‖, for QPs with more than one.

    A solver finds one minimiser. All minimisers give the same terms of the cost (Mangasarian 1988).
    So a second QP minimises ‖x‖² over the x that change neither these terms nor the equalities. The
    first QP needs no regularising weight on x.

    Parameters
    ----------
    solver : Solver
        An exact solver that takes semidefinite Hessians.
    """

    variables = staticmethod(unknowns)

    def __init__(self, solver: Solver) -> None:
        self._first, self._second = solver, Quadprog()

    def solve(self, qp: SymbolicQp) -> SolverAnswer:
        """See `Solver`; the residual is the first solver's."""
        first = self._first.solve(qp)
        x = np.concatenate(list(first.values.values()))
        weighed = [term.of for term in qp.cost.values() if term.weight]
        held = np.vstack([rows.matrix for rows in (*weighed, *qp.equal.values())])
        sizes = np.linalg.norm(held, axis=1)
        _, values, right = np.linalg.svd(held[sizes > 0] / sizes[sizes > 0, None])
        free = right[int((values > SAME).sum()) :].T
        if free.shape[1] == 0:
            return first
        (z,) = unknowns(free.shape[1])
        below = {}
        for name, rows in qp.below.items():
            along, values = rows.matrix @ free, np.minimum(rows.at(x), 0.0)
            moves = np.linalg.norm(along, axis=1) > SAME * np.linalg.norm(rows.matrix, axis=1)
            below[name] = Affine(along[moves], values[moves])
        moved = self._second.solve(SymbolicQp({"z": z}, {"": Term(1.0, free @ z + x)}, {}, below))
        return answer(qp, x + free @ moved["z"], first.residual)


def matrices(qp: SymbolicQp) -> Matrices:
    """The matrices of a QP in an exact solver's variables, without the constant of its cost.

    Raises
    ------
    Unsolved
        A term of the cost is not quadratic.
    """
    terms = qp.cost.values()
    if any(term.order != 2 for term in terms):
        raise Unsolved("a cost that is not quadratic")
    size = sum(len(rows.matrix) for rows in qp.variables.values())

    def stacked(expressions: Iterable[Affine]) -> tuple[np.ndarray, np.ndarray]:
        rows = [Affine(np.zeros((0, size)), np.zeros(0)), *expressions]
        return np.vstack([r.matrix for r in rows]), -np.concatenate([r.constant for r in rows])

    return Matrices(
        sum(2 * w * rows.matrix.T @ rows.matrix for w, rows, _ in terms),
        sum(2 * w * rows.matrix.T @ rows.constant for w, rows, _ in terms),
        *stacked(qp.equal.values()),
        *stacked(qp.below.values()),
    )


def scaled(p: Matrices) -> tuple[Matrices, np.ndarray]:
    """The QP with unit Hessian diagonal, unit rows, answers of order one; the answer's units."""
    diagonal = np.diag(p.H)
    unit = 1 / np.sqrt(np.where(diagonal > 1e-12 * diagonal.max(), diagonal, 1.0))
    E, A, g = p.E * unit, p.A * unit, p.g * unit
    rows_E, rows_A = np.linalg.norm(E, axis=1), np.linalg.norm(A, axis=1)
    rows_E[rows_E == 0] = rows_A[rows_A == 0] = 1.0
    e, b = p.e / rows_E, p.b / rows_A
    size = max(1.0, *(np.abs(x).max(initial=0) for x in (e, b, g)))
    H = p.H * np.outer(unit, unit)
    return (
        Matrices(H, g / size, E / rows_E[:, None], e / size, A / rows_A[:, None], b / size),
        unit * size,
    )


def kkt_residual(p: Matrices, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> float:
    """Largest violation of stationarity, feasibility, sign and complementarity at (x; y, z).

    For scaled QPs (entries of order one). It is absolute, except for multipliers larger than one.
    """
    size = max(1.0, np.abs(y).max(initial=0), np.abs(z).max(initial=0))
    slack = p.b - p.A @ x
    return float(
        max(
            np.abs(p.H @ x + p.g + p.E.T @ y + p.A.T @ z).max() / size,
            np.abs(p.E @ x - p.e).max(initial=0),
            (-slack).max(initial=0),
            (-z).max(initial=0),
            np.abs(np.minimum(slack, z)).max(initial=0),
        )
    )


def answer(qp: SymbolicQp, x: np.ndarray, residual: float) -> SolverAnswer:
    """The answer x of an exact solver, by the QP's names."""
    cost = sum(weight * float(np.sum(rows.at(x) ** 2)) for weight, rows, _ in qp.cost.values())
    values = {name: rows.at(x) for name, rows in qp.variables.items()}
    return SolverAnswer(values, cost, residual)


# -- the paper's solver ----------------------------------------------------------------------------


class Scs:
    """SCS through cvxpy, as the paper used it; the QP is built anew at every call.

    Parameters
    ----------
    quadratic : bool
        Write ‖x‖² as ``sum_squares(x)``, which stays a quadratic program and takes half the time.
        The reference implementation writes ``square(norm(x))``, which becomes second-order cones.
    accuracy : float, optional
        Absolute and relative tolerance of SCS. The default is cvxpy's, which the reference
        implementation uses.
    """

    def __init__(self, *, quadratic: bool = False, accuracy: float | None = None) -> None:
        self._cp = optional("cvxpy", "cvxpy scs")
        self._quadratic = quadratic
        self._options = {} if accuracy is None else {"eps": accuracy, "max_iters": 200_000}

    def variables(self, *sizes: int) -> Sequence[Any]:
        """See `Solver`."""
        return [self._cp.Variable(size) for size in sizes]

    def solve(self, qp: SymbolicQp) -> SolverAnswer:
        """See `Solver`."""
        cp = self._cp
        cost = sum(t.weight * self._squared(t) for t in qp.cost.values() if t.weight)
        limits = [rows == 0 for rows in qp.equal.values()]
        limits += [rows <= 0 for rows in qp.below.values()]
        problem = cp.Problem(cp.Minimize(cost), limits)
        try:
            problem.solve(solver=cp.SCS, **self._options)
        except (cp.error.SolverError, ValueError) as error:
            raise Unsolved(f"SCS: {error}") from None
        values = {name: variable.value for name, variable in qp.variables.items()}
        if any(value is None for value in values.values()):
            raise Unsolved(f"SCS: {problem.status}")
        return SolverAnswer(values, float(problem.value))

    def _squared(self, term: Term) -> Any:
        cp = self._cp
        if term.order == 2 and (self._quadratic or term.of.size == 1):
            return cp.sum_squares(term.of)
        return cp.square(cp.norm(term.of, term.order))


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
