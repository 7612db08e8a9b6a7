"""Closed forms for a straight, uniform, round rod that is clamped at one end.

They come from textbooks only and are independent of softdyn's model of a rod.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc


@dataclass(frozen=True)
class Rod:
    """Length, radius (m), Young's modulus (Pa), Poisson's ratio, density (kg/m³)."""

    length: float
    radius: float
    modulus: float
    ratio: float
    density: float

    @property
    def EI(self) -> float:
        """Bending stiffness (N m²)."""
        return self.modulus * math.pi * self.radius**4 / 4

    @property
    def area(self) -> float:
        """Area of the cross-section (m²)."""
        return math.pi * self.radius**2


def tip_compliance(rod: Rod) -> float:
    """δ/P for a small transverse force at the tip, Euler–Bernoulli: L³ / 3EI (m/N)."""
    return rod.length**3 / (3 * rod.EI)


def timoshenko_compliance(rod: Rod) -> float:
    """The same with shear, L³ / 3EI + L / κGA; κ = 6 (1 + ν) / (7 + 6 ν) (Cowper, 1966)."""
    kappa = 6 * (1 + rod.ratio) / (7 + 6 * rod.ratio)
    shear = rod.modulus / (2 * (1 + rod.ratio)) * rod.area
    return tip_compliance(rod) + rod.length / (kappa * shear)


def bernoulli_frequencies(rod: Rod, count: int = 3) -> np.ndarray:
    """Frequencies (count,) of a cantilever (Hz): cos β cosh β = -1, ω = β² √(EI / ρA L⁴)."""
    roots = []
    for k in range(count):
        middle = (k + 0.5) * math.pi

        def f(x: float) -> float:
            return math.cos(x) + 1 / math.cosh(x)

        roots.append(brentq(f, middle - 0.5, middle + 0.5, xtol=1e-14))
    unit = math.sqrt(rod.EI / (rod.density * rod.area * rod.length**4))
    return np.square(roots) * unit / (2 * math.pi)


def rayleigh_frequencies(rod: Rod, count: int = 3) -> np.ndarray:
    """The same with the rotary inertia of the cross-sections (Hz).

    EI w⁗ + ρI ω² w″ - ρA ω² w = 0; at the free end w″ = 0 and EI w‴ + ρI ω² w′ = 0.
    """
    L, rho = rod.length, rod.density
    inertia = rho * math.pi * rod.radius**4 / 4

    def determinant(omega: float) -> float:
        s, b = inertia * omega**2 / rod.EI, rho * rod.area * omega**2 / rod.EI
        root = math.sqrt(s * s / 4 + b)
        p, k = math.sqrt(root - s / 2), math.sqrt(root + s / 2)  # e^{±px}, e^{±ikx}
        # w = A (cosh px - cos kx) + B (k sinh px - p sin kx) is clamped at 0
        P, K = p * L, k * L
        moment = (
            p * p * math.cosh(P) + k * k * math.cos(K),
            k * p * p * math.sinh(P) + p * k * k * math.sin(K),
        )
        third = (
            p**3 * math.sinh(P) - k**3 * math.sin(K),
            k * p**3 * math.cosh(P) + p * k**3 * math.cos(K),
        )
        first = (p * math.sinh(P) + k * math.sin(K), k * p * math.cosh(P) - p * k * math.cos(K))
        force = (third[0] + s * first[0], third[1] + s * first[1])
        return (moment[0] * force[1] - moment[1] * force[0]) / math.cosh(P)

    found = []
    for frequency in bernoulli_frequencies(rod, count):
        omega = 2 * math.pi * frequency
        found.append(brentq(determinant, 0.8 * omega, 1.02 * omega, rtol=1e-14) / (2 * math.pi))
    return np.array(found)


def elastica(rod: Rod, angle: float) -> tuple[float, np.ndarray]:
    """Force P (N) that turns the tip by `angle` (rad), and the position of the tip (2,) (m).

    The force keeps its direction, normal to the undeformed rod. Coordinates are along the
    undeformed rod and along the force (Bisshopp & Drucker, 1945).
    """
    s = math.sin(angle)
    m = (1 + s) / 2
    start = math.asin(1 / math.sqrt(2 * m))
    load = ellipk(m) - ellipkinc(start, m)  # √(P L² / EI)
    along = math.sqrt(2 * s) / load
    across = 1 - 2 / load * (ellipe(m) - ellipeinc(start, m))
    return load**2 * rod.EI / rod.length**2, rod.length * np.array([along, across])


def arc(rod: Rod, angle: float) -> np.ndarray:
    """Tip (2,) of a rod of constant curvature that bends by `angle` (rad): along, across (m)."""
    return rod.length / angle * np.array([math.sin(angle), 1 - math.cos(angle)])
