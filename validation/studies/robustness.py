"""A controller away from its model: other targets, other plants, another link between the two."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from softdyn.validation.files import safe_filename
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.loop.signal_path import SignalPath
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Distribution, pivot
from softdyn.validation.studies.engine.sources import load_model
from softdyn.validation.studies.study_targets import study_targets
from softdyn.validation.twin.plant_errors import PlantErrors

CELLS = (("set_point", 0.25), ("set_point", 1.25), ("tracking", 0.25))  # not the paper's
FACTORS = (0.8, 0.9, 1.1, 1.2)
# N m or N a joint: 0.1 is what the paper's reference implementation has on SpiRob
DRY = {"finger": 0.001, "helix": 0.01}
REFERENCE_DRY = 0.1


def changes(robot: str) -> dict[str, dict[str, Any]]:
    """What is changed → the fields of a case that do it, for one robot."""
    dry = PlantErrors(dry_friction=DRY.get(robot, REFERENCE_DRY))
    return {
        "none": {},
        "ellipse x 0.7": {"ellipse_scale": 0.7},
        **{
            f"{name} x {factor:g}": {"plant": PlantErrors(**{name: factor})}  # type: ignore[arg-type]
            for name in ("mass", "stiffness", "damping")
            for factor in FACTORS
        },
        "5 ms delay": {"signals": SignalPath(delay=0.005)},
        "1 mm noise": {"signals": SignalPath(noise=0.001)},
        "actuators lag 10 ms": {"signals": SignalPath(lag=0.01)},
        "actuators lag 50 ms": {"signals": SignalPath(lag=0.05)},
        "cable friction 5 %": {"plant": PlantErrors(cable_friction=0.05)},
        "dry friction": {"plant": dry},
        # what the plant of the paper's reference implementation has
        "contacts": {"plant": PlantErrors(contacts=True)},
        "soft stops": {"plant": PlantErrors(soft_stops=True)},
        "contacts, soft stops": {"plant": PlantErrors(contacts=True, soft_stops=True)},
        "one plant step a period": {"timestep": math.inf},
    }


def cells(
    robots: Iterable[str],
    controller: str,
    period: float | None,
    parameters: Any = None,
    annotations: str | None = None,
) -> dict[str, Case]:
    """Each change of each robot, at a control period (s) or the robot's own.

    Parameters
    ----------
    robots : iterable of str
    controller : str
    period : float, optional
    parameters : Any
        What the controller is built with besides the model.
    annotations : str, optional
        The robots' annotations in a file of their own.
    """
    at = "" if period is None else f"{1e3 * period:g} ms/"
    found = {}
    for robot in robots:
        model = load_model(robot, annotations)
        asked = study_targets(model, CELLS)
        for change, fields in changes(robot).items():
            if "ellipse_scale" in fields and asked != list(CELLS):
                continue  # its goals are on no ellipse
            for kind, value in asked:
                names = f"{safe_filename(robot)}/{safe_filename(controller)}"
                label = f"{names}/{at}{change}/{cell_title(kind, value)}"
                found[label] = Case(
                    robot, controller, kind, value, parameters=parameters, period=period,
                    annotations=annotations, **fields,
                )  # fmt: skip
    return found


def nearby_failures(cells: Mapping[str, Distribution]) -> int:
    """How many cells failed from rest with springs, masses and damping within 10 % of the model."""
    near = [f"/{name} x {x:g}/" for name in ("mass", "stiffness", "damping") for x in FACTORS[1:3]]
    return sum(
        cell.failed.get("nominal", 0)
        for label, cell in cells.items()
        if any(part in label for part in ("/none/", *near))
    )


def markdown(cells: Mapping[str, Distribution]) -> str:
    """The table; set points in cm, trajectories in cm²."""
    titles = ["robot", "controller", "period", "change"]
    parts = max(label.count("/") for label in cells)
    return pivot(cells, titles if parts == len(titles) else [*titles[:2], "change"])
