"""Arms that several tests build."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import softdyn
from softdyn import SoftModel, design
from softdyn.validation.rods.arms import model_of
from tests.support import ROOT
from tests.support.robots import GRIPPER, write

THREE_SECTIONS = (ROOT / "docs/examples/three_sections.toml").read_text("utf-8")
RUBBER = design.Material(0.25e6, 0.49, 1070)
EVERYTHING = design.Arm(
    sections=(
        design.Section(
            0.1, (0.015, 0.012, 0.012), RUBBER, 2, ("bend_y", "bend_z", "twist", "extension"),
            inner_radius=0.004, plate=design.Plate(0.02, 0.004, 0.01), name="lower",
        ),
        design.Section(
            0.08, lambda s: 0.01 - 0.002 * s * s, RUBBER, 3, ("bend_y", "shear_y", "shear_z"),
            bending_stiffness=(1e-3, 5e-4), shear_stiffness=(24.0, 15.0),
            mass=0.02, rest={"bend_y": 3.0},
            discs=4, disc=design.Plate(0.014, 0.002, 0.001), name="upper",
        ),
    ),
    damping=design.Damping(time_constant=0.02),
    cables=(
        design.Cable(0.3, 0.01, False, 5.0, 0, 0, name="led"),
        design.Cable(1.0, (0.012, 0.007), False, 5.0, 0, 1, turns=0.25, name="helix"),
        design.Cable(4.0, 0.013, True, 5.0, 1, 1, turns=0.5, name="straight"),
    ),
    mount=design.Mount((0.1, 0.2, 0.3), (1.0, 2.0, -0.5), 0.4),
    payload=design.Payload(0.01, 0.005, 0.01),
    tip=(0.01, 0.002, -0.003),
    name="every <thing> -- at once",
)  # fmt: skip
"""Every field of every part: hollow, curved at rest, measured, oblique."""


def loaded(arm: design.Arm, folder: Path) -> SoftModel:
    """The model of an arm's file."""
    file = folder / f"{abs(hash((arm.name, len(arm.sections))))}.urdf"
    file.write_text(design.urdf(arm), encoding="utf-8")
    return softdyn.load(file)


def pushed() -> SoftModel:
    """An arm with two chambers of 40 mm² on opposite sides, at most 100 kPa; one takes a vacuum."""
    freedoms = ("bend_y", "bend_z", "extension")
    section = design.Section(
        0.1, 0.0125, RUBBER, 3, freedoms, bending_stiffness=4e-3, axial_stiffness=100
    )
    one = design.Chamber(0.0, 0.008, 1e5, area=4e-5, min_pressure=-6e4, name="front")
    two = design.Chamber(np.pi, 0.008, 1e5, area=4e-5, name="back")
    return model_of(design.Arm((section,), chambers=(one, two), name="pushed"))


def reduced_strains(folder: Path) -> SoftModel:
    """Scale strains so that a motion of size 1 is possible for a rod."""
    basis = design.strain_basis(EVERYTHING, 1)
    size = [0.05 if name.startswith(("shear", "extension")) else 5.0 for name in basis.names]
    basis = replace(basis, matrix=basis.matrix * size)
    return softdyn.reduce(loaded(EVERYTHING, folder), basis)


def reduced_at_random(_: Path) -> SoftModel:
    helix = softdyn.load("helix")
    return softdyn.reduce(helix, np.random.default_rng(0).normal(size=(helix.nv, 5)) / 5)


def gripper(folder: Path) -> SoftModel:
    return softdyn.load(write(folder, GRIPPER))


PROJECTIONS = {
    "reduced to strains": reduced_strains,
    "reduced at random": reduced_at_random,
    "mimic": gripper,
}
