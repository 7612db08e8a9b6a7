"""From a file's markers to data and a camera: names, first guess of the camera, checks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softdyn.checks import flag, instance
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError
from softdyn.identification.data import Measurements, check_data, gaps
from softdyn.identification.markers.camera import FEWEST_POINTS, MarkerView, kabsch, seen_at
from softdyn.identification.markers.labels import followed, match, ordered
from softdyn.identification.markers.mistakes import check_frame, check_size, exchanged
from softdyn.identification.outputs import compute_outputs
from softdyn.identification.problem import Acquisition
from softdyn.identification.rests import Inputs, rests
from softdyn.identification.result import Identified
from softdyn.identification.static_fit import StaticFit
from softdyn.identification.unknowns.kinds import Around
from softdyn.statics.equilibrium import NoEquilibrium

GRAMS = 102.0  # grams of weight in a newton


def prepared(
    model: SoftModel,
    data: Measurements,
    *,
    static: bool = False,
    camera: np.ndarray | None = None,
    fit_camera: bool = False,
    relabel: bool = False,
) -> tuple[Measurements, Acquisition]:
    """Data whose markers have the right names, and how they were taken.

    The markers are compared with the model's equilibria: with each row's if the data are static,
    else with that under the first input. If there is no such equilibrium, data in motion are not
    checked.

    Parameters
    ----------
    model : SoftModel
        The model with the file's values.
    data : Measurements
    static : bool
        Whether each row is an equilibrium.
    camera : ndarray, (6,), optional
        The camera, or a first guess of it; by default the markers are in the world's frame.
    fit_camera : bool
        Whether the camera is unknown.
    relabel : bool
        Whether the markers' names change from row to row, as `labels` describes.

    Raises
    ------
    InputError
        For markers in another unit or frame, or with exchanged names; a camera or names without
        enough complete markers.
    StaticsError
        If static data, an unknown camera or markers without names need an equilibrium, and none is
        found.
    """
    check_data(check_model(model), instance("data", data, Measurements, "Measurements"))
    static, relabel = flag("static", static), flag("relabel", relabel)
    fit_camera = flag("fit_camera", fit_camera)
    view = MarkerView.of(data.names, camera)
    acquisition = Acquisition(static, view)
    if not view.positions:
        if fit_camera or relabel:
            raise InputError("camera", "markers with x, y and z, see --points", "none")
        return data, replace(acquisition, view=view if view.rotations else None)
    names = [data.names[k].rpartition(".")[0] for k in view.positions]
    seen = view.points(data.outputs)
    try:
        points = _points(model, data, acquisition)
    except NoEquilibrium:
        # data in motion need none, for example those of a wheel that a motor turns
        if static or fit_camera or relabel:
            raise
        return data, acquisition
    rows = slice(None) if static else slice(0, 1)
    check_size(points if static else points[:1], seen[rows] if static else seen)
    known = None if fit_camera and camera is None else view.camera
    if relabel and view.rotations:
        raise InputError("--relabel", "points; a pose has a name of its own", "poses")
    if relabel:
        order, found = _named(points, seen, data.t, known, static)
        outputs = data.outputs.copy()
        columns = np.array(view.positions)[:, None] + np.arange(3)
        outputs[:, columns] = seen = ordered(seen, order)
        data = replace(data, outputs=outputs)
    else:
        complete = int(np.isfinite(seen[rows]).all(2).sum())
        if known is None and complete < FEWEST_POINTS:
            raise InputError("camera", f"{FEWEST_POINTS} complete markers or more", complete)
        if known is not None:
            found = known
        else:
            found = kabsch(points.reshape(-1, 3), seen[: len(points)].reshape(-1, 3))
        there = seen_at(found, points)
        for line in exchanged(names, there, seen[rows], fit_camera):
            raise InputError("markers", "each marker's own name", line)
        if camera is None and not fit_camera:
            check_frame(points, seen[rows])
    return data, replace(acquisition, view=replace(view, camera=found))


def _points(model: SoftModel, data: Measurements, acquisition: Acquisition) -> np.ndarray:
    """The model's points (N, m, 3) at rest in the world, or (1, m, 3) under the first input."""
    u = data.u if acquisition.static else data.u[:1]
    inputs = Inputs(u, np.zeros(model.nu), data.direction, guesses=acquisition.guesses)
    path, by = rests(model, (), inputs, Around(model))
    assert acquisition.view is not None
    return acquisition.view.points(compute_outputs(model, data.names, path, by)[0])


def _named(
    points: np.ndarray, seen: np.ndarray, t: np.ndarray, camera: np.ndarray | None, static: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The order (N, m) of the markers, and the camera."""
    if static:
        return match(points, seen, camera)
    if not np.isfinite(seen[0]).all():
        raise InputError("markers without names", "a first row with all of them", "gaps in it")
    order, found = match(points, seen[:1], camera)
    return followed(seen, t, order[0]), found


def doubts(found: Identified) -> tuple[str, ...]:
    """Lines on what is probably wrong in the data, seen after the fit.

    All stiffnesses, or all gears, far from the file by the same factor mean another unit of the
    inputs. Markers may be exchanged in rows in which the exchange fits much better. Rows may have
    been left out.
    """
    lines: list[str] = []
    problem = instance("found", found, Identified, "an Identified").fit.problem
    if isinstance(problem, StaticFit) and problem.in_part:
        lines.append(
            f"{problem.in_part} of {len(problem.data.t) + problem.in_part} rows are left out: their"
            " cables slid back only in part"
        )
    if not problem.acquisition.static and (lost := gaps(found.data)).size:
        k = int(lost[0])
        cut = "each side has a first state of its own" if len(problem.runs) > 1 else (
            "it is taken as held: leave these rows out"
        )  # fmt: skip
        lines.append(
            f"{lost.size} gaps in the rows in which the input changed, the first one of"
            f" {found.data.t[k + 1] - found.data.t[k]:.3g} s after t = {found.data.t[k]:g} s: {cut}"
        )
    view = MarkerView.of(found.names)
    if len(view.positions) > 1:
        names = [found.names[k].rpartition(".")[0] for k in view.positions]
        seen = view.points(found.data.outputs)
        lines += exchanged(names, seen - view.points(found.residuals), seen, False)
    ratios = [
        one.value / one.parameter.nominal
        for one in found.estimates
        if one.identified
        and one.parameter.nominal
        and one.parameter.names[0] in ("stiffness", "youngs_modulus", "gear")
    ]
    sizes = [max(ratio, 1 / ratio) / GRAMS for ratio in ratios if ratio > 0]
    if sizes and all(0.5 < size < 2 for size in sizes):
        lines.append(f"{ratios[0]:.3g} times the file's value: are the inputs in grams?")
    return tuple(lines)
