"""Ranks, judged at one threshold: the row space of J and the pseudo-inverse of B."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Singular values below this share of the largest count as zero, in J and in B alike.
RANK_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class InputFactors:
    """B⁺ = inverse · range and the directions of u that B does not see.

    Attributes
    ----------
    range : (rank, n) orthonormal rows that span range(B).
    inverse : (m, rank).
    null : (m, m - rank) orthonormal basis of null(B).
    """

    range: np.ndarray
    inverse: np.ndarray
    null: np.ndarray


def row_space(J: np.ndarray) -> np.ndarray:
    """Orthonormal rows (r, n) that span range(Jᵀ), r the numerical rank of J (3, n)."""
    _, values, rows = np.linalg.svd(J, full_matrices=False)
    return rows[values > RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)]


def factor(B: np.ndarray) -> InputFactors:
    """Factors of the input matrix B (n, m), its rank judged at `RANK_TOLERANCE`."""
    left, values, right = np.linalg.svd(B, full_matrices=len(B) < len(B.T))
    rank = int((values > RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)).sum())
    return InputFactors(left[:, :rank].T, right[:rank].T / values[:rank], right[rank:].T)
