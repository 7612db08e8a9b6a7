"""Reports of identified twins and of compared excitations, as data and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.identification import Parameter, output_names
from softdyn.validation.identification import excitations, trials

Report = tuple[dict[str, Any], str, bool]


def outputs_of(model: SoftModel, measure: str) -> list[str]:
    """Names of the twin's outputs: those of joints, of the tip, or of markers."""
    first = {"joints": "q.", "tip": "tip.", "markers": "point."}[measure]
    found = [name for name in output_names(model) if name.startswith(first)]
    if not found:
        raise InputError("--measure markers", "--points FILE with points", "none")
    return found


def of_excitations(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    outputs: Sequence[str],
    excitation: trials.Excitation,
    noise: float,
    jobs: int,
) -> Report:
    """Compare excitations; the last entry says whether the best one identifies all."""
    found = excitations.compared(model, unknowns, outputs, excitation, noise, jobs=jobs)
    rows = [
        {"amplitude": one.excitation.amplitude, "knots": one.excitation.knots,
         "relative": one.relative.tolist(), "refused": one.refused}
        for one in found
    ]  # fmt: skip
    report = {"labels": [one.label for one in unknowns], "excitations": rows}
    text = excitations.comparison(unknowns, found)
    return report, text, bool(found[0].identifiable.all())


def of_trials(
    model: SoftModel, unknowns: Sequence[Parameter], *what: Any, **options: Any
) -> Report:
    """Identify twins; the last entry says whether all parameters were identified."""
    several = trials.each_trial(model, unknowns, *what, **options)
    rows = [
        {"seed": one.seed, "relative": one.relative.tolist(), "scores": one.scores.tolist(),
         "width": one.width.tolist(), **one.found.report()}
        for one in several
    ]  # fmt: skip
    report = {"labels": [one.label for one in unknowns], "summary": trials.summary(several),
              "trials": rows}  # fmt: skip
    text = trials.trial_table(several).text()
    return report, text, all(e.identified for one in several for e in one.found.estimates)
