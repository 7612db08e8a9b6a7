"""Ranks and bases, judged at one threshold: the row space of J, the pseudo-inverse of B."""

from __future__ import annotations

import numpy as np

from softdyn.compiled import compiled

# A row counts while what the larger rows leave of it exceeds this share of the largest row.
RANK_TOLERANCE = 1e-6
DEPENDENT = 1e-10  # the same for a row that only completes a basis, against the row itself


@compiled
def project_out(row: np.ndarray, basis: np.ndarray, count: int) -> np.ndarray:
    """`row` (n,) without its part along the first `count` orthonormal rows of `basis`.

    Twice, since once loses orthogonality where little is left (Giraud et al. 2005).
    """
    for _ in range(2):
        for i in range(count):
            row = row - np.dot(basis[i], row) * basis[i]
    return row


@compiled
def row_space(rows: np.ndarray) -> np.ndarray:
    """Orthonormal rows (r, n) that span the rows (k, n), r their numerical rank.

    Gram–Schmidt, the largest remaining row first. Where nothing is finite the result is not.
    """
    k, n = rows.shape
    left = rows.copy()
    basis = np.zeros((min(k, n), n))
    largest = 0.0
    for count in range(min(k, n)):
        norms = np.sqrt((left * left).sum(axis=1))
        pivot = int(np.argmax(norms))
        if count == 0:
            largest = norms[pivot]
        if norms[pivot] <= RANK_TOLERANCE * largest:
            return basis[:count].copy()
        row = project_out(left[pivot], basis, count)
        basis[count] = row / np.sqrt(np.dot(row, row))
        for i in range(k):
            left[i] = left[i] - np.dot(basis[count], left[i]) * basis[count]
    return basis


@compiled
def extended(basis: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Orthonormal rows that span `basis` (r, n), itself orthonormal, and `rows` (k, n)."""
    r, n = basis.shape
    result = np.zeros((min(r + len(rows), n), n))
    result[:r] = basis
    count = r
    for i in range(len(rows)):
        if count == len(result):
            break
        row = project_out(rows[i], result, count)
        norm = np.sqrt(np.dot(row, row))
        if norm > DEPENDENT * np.sqrt(np.dot(rows[i], rows[i])):
            result[count] = row / norm
            count += 1
    return result[:count].copy()


@compiled
def factor(B: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Factors of B (n, m) of numerical rank r: (range, inverse, null).

    ``inverse @ range`` is B⁺; `range` (r, n) spans range(B) with orthonormal rows, `inverse` is
    (m, r), and `null` (m, m - r) spans null(B) with orthonormal columns: what B does not see of u.
    """
    span = row_space(B.T.copy())
    if len(span) == 0:
        return span, np.zeros((B.shape[1], 0)), np.eye(B.shape[1])
    left, values, right = np.linalg.svd(span @ B, full_matrices=True)
    r = len(span)
    inverse = (right[:r].T / values[:r]) @ left.T
    return span, inverse, right[r:].T.copy()
