"""One closed loop in one call."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from softdyn import SoftModel
from softdyn.estimation import Observer
from softdyn.safety import Surroundings
from softdyn.validation.loop.arguments import ReferenceLike
from softdyn.validation.loop.closed_loop import ClosedLoop, Controller, OnStep
from softdyn.validation.loop.log import Log
from softdyn.validation.twin.rig import Rig
from softdyn.validation.twin.state_map import MappedPlant
from softdyn.validation.twin.twin import Twin


def simulate(
    model: SoftModel,
    controller: Controller,
    reference: ReferenceLike,
    *,
    duration: float | None = None,
    period: float | None = None,
    timestep: float | None = None,
    q0: np.ndarray | None = None,
    v0: np.ndarray | None = None,
    contacts: bool = False,
    friction: bool = False,
    twin: Callable[..., Twin] = Twin,
    plant: str | Path | MappedPlant | None = None,
    rig: Rig | str | None = None,
    observer: Observer | None = None,
    surroundings: Surroundings | None = None,
    name: str | None = None,
    progress: bool = False,
    on_step: OnStep | None = None,
) -> Log:
    """Run a controller against the twin and record what happens: a `ClosedLoop` in one call.

    Parameters
    ----------
    model : SoftModel
        The robot; the twin is built from its file, by its own path.
    controller : Callable[[State, Reference], ControllerOutput]
        Returns an object with `u` (nu,); `ClosedLoop` lists its optional attributes.
    reference : Experiment or Callable[[float], Reference]
        The second is of t (s), e.g. a `SetPoint`.
    duration, period, timestep : float, optional
        Length of the run, control period and plant step (s).
    q0, v0 : np.ndarray, (nq,), (nv,), optional
        Initial state, within the joint limits; by default at rest in the configuration within the
        limits that is nearest to q = 0.
    contacts, friction : bool
        Whether the plant's links can touch, and whether it has the file's dry friction.
    twin : Callable[..., Twin]
        Makes the plant, called as `Twin` with the robot, timestep, contacts and friction.
    plant : str, Path or MappedPlant, optional
        A user's MJCF file, or its `Scene`, which replaces the twin.
    rig : Rig or str, optional
        None for an ideal rig, ``"file"`` for that of the robot's file, or a `Rig`.
    observer : Observer, optional
        It estimates the controller's states from the rig's sensors, e.g. `softdyn.estimation.Ekf`.
    surroundings : Surroundings, optional
        Obstacles around the robot; a controller keeps clear of them by its own `barriers`.
    name : str, optional
        Name of the controller in the log; its `name` or its class by default.
    progress : bool
        Show a bar on stderr if that is a terminal.
    on_step : Callable[[float, State, ControllerOutput], None], optional
        Called with t (s), the State and the answer at every control step.

    Returns
    -------
    Log
        The run, failed or not.

    Raises
    ------
    InputError
        For arguments that cannot be run, and for a reference that is not finite.
    Exception
        Any exception of the controller, the observer or the reference, and the KeyboardInterrupt
        of Ctrl-C, unchanged. The exception has the run so far as its attribute ``log``, a `Log`.
    """
    # a run resets its controller, so that threads that share one take turns
    with getattr(getattr(controller, "guard", None), "lock", nullcontext()):
        loop = ClosedLoop(
            model, controller, reference, duration=duration, period=period, timestep=timestep,
            q0=q0, v0=v0, contacts=contacts, friction=friction, twin=twin, plant=plant,
            rig=rig, observer=observer, surroundings=surroundings, name=name,
        )  # fmt: skip
        return loop.run(progress=progress, on_step=on_step)
