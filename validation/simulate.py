"""One closed loop in one call."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from softdyn import SoftModel
from softdyn.validation.loop.arguments import ReferenceLike
from softdyn.validation.loop.closed_loop import ClosedLoop, Controller, OnStep
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.settings import MODEL, RunOptions


def simulate(
    model: SoftModel,
    controller: Controller,
    reference: ReferenceLike,
    *,
    progress: bool = False,
    on_step: OnStep | None = None,
    **options: Any,
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
    progress : bool
        Show a bar on stderr if that is a terminal.
    on_step : Callable[[float, State, ControllerOutput], None], optional
        Called with t (s), the State and the answer at every control step.
    **options : Any
        The settings of the run: the fields of `RunOptions`. A `plant` may also be the path of an
        MJCF file; a warning is given if that differs from the model's.

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
    given = RunOptions.of(options)
    if isinstance(given.plant, str | Path | Mapping) and given.plant != MODEL:
        from softdyn.validation.mjcf.scene import scene_of  # most runs need no reader of MJCF

        scene = scene_of(model, given.plant)
        if not scene.comparison.passed:
            warnings.warn(f"{scene.path}: {scene.comparison.verdict}", stacklevel=2)
        given = replace(given, plant=scene)
    # a run resets its controller, so that threads that share one take turns
    with getattr(getattr(controller, "guard", None), "lock", nullcontext()):
        loop = ClosedLoop(model, controller, reference, given)
        return loop.run(progress=progress, on_step=on_step)
