"""Every cell of the paper's experiments for one controller, at several control periods."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from softdyn.validation.loop.labels import SYMBOLS, cell_title
from softdyn.validation.studies import experiments
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Distribution, pivot

PERIODS = (0.001, 0.002)  # s, beside each robot's published one


def cells(
    robots: Sequence[str], controller: str, periods: Iterable[float] = PERIODS
) -> dict[str, Case]:
    """Set points at each period up to the published one, trajectories at that one."""
    found = {}
    for robot in robots:
        published = experiments.setup(robot).period
        at = [
            ("set_point", experiments.THETAS, p)
            for p in sorted({*periods, published})
            if p <= published
        ]
        for kind, values, period in [*at, ("tracking", experiments.OMEGAS, published)]:
            for value in values:
                label = f"{robot}/{controller}/{1e3 * period:g} ms/{cell_title(kind, value)}"
                found[label] = Case(robot, controller, kind, value, period=period)
    return found


def markdown(cells: Mapping[str, Distribution]) -> str:
    """Two tables: set points (cm), trajectories (cm²)."""
    parts = []
    for symbol, mean in zip(SYMBOLS.values(), ("mean (cm)", "mean (cm²)"), strict=True):
        mine = {label: cell for label, cell in cells.items() if f"/{symbol} = " in label}
        if mine:
            parts.append(pivot(mine, ["robot", "controller", "period"], mean))
    return "\n\n".join(parts)
