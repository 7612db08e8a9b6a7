"""Search a design: the cable's offsets that bend a rod's tip to a height with the given tension.

It prints the best offsets at the base and at the tip (mm), and the error (mm). A covariance matrix
adaptation with its rank-µ update alone does it.
"""

import numpy as np

import softdyn
from softdyn import design, statics

RUBBER = design.Material(youngs_modulus=0.25e6, density=1070.0)
HEIGHT, TENSION = -0.16, 3.0  # m below the base, N
rng = np.random.default_rng(1)


def error(offsets):
    """Distance (mm) of the tip's height from HEIGHT, and a price of 0.1 for each mm of taper."""
    base, tip = offsets
    section = design.Section(0.2, (0.012, 0.008), RUBBER, segments=5)
    cable = design.Cable(0.0, (base, tip), False, TENSION, name="pull")
    with open("design_search.urdf", "w", encoding="utf-8") as file:
        file.write(design.urdf(design.Arm((section,), cables=(cable,), name="rod")))
    rod = softdyn.load("design_search.urdf")
    height = statics.settle(rod, np.array([TENSION])).y[2]
    return 1000 * abs(height - HEIGHT) + 100 * abs(base - tip)


mean, covariance = np.array([0.006, 0.004]), np.diag([1e-6, 1e-6])  # m, m²
for _ in range(8):
    drawn = np.clip(rng.multivariate_normal(mean, covariance, 6), 0.001, (0.011, 0.007))
    best = drawn[np.argsort([error(one) for one in drawn])[:3]]
    covariance = 0.5 * covariance + 0.5 * (best - mean).T @ (best - mean) / 3
    mean = best.mean(axis=0)
print("offsets (mm):", (1000 * mean).round(2), f"error {error(mean):.2f} mm")
