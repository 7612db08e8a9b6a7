"""A robot's motion under given inputs, without a controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel, State
from softdyn.dynamics.model import check_model
from softdyn.validation.loop.arguments import nowhere
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.processes import in_order
from softdyn.validation.rollouts import threads
from softdyn.validation.rollouts.inputs import Inputs, held_inputs
from softdyn.validation.twin.rig import Rig, rig_of
from softdyn.validation.twin.settings import Integrator
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin


def rollout(
    model: SoftModel,
    inputs: Inputs,
    duration: float = 3.0,
    *,
    hold: float | None = None,
    period: float | None = None,
    timestep: float | None = None,
    integrator: Integrator | str = Integrator.IMPLICITFAST,
    q0: np.ndarray | None = None,
    v0: np.ndarray | None = None,
    contacts: bool = False,
    friction: bool = False,
    rig: Rig | str | None = None,
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
    period : float, optional
        Time between two samples of the log (s), an integer part of `hold`; by default the largest
        that is at most 2 ms.
    timestep : float, optional
        Plant step (s), which must divide the period; by default the largest ≤ 0.5 ms.
    integrator : Integrator or str
        ``implicitfast`` is of first order and robust, ``rk4`` of fourth order.
    q0, v0 : np.ndarray, (nq,), (nv,), optional
        Initial state, within the joint limits; by default at rest in the configuration within the
        limits that is nearest to q = 0.
    contacts, friction : bool
        Whether the links can touch, and whether the file's dry friction acts.
    rig : Rig or str, optional
        None for an ideal rig, ``"file"`` for that of the robot's file, or a `Rig`. Its winches then
        get commands for the inputs, which are forces.

    Returns
    -------
    Log
        As of a closed loop; `y_ref` and `error` are NaN. It failed if the twin diverged.

    Raises
    ------
    InputError
        For inputs and arguments that cannot be run.
    """
    found = rollouts(
        model, [inputs], duration, hold=hold, period=period, timestep=timestep,
        integrator=integrator, q0=q0, v0=v0, contacts=contacts, friction=friction, rig=rig,
    )  # fmt: skip
    return found[0]


def rollouts(
    model: SoftModel,
    batch: Sequence[Inputs] | np.ndarray,
    duration: float = 3.0,
    *,
    hold: float | None = None,
    period: float | None = None,
    timestep: float | None = None,
    rig: Rig | str | None = None,
    **options: Any,
) -> list[Log]:
    """Several rollouts of one robot on all cores, each from the same state.

    MuJoCo integrates them in threads; with a rig each runs in a worker process. The numbers are
    those of single rollouts, to the last bit.

    Parameters
    ----------
    model, duration, hold, period, timestep, rig, **options
        As for `rollout`.
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
    planned = [held_inputs(model, inputs, duration, hold, period, timestep) for inputs in batch]
    grid = planned[0][0]
    for k, (other, _) in enumerate(planned):
        if other != grid:
            expected = f"a period of {grid.period:g} s, as the first run has"
            raise InputError(f"batch[{k}]", expected, f"{other.period:g} s")
    options |= {"duration": duration, "period": grid.period, "timestep": grid.timestep}
    u = np.array([each for _, each in planned])
    loop = _loop(model, u[0], options, rig)
    if rig_of(rig) is None and isinstance(loop.plant, Twin) and threads.fits(loop.plant, grid):
        loop.plant.model.opt.enableflags = 0  # nothing here needs the energy
        empty, states = loop.log(), StateMap(model, loop.plant)
        found = []
        for each, moved in zip(u, threads.integrate(loop.plant, grid, u), strict=True):
            if moved is None:  # the loop says why it diverged
                found.append(_run(model, each, options, rig))
                continue
            q, v = (np.array(rows) for rows in zip(*map(states.from_twin, *moved), strict=True))
            found.append(_filled(empty, model, grid, q, v, each))
        return found
    return in_order(_run, [(model, each, options, rig) for each in u], -1 if len(u) > 1 else 1)


class _GivenInputs:
    """A controller and its output: the input `u` of each period, whatever the state."""

    name = ROLLOUT

    def __init__(self, rows: np.ndarray) -> None:
        self._rows, self.u = iter(rows), np.zeros(0)

    def __call__(self, state: State, reference: Reference) -> _GivenInputs:
        self.u = next(self._rows)
        return self


def _loop(
    model: SoftModel, u: np.ndarray, options: dict[str, Any], rig: Rig | str | None
) -> ClosedLoop:
    return ClosedLoop(model, _GivenInputs(u), nowhere, rig=rig, **options)


def _filled(
    empty: Log, model: SoftModel, grid: TimeGrid, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> Log:
    """The log of a complete run from its states and inputs."""
    y = np.array([model.state(*state).y for state in zip(q, v, strict=True)])
    unknown = np.full(len(u), np.nan)
    return replace(
        empty, t=grid.times(), q=q, v=v, y=y, y_ref=np.full(y.shape, np.nan),
        error=np.full(y.shape, np.nan), u=u, V=unknown, delta=unknown,
        status=np.full(len(u), ""), step_us=unknown, complete=True,
    )  # fmt: skip


def _run(model: SoftModel, u: np.ndarray, options: dict[str, Any], rig: Rig | str | None) -> Log:
    log = _loop(model, u, options, rig).run()
    return replace(log, step_us=np.full(log.steps, np.nan))
