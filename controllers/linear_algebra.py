"""Ranks, judged at one threshold: the row space of J and the pseudo-inverse of B."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Singular values below this share of the largest count as zero, in J and in B alike.
RANK_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class InputFactors:
    """B = rangeᵀ · forward and B⁺ = inverse · range.

    Attributes
    ----------
    range : (rank, n) orthonormal rows that span range(B).
    forward : (rank, m), range · B.
    inverse : (m, rank).
    """

    range: np.ndarray
    forward: np.ndarray
    inverse: np.ndarray


def row_space(J: np.ndarray) -> np.ndarray:
    """Orthonormal rows (r, n) that span range(Jᵀ), r the numerical rank of J (3, n)."""
    _, values, rows = np.linalg.svd(J, full_matrices=False)
    return rows[values > RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)]


def factor(B: np.ndarray) -> InputFactors:
    """Factors of the input matrix B (n, m), its rank judged at `RANK_TOLERANCE`."""
    left, values, right = np.linalg.svd(B, full_matrices=False)
    rank = int((values > RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)).sum())
    left, values, right = left[:, :rank], values[:rank], right[:rank]
    return InputFactors(left.T, values[:, None] * right, right.T / values)
