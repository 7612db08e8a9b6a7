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

    The strain of freedom f in a section is Σ ξ_k P_k(2 s/length - 1), with Legendre's P_k: at
    degree 0 piecewise constant curvature (PCC) where sections bend only, constant strain (PCS) with
    twist, extension and shear. A joint at s that stands for the length w turns by w times the
    strain there; ξ in 1/m, without a unit for extension and shear.

    Parameters
    ----------
    arm : Arm
        With joints enough that it stands for the rod: the reduced model's cost does not grow with
        the accuracy asked of it, only its making does.
    degree : int
        Of the polynomials.

    Raises
    ------
    InputError
        A degree that the joints of a section cannot tell from a lower one.
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
