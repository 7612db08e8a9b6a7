"""All figures of a benchmark, made from its logs alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure
from tqdm.auto import tqdm

from softdyn.validation.files import safe_filename
from softdyn.validation.loop.pictures.plot_style import save, style
from softdyn.validation.report import figures
from softdyn.validation.report.plot_data import PlottedRun, distinct
from softdyn.validation.studies import benchmark
from softdyn.validation.studies.engine.case import Case

CONVERGENCE = "convergence_"  # and a robot


def make_all(cases: Iterable[Case], folder: Path) -> list[Path]:
    """Draw every figure for which `cases` have runs, into ``folder/figures`` as PDF and PNG.

    Figures of an earlier grid for which these cases have no runs are removed.

    Returns
    -------
    list[Path]
        The files written.

    Raises
    ------
    InputError
        When a log is missing or damaged.
    """
    cases = list(dict.fromkeys(cases))
    target = folder / "figures"
    target.mkdir(parents=True, exist_ok=True)
    with tqdm(cases, disable=None, leave=False, unit="log", desc="logs") as bar:
        store = benchmark.store(folder)
        runs = [PlottedRun.load(case, store.log_path(case.name)) for case in bar]
    robots = distinct(runs, "robot")
    drawings: dict[str, Callable[[], Figure | None]] = {
        "lyapunov_set_points": partial(figures.lyapunov, runs, "set_point"),
        "lyapunov_trajectories": partial(figures.lyapunov, runs, "tracking"),
        **{
            f"{CONVERGENCE}{safe_filename(robot)}": partial(figures.convergence, runs, robot)
            for robot in robots
        },
        "tracking": partial(figures.tracking, runs),
        "error_set_points": partial(figures.errors, runs, "set_point"),
        "error_trajectories": partial(figures.errors, runs, "tracking"),
        "inputs": partial(figures.inputs, runs),
    }
    written: list[Path] = []
    with style(), tqdm(drawings.items(), disable=None, leave=False, desc="figures") as bar:
        for name, draw in bar:
            figure = draw()
            if figure is not None:
                written += save(figure, target / name)
    for path in {*target.glob("*.pdf"), *target.glob("*.png")} - {*written}:
        if path.stem in drawings or path.stem.startswith(CONVERGENCE):
            path.unlink(missing_ok=True)
    return written
