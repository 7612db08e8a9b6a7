"""A published arm under pressure: its curvature from stated numbers, and after a fit of one factor.

The figures come from ``data/openloop_data_p123.mat`` of https://github.com/BJCaasenbrood/
soft-robot-model-MATLAB (2021, MIT licence): three pressures and the two curvatures of one soft link
at 250 Hz for 40 s. ``examples/paper/val_1_link_openloop.m`` and
``src/Model.m`` of commit 5dfb831 state the numbers:

- length 64 mm, outer radius 13 mm, mass 17 g, three chambers at 120°;
- a linear bending stiffness EI of 8.25e-4 N m², "Hookean" there;
- the moment p A r L of a chamber over the link's length: 1.6e-8 m⁴ times p, so A r = 2.5e-7 m³;
- the frame of the measured curvatures: offsets of 0.36 and 0.1 1/m, and a turn of 0.5 rad.

They do not state A and r alone, the material, the walls, or how the arm was mounted. The stated
axial stiffness and force do not fit to these A r, and the curvatures show no stretch. So the link
only bends here, and r is 8 mm by choice: with bends alone only A r acts. ``pressed_arm.csv`` holds
every 0.5 s of the data, the mean of 0.1 s.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import SoftModel, design, identification, statics
from softdyn.commands import cli
from softdyn.identification import Acquisition, Measurements
from softdyn.validation.rods.arms import model_of

DATA = Path(__file__).parent / "pressed_arm.csv"
LENGTH, RADIUS, MASS, EI = 0.064, 0.013, 0.017, 8.25e-4
MOMENT = 1.6e-8 / LENGTH
OFFSET, JOINTS = 0.008, 6
SHIFT, TURN = np.array([0.36, 0.1]), 0.5
MOUNTS = {"without weight": (0.0, 0.0, 0.0), "hanging": (0.0, 0.0, -9.81)}


EPILOG = """\
Two mounts, because the source states none. A row is the root mean square of the predicted minus the
measured curvature vectors over 79 rows.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
cli.add_json(parser)


def measured() -> tuple[np.ndarray, np.ndarray]:
    """Pressures (rows, 3) in Pa, and curvatures (rows, 2) about the authors' axes x and y (1/m)."""
    table = np.loadtxt(DATA, delimiter=",", skiprows=1)
    seen = table[:, 4:] - SHIFT
    c, s = math.cos(TURN), math.sin(TURN)
    # (ky, -kx) of their model, turned by -0.5 rad, are the measured curvatures
    return 1e3 * table[:, 1:4], np.column_stack((seen @ [-s, -c], seen @ [c, -s]))


def arm(mount: str, growth: tuple[float, ...] = ()) -> SoftModel:
    """The link with its stated numbers."""
    section = design.Section(
        LENGTH, RADIUS, design.Material(1e5), JOINTS, ("bend_y", "bend_z"),
        bending_stiffness=EI, mass=MASS,
    )  # fmt: skip
    chambers = tuple(
        design.Chamber(k * 2 * math.pi / 3, OFFSET, 4e4, area=MOMENT / OFFSET, name=f"u{k + 1}",
                       growth=growth)
        for k in range(3)
    )  # fmt: skip
    held = design.Mount(direction=(0.0, 0.0, -1.0), gravity=MOUNTS[mount])
    return model_of(design.Arm((section,), chambers=chambers, mount=held, name="link"))


def curvatures(model: SoftModel, pressures: np.ndarray) -> np.ndarray:
    """The mean curvatures (rows, 2) at rest about the authors' x and y (1/m)."""
    found, start = [], model.q0
    bends = [np.array([name.startswith(axis) for name in model.joint_names], float)
             for axis in ("bend_z", "bend_y")]  # fmt: skip
    for u in pressures:
        start = statics.settle(model, u, start).q
        found.append((bends[0] @ start / LENGTH, -bends[1] @ start / LENGTH))
    return np.array(found)


def tips(curvature: np.ndarray, model: SoftModel) -> np.ndarray:
    """Tips (rows, 3) of arcs with these curvatures, in the model's world (m)."""
    about_z, about_y = curvature[:, 0], -curvature[:, 1]
    size = np.maximum(np.hypot(about_y, about_z), 1e-9)
    ahead, aside = np.sin(size * LENGTH) / size, (1 - np.cos(size * LENGTH)) / size
    # a turn about z moves the tip of an arm along x to y, one about y to -z
    local = np.column_stack((ahead, aside * about_z / size, -aside * about_y / size))
    pose = model.link_poses(model.q0)["segment_0"]
    found: np.ndarray = local @ pose[:3, :3].T + pose[:3, 3]
    return found


def size(error: np.ndarray) -> float:
    """The root mean square of the lengths of vectors (rows, 2)."""
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def compare(mount: str) -> dict[str, Any]:
    """Errors (1/m) of the prediction and of two fits, and what the fits found."""
    pressures, seen = measured()
    stated, growing = arm(mount), arm(mount, (0.0,))
    outputs = ("tip.x", "tip.y", "tip.z")
    data = Measurements(np.arange(len(seen), dtype=float), pressures, outputs, tips(seen, stated))
    fits = []
    for model, more in ((stated, ()), (growing, ("area_growth",))):
        unknowns = identification.choose_unknowns(model, more, ("gear",))
        acquisition = Acquisition(static=True)
        fits.append(identification.identify(model, data, unknowns, acquisition=acquisition))
    errors = [size(curvatures(one, pressures) - seen)
              for one in (stated, *(fit.model for fit in fits))]  # fmt: skip
    factor, *_ = fits[0].estimates
    return {
        "mount": mount, "measured": size(seen), "stated": errors[0], "factor": factor.value,
        "half": factor.half, "fitted": errors[1], "with_growth": errors[2],
        "growth": [one.value for one in fits[1].estimates if one.parameter.kind.name != "gear"],
    }  # fmt: skip


def table(found: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [
        "| mount | from stated numbers | one factor | after its fit | with a coefficient each |",
        "|---|---|---|---|---|",
    ]
    for one in found:
        shares = [f"{one[name]:.2f} ({100 * one[name] / one['measured']:.0f} %)"
                  for name in ("stated", "fitted", "with_growth")]  # fmt: skip
        factor = f"{one['factor']:.3f} ± {one['half']:.3f}"
        lines.append(f"| {one['mount']} | {shares[0]} | {factor} | {shares[1]} | {shares[2]} |")
    return "\n".join(lines)


def command(arguments: cli.Arguments) -> int:
    """Predict, fit, report."""
    found = [compare(mount) for mount in MOUNTS]
    cli.write_report({"rows": found}, arguments.json, table(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
