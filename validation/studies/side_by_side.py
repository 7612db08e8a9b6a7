"""`benchmark` from Python: compare a user's controller classes with those of the package."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import softdyn
from softdyn import InputError, SoftModel
from softdyn.validation.studies import experiments
from softdyn.validation.studies.benchmark import rows_of_runs
from softdyn.validation.studies.benchmark_table import benchmark_document, benchmark_table
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.studies.study_targets import study_targets

Make = Callable[[SoftModel], Any]


@dataclass(frozen=True, eq=False)
class Benchmark:
    """The result of `benchmark`; its text is the table.

    Attributes
    ----------
    rows : tuple of dict
        A row for each robot and controller, with the keys of the command's JSON.
    """

    rows: tuple[dict[str, Any], ...]

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {"rows": list(self.rows)}

    def __str__(self) -> str:
        return benchmark_table(self.rows).text()

    def _repr_markdown_(self) -> str:
        return benchmark_document(self.rows)


@dataclass(frozen=True)
class Built:
    """Builds a case's controller from a class."""

    make: Make

    def __call__(self, _name: str, model: SoftModel) -> Any:
        """The controller for one run."""
        return self.make(model)


def benchmark(
    controllers: Mapping[str, Make] | Iterable[str],
    robots: Iterable[str | Path | SoftModel] = ("finger", "helix", "spirob"),
    *,
    thetas: Iterable[float] = experiments.THETAS,
    omegas: Iterable[float] = experiments.OMEGAS,
    jobs: int = -1,
) -> Benchmark:
    """Run the paper's experiments with several controllers; the result prints a table.

    Parameters
    ----------
    controllers : mapping or iterable of str
        Name → a callable of the model, e.g. a class; or names as on the command line.
    robots : iterable of str, Path or SoftModel
        Robots that are not in the paper move to as many equilibria.
    thetas, omegas : iterable of float
        Set points and rates, in multiples of π.
    jobs : int
        Processes, -1 for one per core, 1 for this one alone.

    Raises
    ------
    InputError
        A robot or controller is unknown, or a controller cannot be built.
    """
    makes = controllers if isinstance(controllers, Mapping) else dict.fromkeys(controllers)
    asked = [("set_point", x) for x in thetas] + [("tracking", x) for x in omegas]
    cases = []
    for one in robots:
        model = one if isinstance(one, SoftModel) else softdyn.load(one)
        robot, overlay = model.bundled or str(model.robot.path), model.robot.overlay
        for name, make in makes.items():
            if make is not None and not callable(make):
                raise InputError(name, "a class, called with the model", repr(make))
            cases += [
                Case(robot, name, kind, value, law=None if make is None else Built(make),
                     annotations=None if overlay is None else str(overlay))
                for kind, value in study_targets(model, asked)
            ]  # fmt: skip
    return Benchmark(tuple(rows_of_runs(zip(cases, run_all(cases, jobs), strict=True))))
