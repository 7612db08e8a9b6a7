"""A figure at several numbers of joints: errors, their order, joints for a tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np


@dataclass(frozen=True, eq=False)
class Ladder:
    """A figure, by number of joints.

    Attributes
    ----------
    name : str
        Name of the figure.
    counts : tuple of int
        Joints, ascending.
    values : ndarray, (counts, any)
        The figure: a number or a vector.
    scale : float
        Scale to which errors are relative.
    exact : ndarray, optional
        Its true value. By default the limit is extrapolated from the finest two.
    """

    name: str
    counts: tuple[int, ...]
    values: np.ndarray
    scale: float
    exact: np.ndarray | None = None

    @cached_property
    def order(self) -> float | None:
        """Observed order of convergence p over the finest pair; None where rounding dominates.

        Without an exact value, p follows from the differences of the finest three, whose ratio is
        (n₁⁻ᵖ - n₂⁻ᵖ) / (n₂⁻ᵖ - n₃⁻ᵖ).
        """
        if self.exact is not None:
            return self.orders[-1]
        if len(self.counts) < 3:
            return None
        (a, b), n = self._changes[-2:], self.counts[-3:]
        if min(a, b) < 1e-12:
            return None
        low, high = 0.05, 12.0
        for _ in range(60):  # the ratio grows with p
            p = (low + high) / 2
            x, y, z = (k**-p for k in n)
            low, high = (p, high) if (x - y) / (y - z) < a / b else (low, p)
        return low if 0.06 < low < 11.9 else None

    @cached_property
    def limit(self) -> np.ndarray:
        """The exact value, or Richardson's extrapolation from the finest two by `order`."""
        if self.exact is not None:
            return self.exact
        if self.order is None:
            return self.values[-1]
        factor = (self.counts[-1] / self.counts[-2]) ** self.order
        return self.values[-1] + (self.values[-1] - self.values[-2]) / (factor - 1)

    @property
    def errors(self) -> list[float]:
        """Errors relative to `scale`, one for each count."""
        return [float(np.linalg.norm(value - self.limit)) / self.scale for value in self.values]

    @property
    def orders(self) -> list[float | None]:
        """Order of the errors between neighbouring counts; None where rounding dominates."""
        return [
            math.log(a / b) / math.log(m / n) if min(a, b) > 1e-10 else None
            for (a, b), (n, m) in zip(pairwise(self.errors), pairwise(self.counts), strict=True)
        ]

    def needed(self, tolerance: float) -> int | None:
        """The least number of joints with an error within `tolerance`; or None.

        Beyond the finest count it is extrapolated by the order of convergence; None without an
        order.
        """
        errors = self.errors
        for k, error in enumerate(errors):
            if max(errors[k:]) <= tolerance:
                if k == 0 or error <= 0:
                    return self.counts[k]
                before, coarse = self.counts[k - 1], errors[k - 1]
                slope = math.log(coarse / error) / math.log(self.counts[k] / before)
                guess = before * (coarse / tolerance) ** (1 / max(slope, 0.1))
                return min(self.counts[k], math.ceil(guess - 1e-9))
        if self.order is None or self.order <= 0:
            return None
        return math.ceil(self.counts[-1] * (errors[-1] / tolerance) ** (1 / self.order) - 1e-9)

    def to_dict(self, tolerance: float | None = None) -> dict[str, object]:
        """For JSON."""
        found: dict[str, object] = {
            "quantity": self.name, "joints": list(self.counts), "values": self.values.tolist(),
            "errors": self.errors, "order": self.order, "limit": np.asarray(self.limit).tolist(),
        }  # fmt: skip
        return found if tolerance is None else {**found, "joints_needed": self.needed(tolerance)}

    @property
    def _changes(self) -> list[float]:
        return [float(np.linalg.norm(b - a)) / self.scale for a, b in pairwise(self.values)]
