"""Ranks, bases and small systems, in compiled loops; at these sizes calls cost more than sums.

Without Numba, the innermost loops are calls of NumPy instead.
"""

from __future__ import annotations

import numpy as np

from softdyn.compiled import compiled, compiled_or

# A row counts if its part outside the span of the larger rows exceeds this share of the largest
# row.
RANK_TOLERANCE = 1e-6
DEPENDENT = 1e-10  # the same for a row that completes a basis, as a share of the row itself


def _add(row, part, other):
    row += part * other


def _add_squares(H, g, weight, rows, offset):
    H += 2 * weight * rows.T @ rows
    g += 2 * weight * offset @ rows


def _inner(a, b):
    return a @ b.T


def _cholesky(M, rows):
    L = np.linalg.cholesky(M)
    return L.T, np.linalg.solve(L, rows.T).T


def _lu_solve(A, b):
    n = len(A)
    try:
        b[:n] = np.linalg.solve(A, b[:n])
    except np.linalg.LinAlgError:
        return False
    return True


def _solve_rows(system):
    n = len(system)
    system[:, n:] = np.linalg.solve(system[:, :n], system[:, n:])


def _multiply(A, B, C):
    np.matmul(A, B, out=C)


@compiled_or(np.dot, reorder=True)
def dot(a: np.ndarray, b: np.ndarray) -> float:
    """a · b of two vectors (n,)."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled_or(_inner, reorder=True)
def inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Inner products a bᵀ (k, l) of rows (k, n) with rows (l, n); it reads `b` once."""
    products = np.empty((len(a), len(b)))
    for j in range(len(b)):
        for i in range(len(a)):
            total = 0.0
            for x in range(a.shape[1]):
                total += a[i, x] * b[j, x]
            products[i, j] = total
    return products


@compiled_or(_add)
def add(row: np.ndarray, part: float, other: np.ndarray) -> None:
    """row += part · other, of vectors (n,)."""
    for i in range(len(row)):
        row[i] += part * other[i]


@compiled_or(_add_squares)
def add_squares(
    H: np.ndarray, g: np.ndarray, weight: float, rows: np.ndarray, offset: np.ndarray
) -> None:
    """Add weight ‖rows x + offset‖², `rows` (p, k), to the objective ½ xᵀHx + gᵀx."""
    for x in range(len(rows)):
        for i in range(len(g)):
            part = 2 * weight * rows[x, i]
            g[i] += part * offset[x]
            for j in range(i + 1):
                H[i, j] += part * rows[x, j]
    for i in range(len(g)):
        for j in range(i):
            H[j, i] = H[i, j]


@compiled
def project_out(row: np.ndarray, basis: np.ndarray, count: int, along: np.ndarray) -> None:
    """Subtract from `row` (n,) its part along the first `count` orthonormal rows of `basis`.

    It does so twice, because one pass loses orthogonality if little is left (Giraud et al. 2005).
    The subtracted coefficients are added to `along` (≥ count,).
    """
    for _ in range(2):
        for i in range(count):
            part = dot(basis[i], row)
            along[i] += part
            add(row, -part, basis[i])


@compiled
def row_space(rows: np.ndarray, tolerance: float = RANK_TOLERANCE) -> np.ndarray:
    """Orthonormal rows (r, n) that span the rows (k, n), r their numerical rank.

    It uses Gram–Schmidt, the largest remaining row first. Input that is not finite gives a result
    that is not finite.
    """
    k, n = rows.shape
    most = k if k < n else n
    left, basis, along, used = np.empty((k, n)), np.empty((most, n)), np.zeros(k), np.zeros(k)
    for i in range(k):
        for x in range(n):
            left[i, x] = rows[i, x]
    largest = 0.0
    for count in range(most):
        pivot, square = 0, -1.0
        for i in range(k):
            if used[i] != 0:
                continue
            size = dot(left[i], left[i])
            if not size <= square:  # the first NaN stays chosen
                pivot, square = i, size
        norm = np.sqrt(square)
        if count == 0:
            largest = norm
        if norm <= tolerance * largest:
            return basis[:count]
        row = basis[count]
        for x in range(n):
            row[x] = left[pivot, x]
        used[pivot] = 1.0
        project_out(row, basis, count, along)
        norm = np.sqrt(dot(row, row))
        for x in range(n):
            row[x] /= norm
        for i in range(k):
            if used[i] == 0:
                add(left[i], -dot(row, left[i]), row)
    return basis


@compiled
def lq(rows: np.ndarray, basis: np.ndarray, triangle: np.ndarray) -> None:
    """Orthonormalise independent rows (k, n): rows = triangle @ basis, `triangle` (k, k) lower.

    Fills the first k rows of `basis` and `triangle`.
    """
    for i in range(len(rows)):
        row, along = basis[i], triangle[i]
        for x in range(len(row)):
            row[x] = rows[i, x]
        for j in range(len(along)):
            along[j] = 0.0
        project_out(row, basis, i, along)
        norm = np.sqrt(dot(row, row))
        along[i] = norm
        for x in range(len(row)):
            row[x] /= norm


@compiled
def extend(basis: np.ndarray, count: int, rows: np.ndarray) -> int:
    """Extend the first `count` orthonormal rows of `basis` so that they span `rows` (k, n) too.

    Returns their new number, at most n or the number of rows of `basis`.
    """
    room, n = basis.shape
    if n < room:
        room = n
    along = np.zeros(room)
    for i in range(len(rows)):
        if count == room:
            break
        row, square = basis[count], dot(rows[i], rows[i])
        for x in range(n):
            row[x] = rows[i, x]
        project_out(row, basis, count, along)
        norm = np.sqrt(dot(row, row))
        if norm > DEPENDENT * np.sqrt(square):
            for x in range(n):
                row[x] /= norm
            count += 1
    return count


@compiled
def factor(
    Bt: np.ndarray, tolerance: float = RANK_TOLERANCE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Factors of B, given as Bᵀ (m, n), of numerical rank r: (range, triangle, rows).

    ``B = range.T @ triangle @ rows``; `range` (r, n) and `rows` (r, m) are orthonormal, `triangle`
    (r, r) is lower triangular, so ``B⁺ = rows.T @ triangle⁻¹ @ range``.
    """
    span = row_space(Bt, tolerance)
    r, m = len(span), len(Bt)
    rows, triangle = np.empty((r, m)), np.empty((r, r))
    lq(inner(span, Bt), rows, triangle)
    return span, triangle, rows


@compiled_or(_cholesky)
def cholesky(M: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Upper triangular R (n, n) with RᵀR = M, its lower half unset, and `rows` R⁻¹ (k, n).

    If M is not positive definite, the result is not finite (in NumPy: `LinAlgError`).
    """
    # The loop fills [R, R⁻ᵀ rowsᵀ] row by row. It subtracts the rows above four at a time, in
    # sweeps along the row. Compilers vectorise such sweeps, but not inner products.
    n, k = len(M), len(rows)
    R = np.empty((n, n + k))
    for j in range(n):
        row = R[j, j:]
        for i in range(n - j):
            row[i] = M[j, j + i]
        for i in range(k):
            row[n - j + i] = rows[i, j]
        for x in range(0, j - 3, 4):
            first, second, third, fourth = R[x, j:], R[x + 1, j:], R[x + 2, j:], R[x + 3, j:]
            a, b, c, d = first[0], second[0], third[0], fourth[0]
            for i in range(len(row)):
                row[i] -= a * first[i] + b * second[i] + c * third[i] + d * fourth[i]
        for x in range(j - j % 4, j):
            add(row, -R[x, j], R[x, j:])
        inverse = 1 / np.sqrt(row[0])
        for i in range(len(row)):
            row[i] *= inverse
    return R, R[:, n:].T.copy()


@compiled_or(_lu_solve)
def lu_solve(A: np.ndarray, b: np.ndarray) -> bool:
    """Solve A x = b, A (n, n), by elimination with row pivots; False if A is singular.

    x overwrites the first n of `b`; A is lost.
    """
    n = len(A)
    for k in range(n):
        pivot, largest = k, abs(A[k, k])
        for i in range(k + 1, n):
            if abs(A[i, k]) > largest:
                pivot, largest = i, abs(A[i, k])
        if not largest > 0:
            return False
        if pivot != k:
            for x in range(k, n):
                A[k, x], A[pivot, x] = A[pivot, x], A[k, x]
            b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, n):
            share = A[i, k] / A[k, k]
            if share != 0:
                for x in range(k + 1, n):
                    A[i, x] -= share * A[k, x]
                b[i] -= share * b[k]
    for k in range(n - 1, -1, -1):
        for x in range(k + 1, n):
            b[k] -= A[k, x] * b[x]
        b[k] /= A[k, k]
    return True


@compiled_or(_solve_rows)
def solve_rows(system: np.ndarray) -> None:
    """Solve A X = R, given as the rows [A, R] (n, n + k); X overwrites R, and A is lost.

    It is the Gauss-Jordan method with row pivots. If A is singular, the result is not finite (in
    NumPy: `LinAlgError`).
    """
    n, width = system.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(system[i, k]) > abs(system[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(k, width):
                system[k, j], system[pivot, j] = system[pivot, j], system[k, j]
        row, pivoted = system[k, k:], system[k, k]
        for j in range(len(row)):
            row[j] /= pivoted
        for i in range(n):
            if i != k:
                add(system[i, k:], -system[i, k], row)


@compiled_or(_multiply, reorder=True)
def multiply(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> None:
    """C = A B, of matrices (i, k) and (k, j)."""
    # sweeps along two rows of C and four of B, which compilers vectorise
    k, w = B.shape
    for i in range(len(A)):
        for j in range(w):
            C[i, j] = 0.0
    for i in range(0, len(A) - 1, 2):
        for x in range(0, k - 3, 4):
            a, b, c, d = A[i, x], A[i, x + 1], A[i, x + 2], A[i, x + 3]
            e, f, g, h = A[i + 1, x], A[i + 1, x + 1], A[i + 1, x + 2], A[i + 1, x + 3]
            for j in range(w):
                p, q, r, s = B[x, j], B[x + 1, j], B[x + 2, j], B[x + 3, j]
                C[i, j] += a * p + b * q + c * r + d * s
                C[i + 1, j] += e * p + f * q + g * r + h * s
        for x in range(k - k % 4, k):
            for j in range(w):
                C[i, j] += A[i, x] * B[x, j]
                C[i + 1, j] += A[i + 1, x] * B[x, j]
    if len(A) % 2:
        i = len(A) - 1
        for x in range(0, k - 3, 4):
            a, b, c, d = A[i, x], A[i, x + 1], A[i, x + 2], A[i, x + 3]
            for j in range(w):
                C[i, j] += a * B[x, j] + b * B[x + 1, j] + c * B[x + 2, j] + d * B[x + 3, j]
        for x in range(k - k % 4, k):
            for j in range(w):
                C[i, j] += A[i, x] * B[x, j]


@compiled
def jacobi_svd(rows: np.ndarray, turned: np.ndarray) -> None:
    """Rotate the rows (k, n) until they are orthogonal, and the rows of `turned` (k, k) with them.

    These are one-sided Jacobi rotations (Hestenes 1958). The rows' norms become the singular
    values, each with full relative accuracy. If `turned` starts as the identity, it becomes the
    product of the rotations.
    """
    for _ in range(30):
        turns = False
        for p in range(len(rows) - 1):
            for q in range(p + 1, len(rows)):
                a, b = dot(rows[p], rows[p]), dot(rows[q], rows[q])
                along = dot(rows[p], rows[q])
                if not abs(along) > 1e-15 * np.sqrt(a * b):
                    continue
                turns = True
                slope = (b - a) / (2 * along)
                t = 1 / (abs(slope) + np.sqrt(1 + slope * slope))
                if slope < 0:
                    t = -t
                cosine = 1 / np.sqrt(1 + t * t)
                sine = cosine * t
                for x in range(rows.shape[1]):
                    first, second = rows[p, x], rows[q, x]
                    rows[p, x] = cosine * first - sine * second
                    rows[q, x] = sine * first + cosine * second
                for x in range(turned.shape[1]):
                    first, second = turned[p, x], turned[q, x]
                    turned[p, x] = cosine * first - sine * second
                    turned[q, x] = sine * first + cosine * second
        if not turns:
            return
