"""A robot's motion under given inputs, without a controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel, State
from softdyn.checks import array
from softdyn.dynamics.model import check_model
from softdyn.validation.loop.arguments import nowhere
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.plants import IdealPlant
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.processes import in_order
from softdyn.validation.rollouts import threads
from softdyn.validation.rollouts.inputs import Commanded, Inputs, held_inputs
from softdyn.validation.twin.rig import RiggedPlant
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin


def rollout(
    model: SoftModel,
    inputs: Inputs,
    duration: float = 3.0,
    *,
    hold: float | None = None,
    commands: Sequence[str] = (),
    **options: Any,
) -> Log:
    """Let the twin move under given inputs, and record what happens.

    Parameters
    ----------
    model : SoftModel
        The robot; the twin is built from its file, by its own path.
    inputs : np.ndarray, (nu,) or (steps, nu), or Callable[[float], np.ndarray]
        Constant inputs; rows that are held one after the other; or a function of t (s), which is
        held over each period. Inputs beyond the robot's bounds are refused.
    duration : float
        Length of the run (s).
    hold : float, optional
        Time for which each row is held (s); by default the rows share the duration evenly.
    commands : sequence of str, optional
        Names of inputs that are no forces but commands of the rig's motors: free lengths (m) or
        velocities (m/s) of winches, forces of other motors. A free length beyond its bounds is
        refused. `Log.u` has the force that the command gives at the beginning of each period.
    **options : Any
        The settings of the run: the fields of `RunOptions` besides `observer`. ``period`` is the
        time between two samples of the log (s), an integer part of `hold`; by default the largest
        that is at most 2 ms. The winches of a rig get commands for inputs that are forces.

    Returns
    -------
    Log
        As of a closed loop; `y_ref` and `error` are NaN. It failed if the twin diverged.

    Raises
    ------
    InputError
        For inputs and arguments that cannot be run.
    """
    return rollouts(model, [inputs], duration, hold=hold, commands=commands, **options)[0]


def rollouts(
    model: SoftModel,
    batch: Sequence[Inputs] | np.ndarray,
    duration: float = 3.0,
    *,
    hold: float | None = None,
    commands: Sequence[str] = (),
    **options: Any,
) -> list[Log]:
    """Several rollouts of one robot on all cores, from one state or each from its own.

    MuJoCo integrates them in threads; with a rig each runs in a worker process. The numbers are
    those of single rollouts, to the last bit.

    Parameters
    ----------
    model, duration, hold, commands, **options
        As for `rollout`. ``q0`` and ``v0`` may have a row for each run, (runs, nq) and (runs, nv).
    batch : sequence of inputs, or np.ndarray, (runs, steps, nu)
        The inputs of each run, all in forms with the same period.

    Returns
    -------
    list of Log
        In the order of the batch.

    Raises
    ------
    InputError
        For inputs and arguments that cannot be run.
    """
    check_model(model)
    if not isinstance(batch, Sequence | np.ndarray) or not len(batch):
        raise InputError("batch", "the inputs of each run", repr(batch))
    rows = _rows_of_starts(options, len(batch))
    given = RunOptions.of({**options, **{name: values[0] for name, values in rows.items()}})
    commanded = Commanded.of(model, commands, given.rig)
    planned = [
        held_inputs(model, inputs, duration, hold, given.period, given.timestep, commanded)
        for inputs in batch
    ]
    grid = planned[0][0]
    for k, (other, _) in enumerate(planned):
        if other != grid:
            expected = f"a period of {grid.period:g} s, as the first run has"
            raise InputError(f"batch[{k}]", expected, f"{other.period:g} s")
    given = replace(given, duration=duration, period=grid.period, timestep=grid.timestep)
    u = np.array([each for _, each in planned])
    loop = _loop(model, u[0], given, commanded.direct)
    begins = [
        replace(given, **{name: values[k] for name, values in rows.items()}) for k in range(len(u))
    ]
    twin = loop.plant.engine if isinstance(loop.plant, IdealPlant) else None
    twin = twin if given.surroundings is None else None  # threads record no reserve and no force
    if isinstance(twin, Twin) and threads.fits(twin, grid):
        twin.model.opt.enableflags = 0  # nothing here needs the energy
        empty, states = loop.log(), StateMap(model, twin)
        starts = threads.Starts.of(twin, lambda k: loop.begin(begins[k]), len(u))
        found = []
        moves = threads.integrate(twin, grid, u, starts)
        for each, options_k, moved in zip(u, begins, moves, strict=True):
            if moved is None:  # the loop says why it diverged
                found.append(_run(model, each, options_k, commanded.direct))
                continue
            q, v = (np.array(some) for some in zip(*map(states.from_twin, *moved), strict=True))
            log = _filled(empty, model, grid, q, v, each)
            found.append(log.altered(record=_record(log.record, rows, options_k)) if rows else log)
        return found
    cases = [
        (model, each, options_k, commanded.direct)
        for each, options_k in zip(u, begins, strict=True)
    ]
    return in_order(_run, cases, -1 if len(u) > 1 else 1)


def _rows_of_starts(options: dict[str, Any], runs: int) -> dict[str, np.ndarray]:
    """Those of ``q0`` and ``v0`` that have a row for each run."""
    found = {}
    for name in ("q0", "v0"):
        value = options.get(name)
        if value is not None and np.ndim(value) == 2:
            found[name] = array(name, value, (runs, np.shape(value)[1]))
    return found


def _record(
    record: Mapping[str, Any], rows: dict[str, np.ndarray], given: RunOptions
) -> dict[str, Any]:
    """The record of a run with its own start."""
    starts = {name: getattr(given, name).tolist() for name in rows}
    return {**record, "settings": {**record["settings"], **starts}}


class _GivenInputs:
    """A controller and its output: the input `u` of each period, whatever the state.

    Inputs that are commands go to the motors of `rig`.
    """

    name = ROLLOUT

    def __init__(self, rows: np.ndarray, direct: np.ndarray) -> None:
        self._rows, self._direct, self.u = iter(rows), direct, np.zeros(0)
        self.rig: RiggedPlant | None = None

    def __call__(self, state: State, reference: Reference) -> _GivenInputs:
        row = next(self._rows)
        self.u = row if self.rig is None else self.rig.direct(row, self._direct, state)
        return self


def _loop(model: SoftModel, u: np.ndarray, options: RunOptions, direct: np.ndarray) -> ClosedLoop:
    inputs = _GivenInputs(u, direct)
    loop = ClosedLoop(model, inputs, nowhere, options)
    if direct.any():
        assert isinstance(loop.plant, RiggedPlant)
        inputs.rig = loop.plant
    return loop


def _filled(
    empty: Log, model: SoftModel, grid: TimeGrid, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> Log:
    """The log of a complete run from its states and inputs."""
    y = np.array([model.state(*state).y for state in zip(q, v, strict=True)])
    unknown = np.full(len(u), np.nan)
    return empty.altered(
        t=grid.times(), q=q, v=v, y=y, y_ref=np.full(y.shape, np.nan),
        error=np.full(y.shape, np.nan), u=u, V=unknown, delta=unknown,
        status=np.full(len(u), ""), step_us=unknown, complete=True,
    )  # fmt: skip


def _run(model: SoftModel, u: np.ndarray, options: RunOptions, direct: np.ndarray) -> Log:
    log = _loop(model, u, options, direct).run()
    return log.altered(step_us=np.full(log.steps, np.nan))
