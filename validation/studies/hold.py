"""Soft ID-CLF-QP with different horizons of its dynamics (``docs/hold.md``)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import softdyn
from softdyn import SoftModel
from softdyn.controllers import SoftIdClfQp
from softdyn.controllers.programmes.horizon import default_horizon
from softdyn.validation.studies import paper
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.tables import pipes

SHARES = (0.0, 0.5, 0.8, 1.0, 1.2, 2.0)  # of ε
CELLS = (*(("set_point", theta) for theta in paper.THETAS), ("tracking", 0.5))
KEPT = ("failed", "reason", "final_error_cm", "mse_cm2", "not_solved")


def over_horizon(_name: str, model: SoftModel, share: float) -> SoftIdClfQp:
    """The law over a horizon that is this share of ε, with the published gains."""
    return SoftIdClfQp(model, horizon=_horizon(model, share))


def _horizon(model: SoftModel, share: float) -> float:
    return share * default_horizon(SoftIdClfQp(model).gains)


def report(
    robot: str, shares: Iterable[float] = SHARES, period: float | None = None, jobs: int = -1
) -> list[dict[str, Any]]:
    """For each share of ε the paper's set points and one trajectory."""
    shares, model = list(shares), softdyn.load(robot)
    cases = [
        Case(robot, SoftIdClfQp.name, kind, value, period=period,
             law=partial(over_horizon, share=share))
        for share in shares
        for kind, value in CELLS
    ]  # fmt: skip
    results = iter(run_all(cases, jobs))
    rows = []
    for share in shares:
        runs = []
        for kind, value in CELLS:
            result = next(results)
            found = {"theta": None, "omega": None, "tau_s": _horizon(model, share)}
            found["theta" if kind == "set_point" else "omega"] = value
            found |= {name: result[name] for name in KEPT}
            found["mse_cm2" if kind == "set_point" else "final_error_cm"] = None
            runs.append(found)
        rows.append({"share": share, "runs": runs})
    return rows


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Final errors at the set points, their mean, the mean squared error tracking."""
    lines = [["τ / ε", "τ (ms)", "SP at θ = 0, 0.5, 1, 1.5 (cm)", "mean", "TT at ω = 0.5 (cm²)"]]
    for row in rows:
        *points, track = row["runs"]
        errors = [run["final_error_cm"] for run in points]
        texts = [f"{run['final_error_cm']:.2f}{'!' * run['failed']}" for run in points]
        mean, tt = sum(errors) / len(errors), f"{track['mse_cm2']:.2f}{'!' * track['failed']}"
        tau = f"{1e3 * track['tau_s']:g}"
        lines.append([f"{row['share']:g}", tau, ", ".join(texts), f"{mean:.2f}", tt])
    return "\n".join(pipes(lines))
