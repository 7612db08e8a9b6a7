"""Strain models: piecewise constant or polynomial strains as a basis of an arm's joints."""

from __future__ import annotations

import numpy as np

from softdyn.checks import instance, number
from softdyn.design.layout import lay_out
from softdyn.design.rods import Arm
from softdyn.dynamics.reduced import Basis
from softdyn.exceptions import InputError


def strain_basis(arm: Arm, degree: int = 0) -> Basis:
    """The basis of strains that are polynomials in each section, for `softdyn.reduce`.

    The strain of freedom f in a section is Σ ξ_k P_k(2 s/length - 1), with Legendre's P_k. Degree 0
    is piecewise constant curvature (PCC) if sections only bend, and piecewise constant strain (PCS)
    with twist, extension and shear. A joint at s that stands for the length w turns by w times the
    strain at s. The unit of ξ is 1/m; for extension and shear ξ has no unit.

    Parameters
    ----------
    arm : Arm
        An arm with enough joints to represent the rod. More joints make the reduced model slower to
        build, but not slower to use.
    degree : int
        Degree of the polynomials.

    Raises
    ------
    InputError
        If the degree is not below the number of joints in every section.
    """
    number("degree", degree, lower=0)
    least = min(section.segments for section in instance("arm", arm, Arm, "an Arm").sections)
    if int(degree) != degree or degree >= least:
        raise InputError("degree", f"a whole number below the segments, {least}", degree)
    springs = lay_out(arm).all_springs
    names, columns = [], []
    for index, section in enumerate(arm.sections):
        for strain in section.freedoms:
            for k in range(int(degree) + 1):
                legendre = np.polynomial.legendre.Legendre.basis(k)
                names.append(f"{strain}_{section.name}" + (f"_{k}" if degree else ""))
                columns.append(
                    [
                        spring.weight * float(legendre(2 * spring.at - 1))
                        if (spring.section, spring.strain) == (index, strain)
                        else 0.0
                        for spring in springs
                    ]
                )
    return Basis(np.array(columns).T, tuple(spring.name for spring in springs), tuple(names))
