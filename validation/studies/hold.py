"""Soft ID-CLF-QP with different horizons of its dynamics (``docs/hold.md``)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from softdyn.controllers import SoftIdClfQp
from softdyn.controllers.gains import from_table
from softdyn.controllers.qps.horizon import default_horizon
from softdyn.validation.files import safe_filename
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.studies import experiments
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Distribution, pivot
from softdyn.validation.studies.engine.sources import load_model
from softdyn.validation.studies.study_targets import study_targets

SHARES = (0.0, 0.5, 0.8, 1.0, 1.2, 2.0)  # of ε
CELLS = (*(("set_point", theta) for theta in experiments.THETAS), ("tracking", 0.5))


def cells(
    robot: str,
    shares: Iterable[float] = SHARES,
    period: float | None = None,
    table: Mapping[str, Any] | None = None,
    annotations: str | None = None,
) -> dict[str, Case]:
    """For each share of ε the paper's set points and one trajectory, or rests of anyone's robot.

    Parameters
    ----------
    robot : str
    shares : iterable of float
    period : float, optional
    table : mapping, optional
        Gains, over the published ones.
    annotations : str, optional
        The robot's annotations in a file of their own.
    """
    found, model = {}, load_model(robot, annotations)
    eps = default_horizon(from_table(model, SoftIdClfQp.name, table or {}))
    asked = study_targets(model, CELLS)
    for share in shares:
        for kind, value in asked:
            horizon = f"{share:g}/{1e3 * share * eps:g} ms"
            label = f"{safe_filename(robot)}/{horizon}/{cell_title(kind, value)}"
            found[label] = Case(
                robot, SoftIdClfQp.name, kind, value, period=period, annotations=annotations,
                parameters={**(table or {}), "horizon": share * eps},
            )  # fmt: skip
    return found


def markdown(cells: Mapping[str, Distribution]) -> str:
    """Final errors at the set points (cm), the mean squared error tracking (cm²)."""
    return pivot(cells, ["robot", "τ / ε", "τ"])
