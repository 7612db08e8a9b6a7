"""Places and compliances of a rod's joints, from a quadrature rule.

A slender rod under the moment m(s) turns by ∫ m ds / EI. Joints at s_i with the compliances
w_i / EI(s_i) approximate this integral by a sum: s_i and w_i are the nodes and weights of a
quadrature rule. ``docs/rods.md`` has the measured cost and accuracy of each rule.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softdyn.checks import whole

Rule = Callable[[int], tuple[np.ndarray, np.ndarray]]
"""Maps n to nodes in (0, 1) and weights, (n,) each; the weights add up to 1."""


def midpoint(n: int) -> tuple[np.ndarray, np.ndarray]:
    """n equal segments with a joint in the middle of each: second order."""
    n = whole("n", n, 1)
    return (np.arange(n) + 0.5) / n, np.full(n, 1 / n)


def gauss_legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Legendre nodes: exact for small loads; natural frequencies converge in fourth order."""
    nodes, weights = np.polynomial.legendre.leggauss(whole("n", n, 1))
    return (1 + nodes) / 2, weights / 2


RULES: dict[str, Rule] = {"gauss": gauss_legendre, "midpoint": midpoint}
