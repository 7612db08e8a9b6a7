"""The four published rods: clamped, 0.6 m long, 30 mm thick, under gravity or two cables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import design

SECONDS, PERIOD = 3.0, 0.01  # s
LENGTH, RADIUS, OFFSET = 0.6, 0.03, 0.02  # m
RUBBER = design.Material(1e6, 0.5, 1000.0)
EI = RUBBER.youngs_modulus * math.pi * RADIUS**4 / 4
# The others' viscosity, 1e4 Pa s, is that of shear; it counts three times in bending and extension.
VISCOUS = 3 * 1e4 / RUBBER.youngs_modulus
# Piecewise constant strains have 0.02 N m² s in bending.
BENDING_ONLY = 0.02 / EI
BENDS = ("bend_y", "bend_z")
UNSHEARED = (*BENDS, "twist", "extension")
ALL = (*UNSHEARED, "shear_y", "shear_z")
UNSTRETCHED = (*BENDS, "twist", "shear_y", "shear_z")
CABLES = (
    design.Cable(0.0, OFFSET, False, 10.0, name="one"),
    design.Cable(-math.pi / 2, OFFSET, False, 10.0, name="two"),
)


@dataclass(frozen=True, eq=False)
class Case:
    """A published rollout.

    Attributes
    ----------
    about : str
        The load, for a table's title.
    pyelastica, soromox : str
        Names in the published files.
    script : str
        SoRoMoX's script.
    time_constant : float
        Damping over stiffness of SoRoMoX and SoRoSim (s).
    drag, elements, step : float, int, float
        PyElastica's damping constant (1/s), its elements and its step (s).
    upright : bool
        Whether gravity is along the rod. Otherwise ours is mounted horizontally.
    gravity : np.ndarray, (3,)
        In the others' frame, in which the rod points along z (m/s²).
    degree : int
        Degree of the strains of SoRoMoX and SoRoSim on each half of the rod.
    strains : tuple of str
        Their strains.
    undamped : tuple of int, float
        Joints and step (s) of our rod without damping of its material, whose fastest mode needs a
        short step. Buckling takes more joints.
    """

    about: str
    pyelastica: str
    soromox: str
    script: str
    time_constant: float
    drag: float
    elements: int
    upright: bool
    gravity: np.ndarray
    degree: int
    strains: tuple[str, ...]
    step: float = 1e-4
    undamped: tuple[int, float] = (16, 1e-4)

    @property
    def share(self) -> float:
        """Gravity over 9.81 m/s²."""
        return float(np.linalg.norm(self.gravity)) / 9.81

    @property
    def tensions(self) -> np.ndarray:
        """The cables' tensions (N)."""
        return np.ones(2) if self.upright else np.zeros(0)

    def arm(
        self, joints: int, freedoms: tuple[str, ...], tau: float, halves: bool = False
    ) -> design.Arm:
        """Our rod with joints in each half or in all, and Kelvin-Voigt damping τ (s)."""
        count = 2 if halves else 1
        sections = tuple(
            design.Section(LENGTH / count, RADIUS, RUBBER, joints, freedoms, name=f"part_{k}")
            for k in range(count)
        )
        mount = design.Mount(direction=(0.0, 0, 1) if self.upright else (1.0, 0, 0))
        return design.Arm(
            sections, design.Damping(time_constant=tau), CABLES if self.upright else (),
            mount, unusual=True,
        )  # fmt: skip

    def in_their_frame(self, tip: np.ndarray) -> np.ndarray:
        """Our tips (samples, 3) in the others' frame: the rod along z, gravity across it."""
        if self.upright:
            return tip
        down = self.gravity / np.linalg.norm(self.gravity)
        return tip[:, :1] * np.array([0.0, 0, 1]) - tip[:, 2:] * down

    def for_pyelastica(self, seconds: float, runs: int = 1) -> dict[str, Any]:
        """The numbers of `pyelastica_rod`."""
        return {
            "elements": self.elements, "dt": self.step, "length": LENGTH, "radius": RADIUS,
            "density": RUBBER.density, "youngs_modulus": RUBBER.youngs_modulus,
            "poissons_ratio": RUBBER.poissons_ratio, "damping": self.drag,
            "gravity": self.gravity.tolist(),
            "cables": [[-OFFSET, 0.0], [0.0, OFFSET]] if self.upright else [],
            "tensions": self.tensions.tolist(), "seconds": seconds, "sample": PERIOD, "runs": runs,
        }  # fmt: skip

    def refined(self, seconds: float) -> dict[str, Any]:
        """The same with a clamp of second order, more elements and 30 times as stiff along itself.

        Its cross-section then keeps its size, as ours does.
        """
        elements = max(self.elements // 2, 24)
        return self.for_pyelastica(seconds) | {
            "elements": elements, "dt": self.step * 0.4, "half_clamped": True, "stretch": 30.0,
            "whole_cables": True,
        }  # fmt: skip


G = 9.81
CASES = {
    "rod": Case(
        "upright, two cables", "tendon_driven", "tendon_driven_gvs", "simulate_tendon_driven_gvs",
        VISCOUS, 0.0048, 100, True, np.array([0, 0, -G]), 1, UNSHEARED, undamped=(28, 5e-5),
    ),
    "planar": Case(
        "gravity across", "planar", "planar_pcs", "simulate_planar_pcs",
        BENDING_ONLY, 0.048, 12, False, np.array([-G, 0, 0]), 0, ALL,
    ),
    "spatial": Case(
        "gravity across, √2 g", "spatial", "spatial_pcs", "simulate_spatial_pcs",
        BENDING_ONLY, 0.048, 12, False, np.array([-G, -G, 0]), 0, ALL,
    ),
    "linear": Case(
        "gravity across, √2 g, linear strains", "spatial", "complex_gvs", "simulate_complex_gvs",
        VISCOUS, 0.048, 12, False, np.array([-G, -G, 0]), 1, UNSHEARED,
    ),
}  # fmt: skip
